#include "app/output/output_file.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <limits>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kStandardOutput = "standard output";

constexpr int kPartialAttempts = 1000;

// Returns "PATH.partial-PID-ATTEMPT". Writers try 0, 1, ... and use the first free name, so that
// two runs with one target never use the same file.
fs::path partial_path(const fs::path& target, int attempt) {
  fs::path path = target;
  path += fmt::format(".partial-{}-{}", getpid(), attempt);
  return path;
}

// Returns 0 or the errno.
int write_all(int descriptor, std::string_view text) {
  while (!text.empty()) {
    const ssize_t count = ::write(descriptor, text.data(), text.size());
    if (count >= 0) {
      text.remove_prefix(static_cast<std::size_t>(count));
    } else if (errno != EINTR) {
      return errno;
    }
  }
  return 0;
}

// Returns N if the path names descriptor N of this process: /dev/stdout, /dev/fd/N.
std::optional<int> descriptor_of(const fs::path& path) {
  if (path == "-") return STDOUT_FILENO;
  constexpr int kMaxLinks = 8;
  std::error_code error;
  const fs::path descriptors = fs::canonical("/proc/self/fd", error);
  if (error) return std::nullopt;
  fs::path at = path;
  for (int i = 0; i < kMaxLinks; ++i) {
    const auto number = parse_integer(at.filename().string());
    if (number && *number >= 0 && *number <= std::numeric_limits<int>::max() &&
        fs::canonical(at.parent_path(), error) == descriptors) {
      return static_cast<int>(*number);
    }
    if (!fs::is_symlink(at, error)) return std::nullopt;
    const fs::path next = fs::read_symlink(at, error);
    if (error) return std::nullopt;
    at = next.is_absolute() ? next : at.parent_path() / next;
  }
  return std::nullopt;
}

// Duplicate of the original standard output for the output file; -1: not claimed.
std::atomic<int>& claimed_output() {
  static std::atomic<int> descriptor = -1;
  return descriptor;
}

// Checks pending signals, because InterruptWatch blocks Ctrl-C while files are open.
bool is_interrupted() {
  sigset_t pending;
  sigemptyset(&pending);
  sigpending(&pending);
  return sigismember(&pending, SIGINT) == 1 || sigismember(&pending, SIGTERM) == 1 ||
         sigismember(&pending, SIGHUP) == 1;
}

// Opens a named pipe and waits for its reader. After one second a message reports the wait. Returns
// -1 and sets errno on failure.
int open_pipe(const fs::path& pipe) {
  constexpr std::chrono::milliseconds kRetryInterval(20);
  constexpr int kTriesBeforeNotice = 50;
  for (int tries = 0;; ++tries) {
    const int handle = ::open(pipe.c_str(), O_WRONLY | O_CLOEXEC | O_NONBLOCK);
    if (handle >= 0) {
      (void)fcntl(handle, F_SETFL, O_WRONLY);  // makes writes block
      return handle;
    }
    if (errno != ENXIO && errno != EINTR) return -1;
    if (is_interrupted()) {
      errno = EINTR;
      return -1;
    }
    if (tries == kTriesBeforeNotice) {
      log_warning("{}: is a named pipe that nothing reads; waiting for its reader", pipe.string());
    }
    std::this_thread::sleep_for(kRetryInterval);
  }
}

}  // namespace

bool names_standard_output(const fs::path& path) {
  return descriptor_of(path) == STDOUT_FILENO;
}

bool is_stream(const fs::path& path) {
  if (descriptor_of(path)) return true;
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  return fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status);
}

void claim_standard_output() {
  if (claimed_output() >= 0) return;
  std::fflush(stdout);
  const int kept = fcntl(STDOUT_FILENO, F_DUPFD_CLOEXEC, STDERR_FILENO + 1);
  if (kept < 0) return;  // standard output is closed; the output file reports it
  claimed_output() = kept;
  dup2(STDERR_FILENO, STDOUT_FILENO);
}

