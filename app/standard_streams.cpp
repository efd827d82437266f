#include "app/standard_streams.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <climits>
#include <csignal>
#include <cstdio>
#include <string>
#include <string_view>
#include <system_error>

namespace penumbra {
namespace {

// Returns errno of the first failed write to standard output, or 0. It is static, because the C
// library flushes the streams when the process ends.
std::atomic<int>& output_error() {
  static std::atomic<int> error = 0;
  return error;
}

// Write callback of fopencookie() for standard output. Waits for a slow reader: no result is lost.
ssize_t write_output(void*, const char* text, std::size_t size) {
  std::size_t done = 0;
  while (done < size) {
    const ssize_t count = write(STDOUT_FILENO, text + done, size - done);
    if (count >= 0) {
      done += static_cast<std::size_t>(count);
    } else if (errno == EAGAIN) {
      // Another process made the shared terminal or pipe non-blocking.
      pollfd writable{STDOUT_FILENO, POLLOUT, 0};
      poll(&writable, 1, -1);
    } else if (errno != EINTR) {
      int none = 0;
      output_error().compare_exchange_strong(none, errno);
      break;
    }
  }
  return static_cast<ssize_t>(size);
}

// Standard error. Drops a line that cannot be written in time, so that a stalled reader does not
// stop the session. Not thread-safe except for dropped(); stdio locks the stream.
class LogDescriptor {
 public:
  void write(std::string_view text) {
    if (unreported_ > 0 && !write_notice()) return drop(text);
    const std::size_t done = write_in_time(text, is_stalled_ ? milliseconds(0) : kPatience);
    is_stalled_ = done < text.size();
    is_cut_ = is_stalled_ && done > 0;
    drop(text.substr(done));
  }
  // Thread-safe.
  [[nodiscard]] std::int64_t dropped() const { return dropped_; }

 private:
  using Clock = std::chrono::steady_clock;
  using milliseconds = std::chrono::milliseconds;

  static constexpr milliseconds kPatience{200};  // timeout for a reader that has not stalled yet

  void drop(std::string_view text) {
    const std::int64_t lines = std::count(text.begin(), text.end(), '\n');
    unreported_ += lines;
    dropped_ += lines;
  }
  bool write_notice() {
    std::array<char, 128> notice{};
    const int length = std::snprintf(
        notice.data(), notice.size(),
        "%spenumbra: warning: %lld lines of the log were dropped: standard error was not read\n",
        is_cut_ ? "\n" : "", static_cast<long long>(unreported_));
    const std::string_view text(notice.data(), static_cast<std::size_t>(length));
    if (write_in_time(text, milliseconds(0)) < text.size()) return false;
    unreported_ = 0;
    return true;
  }
  // Returns the number of bytes written.
  static std::size_t write_in_time(std::string_view text, milliseconds timeout) {
    const auto end = Clock::now() + timeout;
    std::size_t done = 0;
    while (done < text.size()) {
      const auto left = std::chrono::ceil<milliseconds>(end - Clock::now());
      pollfd writable{STDERR_FILENO, POLLOUT, 0};
      const int ready = poll(&writable, 1, std::max(0, static_cast<int>(left.count())));
      if (ready == 0) break;
      // A pipe that poll() reports as writable accepts PIPE_BUF bytes without blocking.
      const ssize_t count = ready > 0 ? write_now(text.substr(done, PIPE_BUF)) : -1;
      if (count >= 0) {
        done += static_cast<std::size_t>(count);
      } else if (errno != EINTR && (errno != EAGAIN || Clock::now() >= end)) {
        break;
      }
    }
    return done;
  }
  static ssize_t write_now(std::string_view text) {
    const ssize_t sent = send(STDERR_FILENO, text.data(), text.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (sent >= 0 || errno != ENOTSOCK) return sent;
    return ::write(STDERR_FILENO, text.data(), text.size());
  }

  bool is_stalled_ = false;
  bool is_cut_ = false;                    // the previous line was written only in part
  std::int64_t unreported_ = 0;            // dropped lines that no message has reported yet
  std::atomic<std::int64_t> dropped_ = 0;  // all dropped lines
};

LogDescriptor& log_descriptor() {
  static LogDescriptor descriptor;
  return descriptor;
}

// Write callback of fopencookie() for standard error.
ssize_t write_log(void*, const char* text, std::size_t size) {
  log_descriptor().write({text, size});
  return static_cast<ssize_t>(size);
}

// Returns nullptr if out of memory; the caller then keeps the original stream.
std::FILE* stream_of(cookie_write_function_t* write, int buffering) {
  cookie_io_functions_t functions{};
  functions.write = write;
  std::FILE* stream = fopencookie(nullptr, "w", functions);
  if (stream != nullptr) std::setvbuf(stream, nullptr, buffering, BUFSIZ);
  return stream;
}

// Opens the pipe or terminal of standard error again in non-blocking mode, because other processes
// share the original open file description and its mode. Libraries that write to the descriptor
// directly do not block then either. If it cannot be opened again, the original stays in use.
void stop_waiting_for_log_reader() {
  struct stat about {};
  if (fstat(STDERR_FILENO, &about) != 0) return;
  if (!S_ISFIFO(about.st_mode) && isatty(STDERR_FILENO) != 1) return;
  const int reopened = open("/proc/self/fd/2", O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
  if (reopened < 0) return;
  dup2(reopened, STDERR_FILENO);
  close(reopened);
}

void open_closed_descriptors() {
  for (const int number : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(number, F_GETFD) >= 0 || errno != EBADF) continue;
    // open() returns the lowest free number: `number`. Standard output is opened read-only, so that
    // writes still fail and the exit code reports it.
    (void)open("/dev/null", number == STDOUT_FILENO ? O_RDONLY : O_RDWR);
  }
}

}  // namespace

void secure_standard_streams() {
  open_closed_descriptors();
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);  // ulimit -f
  const int buffering = isatty(STDOUT_FILENO) == 1 ? _IOLBF : _IOFBF;
  if (std::FILE* out = stream_of(&write_output, buffering)) stdout = out;
  stop_waiting_for_log_reader();
  if (std::FILE* error = stream_of(&write_log, _IONBF)) stderr = error;
}

Result<void> flush_standard_output() {
  const int flush_error = std::fflush(stdout) == 0 ? 0 : errno;
  const int written_error = output_error();
  const int error = written_error != 0 ? written_error : flush_error;
  if (error == 0) return {};
  const std::string cause = error == EBADF   ? "it is closed"
                            : error == EPIPE ? "its reader has ended"
                                             : std::generic_category().message(error);
  return fail("standard output cannot be written: {}", cause);
}

std::int64_t dropped_log_lines() {
  return log_descriptor().dropped();
}

}  // namespace penumbra
