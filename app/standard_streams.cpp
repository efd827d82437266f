#include "app/standard_streams.hpp"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdio>
#include <string>
#include <system_error>

namespace penumbra {
namespace {

struct Descriptor {
  int number = -1;
  std::atomic<int> error = 0;  // errno of the first write that failed
};

// Static: the C library flushes the streams when the process ends.
Descriptor& standard_output() {
  static Descriptor descriptor{STDOUT_FILENO};
  return descriptor;
}
Descriptor& standard_error() {
  static Descriptor descriptor{STDERR_FILENO};
  return descriptor;
}

// A write callback of fopencookie().
ssize_t write_or_drop(void* cookie, const char* text, std::size_t size) {
  auto& descriptor = *static_cast<Descriptor*>(cookie);
  std::size_t done = 0;
  while (done < size) {
    const ssize_t count = write(descriptor.number, text + done, size - done);
    if (count >= 0) {
      done += static_cast<std::size_t>(count);
    } else if (errno == EAGAIN) {
      // Another process made the shared terminal or pipe non-blocking.
      pollfd writable{descriptor.number, POLLOUT, 0};
      poll(&writable, 1, -1);
    } else if (errno != EINTR) {
      int none = 0;
      descriptor.error.compare_exchange_strong(none, errno);
      break;
    }
  }
  return static_cast<ssize_t>(size);
}

// Null where memory is short; the stream then stays as it is.
std::FILE* dropping_stream(Descriptor& descriptor, int buffering) {
  cookie_io_functions_t functions{};
  functions.write = &write_or_drop;
  std::FILE* stream = fopencookie(&descriptor, "w", functions);
  if (stream != nullptr) std::setvbuf(stream, nullptr, buffering, BUFSIZ);
  return stream;
}

void open_closed_descriptors() {
  for (const int number : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(number, F_GETFD) >= 0 || errno != EBADF) continue;
    // The lowest free number is this one. Standard output is opened for reading alone: its writes
    // fail as before, and the exit code shows it.
    (void)open("/dev/null", number == STDOUT_FILENO ? O_RDONLY : O_RDWR);
  }
}

}  // namespace

void secure_standard_streams() {
  open_closed_descriptors();
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);  // ulimit -f
  const int buffering = isatty(STDOUT_FILENO) == 1 ? _IOLBF : _IOFBF;
  if (std::FILE* out = dropping_stream(standard_output(), buffering)) stdout = out;
  if (std::FILE* error = dropping_stream(standard_error(), _IONBF)) stderr = error;
}

Result<void> flush_standard_output() {
  const int flush_error = std::fflush(stdout) == 0 ? 0 : errno;
  const int written_error = standard_output().error;
  const int error = written_error != 0 ? written_error : flush_error;
  if (error == 0) return {};
  const std::string cause = error == EBADF   ? "it is closed"
                            : error == EPIPE ? "its reader has ended"
                                             : std::generic_category().message(error);
  return fail("standard output cannot be written: {}", cause);
}

}  // namespace penumbra