Result<OutputFile> OutputFile::create(const fs::path& target) {
  if (target.empty()) return fail("the output path is empty; name a file");
  OutputFile file;
  file.requested_ = target;
  if (const auto descriptor = descriptor_of(target)) {
    file.is_stream_ = true;
    int from = *descriptor;
    if (from == STDOUT_FILENO) {
      file.requested_ = kStandardOutput;
      claim_standard_output();
      from = claimed_output();
    }
    file.open_ = fcntl(from, F_DUPFD_CLOEXEC, 0);
    if (file.open_ < 0) return file.not_written(errno);
  } else {
    std::error_code error;
    // A link is written through, not replaced.
    file.target_ = follow_links(target);
    const fs::file_status status = fs::status(file.target_, error);
    if (fs::is_directory(status)) return fail("{}: is a folder; name a file", target.string());
    const fs::path parent =
        file.target_.has_parent_path() ? file.target_.parent_path() : fs::path(".");
    if (!fs::is_directory(parent, error)) {
      return fail(
          "{}: cannot be written: the folder {} is missing; create it or choose another place",
          target.string(), parent.string());
    }
    file.is_stream_ = fs::exists(status) && !fs::is_regular_file(status);
    if (file.is_stream_ && fs::is_fifo(status)) {
      if (access(file.target_.c_str(), W_OK) != 0) return file.not_written(errno);
    } else if (file.is_stream_) {
      PENUMBRA_TRY_VOID(file.open_stream());
    }
  }
  PENUMBRA_TRY_VOID(file.create_partial());
  return file;
}

Result<void> OutputFile::create_partial() {
  if (is_stream_) {
    memory_ = memfd_create("penumbra-output", MFD_CLOEXEC);
    if (memory_ < 0) return not_written(errno);
    partial_ = fmt::format("/proc/self/fd/{}", memory_);
    return {};
  }
  for (int attempt = 0; attempt < kPartialAttempts && open_ < 0; ++attempt) {
    partial_ = partial_path(target_, attempt);
    open_ = ::open(partial_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_APPEND | O_CLOEXEC, 0666);
    if (open_ < 0 && errno != EEXIST) break;
  }
  if (open_ >= 0) return {};
  const int cause = errno;
  partial_.clear();
  return not_written(cause);
}

tl::unexpected<Error> OutputFile::not_written(int error) const {
  const char* remedy = error == ENOSPC || error == EDQUOT
                           ? "free some space or choose another place"
                       : error == EPIPE ? "its reader closed it"
                       : error == EINTR ? "interrupted while waiting for its reader"
                                        : "choose another place or free this one";
  return fail("{}: cannot be written: {}; {}", requested_.string(), system_message(error), remedy);
}

OutputFile::OutputFile(OutputFile&& other) noexcept {
  swap(other);
}

OutputFile& OutputFile::operator=(OutputFile&& other) noexcept {
  OutputFile taken(std::move(other));
  swap(taken);
  return *this;
}

OutputFile::~OutputFile() {
  close_descriptors();
  if (partial_.empty() || is_stream_) return;
  std::error_code ignored;
  fs::remove(partial_, ignored);
}

void OutputFile::swap(OutputFile& other) noexcept {
  requested_.swap(other.requested_);
  target_.swap(other.target_);
  partial_.swap(other.partial_);
  std::swap(is_stream_, other.is_stream_);
  std::swap(memory_, other.memory_);
  std::swap(open_, other.open_);
}

void OutputFile::close_descriptors() noexcept {
  for (int* descriptor : {&memory_, &open_}) {
    if (*descriptor >= 0) ::close(*descriptor);
    *descriptor = -1;
  }
}

Result<void> OutputFile::open_stream() {
  if (open_ >= 0) return {};
  open_ = open_pipe(target_);
  if (open_ < 0) return not_written(errno);
  return {};
}

