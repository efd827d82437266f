#include "app/output/output_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>
#include <utility>
#include <vector>

namespace penumbra {
namespace {

namespace fs = std::filesystem;

std::string message_of(int error) {
  return std::generic_category().message(error);
}

}  // namespace

Result<OutputFile> OutputFile::create(const fs::path& target) {
  if (target.empty()) return fail("the output path is empty; name a file");
  OutputFile file;
  std::error_code error;
  // A link is written through, not replaced.
  file.asked_ = target;
  file.target_ = follow_links(target);
  const fs::file_status status = fs::status(file.target_, error);
  if (fs::is_directory(status)) {
    return fail("{}: is a folder; name a file", target.string());
  }
  const fs::path parent =
      file.target_.has_parent_path() ? file.target_.parent_path() : fs::path(".");
  if (!fs::is_directory(parent, error)) {
    return fail("{}: cannot be written: there is no folder {}; make it or choose another place",
                target.string(), parent.string());
  }
  file.direct_ = fs::exists(status) && !fs::is_regular_file(status);
  int handle = -1;
  if (file.direct_) {
    file.partial_ = file.target_;
    handle = open(file.partial_.c_str(), O_WRONLY | O_CLOEXEC | O_NONBLOCK);
  } else {
    for (int attempt = 0; attempt < kPartialAttempts; ++attempt) {
      file.partial_ = partial_path(file.target_, attempt);
      handle = open(file.partial_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
      if (handle >= 0 || errno != EEXIST) break;
    }
  }
  if (handle < 0) {
    const std::string cause = message_of(errno);
    file.partial_.clear();
    return fail("{}: cannot be written: {}; choose another place or free this one", target.string(),
                cause);
  }
  close(handle);
  return file;
}

OutputFile::OutputFile(OutputFile&& other) noexcept
    : asked_(std::move(other.asked_)),
      target_(std::move(other.target_)),
      partial_(std::exchange(other.partial_, {})),
      direct_(other.direct_) {}

OutputFile& OutputFile::operator=(OutputFile&& other) noexcept {
  if (this != &other) {
    discard();
    asked_ = std::move(other.asked_);
    target_ = std::move(other.target_);
    partial_ = std::exchange(other.partial_, {});
    direct_ = other.direct_;
  }
  return *this;
}

OutputFile::~OutputFile() {
  discard();
}

void OutputFile::discard() noexcept {
  if (partial_.empty() || direct_) return;
  std::error_code ignored;
  fs::remove(partial_, ignored);
}

Result<void> OutputFile::commit() {
  if (!direct_) {
    std::error_code error;
    fs::rename(partial_, target_, error);
    if (error) {
      return fail("{}: cannot be written: {}; choose another place", asked_.string(),
                  error.message());
    }
  }
  partial_.clear();
  return {};
}

// What was at the path until now, as one more name for it; empty where nothing was. A file system
// without hard links gets a copy.
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
  for (OutputFile* file : files) {
    Result<fs::path> old = file->direct_ ? Result<fs::path>() : keep_old(file->target_);
    result =
        old ? file->commit() : tl::unexpected(renamed(old.error(), file->target_, file->asked_));
    if (old && !file->direct_) {
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
  return tl::unexpected(renamed(cause, partial_, asked_));
}

Error renamed(const Error& error, const fs::path& written, const fs::path& asked) {
  const std::string from = written.string();
  const std::string to = asked.string();
  Error told = error;
  if (from.empty()) return told;
  for (std::size_t at = told.message.find(from); at != std::string::npos;
       at = told.message.find(from, at + to.size())) {
    told.message.replace(at, from.size(), to);
  }
  return told;
}

fs::path partial_path(const fs::path& target, int attempt) {
  fs::path path = target;
  path += fmt::format(".partial-{}-{}", getpid(), attempt);
  return path;
}

fs::path follow_links(const fs::path& path) {
  constexpr int kMostLinks = 40;  // as the kernel's own limit
  fs::path at = path;
  std::error_code error;
  for (int i = 0; i < kMostLinks && fs::is_symlink(at, error); ++i) {
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
    if (outputs[i].empty()) continue;
    const auto is_same = [&](const fs::path& other) {
      return !other.empty() && same_path(outputs[i], other);
    };
    if (std::ranges::any_of(inputs, is_same) || std::ranges::any_of(outputs.first(i), is_same)) {
      return fail("{}: is named for something else too; name files of their own",
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
  const int handle = open(file.partial().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (handle < 0) {
    return fail("{}: cannot be written: {}", file.target().string(), message_of(errno));
  }
  std::size_t done = 0;
  int error = 0;
  while (done < text.size() && error == 0) {
    const ssize_t count = write(handle, text.data() + done, text.size() - done);
    if (count >= 0) {
      done += static_cast<std::size_t>(count);
    } else if (errno != EINTR) {
      error = errno;
    }
  }
  if (close(handle) != 0 && error == 0) error = errno;
  if (error != 0) {
    return fail("{}: cannot be written: {}; free some space or choose another place",
                file.target().string(), message_of(error));
  }
  return {};
}

Result<void> write_text(OutputFile& file, const std::string& text) {
  if (auto written = write_whole(file, text); !written) return written;
  return file.commit();
}

}  // namespace penumbra