Result<void> OutputFile::append(std::string_view text) {
  if (is_stream_) PENUMBRA_TRY_VOID(open_stream());
  if (const int error = write_all(open_, text); error != 0) return not_written(error);
  return {};
}

Result<void> OutputFile::write_memory_to_stream() {
  std::array<char, 65536> block;
  if (lseek(memory_, 0, SEEK_SET) < 0) return not_written(errno);
  while (true) {
    const ssize_t count = ::read(memory_, block.data(), block.size());
    if (count < 0) return not_written(errno);
    if (count == 0) return {};
    PENUMBRA_TRY_VOID(append({block.data(), static_cast<std::size_t>(count)}));
  }
}

Result<void> OutputFile::commit() {
  if (is_stream_) {
    PENUMBRA_TRY_VOID(write_memory_to_stream());
  } else {
    std::error_code error;
    fs::rename(partial_, target_, error);
    if (error) {
      return fail("{}: cannot be written: {}; choose another place", requested_.string(),
                  error.message());
    }
  }
  close_descriptors();
  partial_.clear();
  return {};
}

// Keeps the file at the path under another name (a hard link, or a copy where links are
// impossible). Returns an empty path if there is no file.
Result<fs::path> keep_old(const fs::path& target) {
  std::error_code error;
  if (!fs::exists(fs::symlink_status(target, error))) return fs::path();
  for (int attempt = 0; attempt < kPartialAttempts; ++attempt) {
    fs::path old = partial_path(target, attempt);
    if (fs::exists(fs::symlink_status(old, error))) continue;
    fs::create_hard_link(target, old, error);
    if (error) fs::copy_file(target, old, error);
    if (error) break;
    return old;
  }
  return fail("{}: cannot be replaced: {}; choose another place", target.string(), error.message());
}

Result<void> commit_together(std::span<OutputFile* const> files) {
  struct Committed {
    fs::path target;
    fs::path old;
  };
  std::vector<Committed> done;
  Result<void> result;
  std::error_code ignored;
  std::vector<OutputFile*> ordered(files.begin(), files.end());
  std::ranges::stable_partition(ordered, [](const OutputFile* file) { return !file->is_stream_; });
  for (OutputFile* file : ordered) {
    Result<fs::path> old = file->is_stream_ ? Result<fs::path>() : keep_old(file->target_);
    result = old ? file->commit()
                 : tl::unexpected(renamed(old.error(), file->target_, file->requested_));
    if (old && !file->is_stream_) {
      if (result) {
        done.push_back({file->target_, std::move(*old)});
      } else if (!old->empty()) {
        fs::remove(*old, ignored);
      }
    }
    if (!result) break;
  }
  for (const Committed& file : done) {
    if (result) {
      if (!file.old.empty()) fs::remove(file.old, ignored);
    } else if (file.old.empty()) {
      fs::remove(file.target, ignored);
    } else {
      fs::rename(file.old, file.target, ignored);
    }
  }
  return result;
}

tl::unexpected<Error> OutputFile::failed(const Error& cause) const {
  return tl::unexpected(renamed(cause, partial_, requested_));
}

Error renamed(const Error& error, const fs::path& written, const fs::path& requested) {
  const std::string from = written.string();
  const std::string to = requested.string();
  std::string text = error.message;
  for (std::size_t at = from.empty() ? std::string::npos : text.find(from); at != std::string::npos;
       at = text.find(from, at + to.size())) {
    text.replace(at, from.size(), to);
  }
  return {text};
}

namespace {

// Creates a new, empty folder beside the target.
fs::path make_beside(const fs::path& target, std::error_code& error) {
  for (int attempt = 0; attempt < kPartialAttempts; ++attempt) {
    const fs::path path = partial_path(target, attempt);
    if (fs::create_directory(path, error)) return path;
    if (error) return {};
  }
  error = std::make_error_code(std::errc::file_exists);
  return {};
}

}  // namespace

fs::path folder_name(const fs::path& path) {
  const fs::path name = path.lexically_normal();
  return name.has_filename() ? name : name.parent_path();
}

void keep_complete_lines(OutputFile& file) {
  constexpr std::size_t kMaxBytes = 4'000'000'000;
  const auto text = read_text_file(file.partial(), kMaxBytes);
  const std::size_t end = text ? text->rfind('\n') : std::string::npos;
  if (end == std::string::npos) return;
  std::error_code error;
  std::filesystem::resize_file(file.partial(), end + 1, error);
  if (!error) (void)file.commit();
}

OutputFolder::~OutputFolder() {
  std::error_code ignored;
  if (!partial_.empty()) fs::remove_all(partial_, ignored);
}

Result<void> OutputFolder::create(const fs::path& target) {
  target_ = target;
  std::error_code error;
  if (target_.has_parent_path()) fs::create_directories(target_.parent_path(), error);
  if (!error) partial_ = make_beside(target_, error);
  if (!error) return {};
  return fail("{}: cannot be made: {}; choose another place", target.string(), error.message());
}

tl::unexpected<Error> OutputFolder::failed(const Error& cause) const {
  return tl::unexpected(renamed(cause, partial_, target_));
}

std::error_code OutputFolder::commit(fs::path* aside) {
  std::error_code error;
  if (aside != nullptr) {
    *aside = make_beside(target_, error);
    if (!error) fs::rename(target_, *aside, error);
  }
  std::error_code ignored;
  if (!error) {
    fs::rename(partial_, target_, error);
    if (error && aside != nullptr) fs::rename(*aside, target_, ignored);
    if (!error) partial_.clear();
  } else if (aside != nullptr && !aside->empty()) {
    fs::remove(*aside, ignored);
  }
  return error;
}

fs::path follow_links(const fs::path& path) {
  constexpr int kMaxLinks = 40;  // the limit of Linux
  fs::path at = path;
  std::error_code error;
  for (int i = 0; i < kMaxLinks && fs::is_symlink(at, error); ++i) {
    const fs::path next = fs::read_symlink(at, error);
    if (error) return path;
    at = next.is_absolute() ? next : at.parent_path() / next;
  }
  return at;
}

bool same_path(const fs::path& a, const fs::path& b) {
  std::error_code error;
  if (fs::equivalent(a, b, error)) return true;
  return fs::weakly_canonical(fs::absolute(a, error), error) ==
         fs::weakly_canonical(fs::absolute(b, error), error);
}

Result<void> check_written_once(std::span<const fs::path> outputs,
                                std::span<const fs::path> inputs) {
  for (std::size_t i = 0; i < outputs.size(); ++i) {
    if (outputs[i].empty() || is_stream(outputs[i])) continue;
    const auto is_same = [&](const fs::path& other) {
      return !other.empty() && same_path(outputs[i], other);
    };
    if (std::ranges::any_of(inputs, is_same) || std::ranges::any_of(outputs.first(i), is_same)) {
      return fail("{}: is also named as another input or output; name a separate file for each",
                  outputs[i].string());
    }
  }
  return {};
}

bool lies_in(const fs::path& path, const fs::path& folder) {
  std::error_code error;
  fs::path at = fs::weakly_canonical(fs::absolute(path, error), error);
  while (!same_path(at, folder)) {
    if (!at.has_relative_path()) return false;
    at = at.parent_path();
  }
  return true;
}

Result<void> write_whole(OutputFile& file, const std::string& text) {
  const int handle = ::open(file.partial().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (handle < 0) {
    return fail("{}: cannot be written: {}", file.target().string(), system_message(errno));
  }
  int error = write_all(handle, text);
  if (close(handle) != 0 && error == 0) error = errno;
  if (error != 0) {
    return fail("{}: cannot be written: {}; free some space or choose another place",
                file.target().string(), system_message(error));
  }
  return {};
}

Result<void> write_text(OutputFile& file, const std::string& text) {
  PENUMBRA_TRY_VOID(write_whole(file, text));
  return file.commit();
}

}  // namespace penumbra
