#include "app/output/png_writer.hpp"

#include <algorithm>
#include <cctype>
#include <string>
#include <system_error>
#include <vector>

#include "app/output/output_file.hpp"
#include "app/recording/recording_source.hpp"
#include "core/assert.hpp"
#include "core/image/image_file.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// As write() names them: 000000.png to 999999.png, and up to nine digits where there are that many
// frames. Pictures named by a time in nanoseconds are somebody's recording.
bool is_numbered_png(const fs::path& file) {
  const std::string stem = file.stem().string();
  return file.extension() == ".png" && stem.size() >= 6 && stem.size() <= 9 &&
         (stem.size() == 6 || stem[0] != '0') &&
         std::all_of(stem.begin(), stem.end(),
                     [](unsigned char c) { return std::isdigit(c) != 0; });
}

// Whether `folder` may be given away for a new set of numbered pictures.
Result<void> check_replaceable(const fs::path& folder) {
  std::error_code error;
  fs::path at = fs::canonical(folder, error);
  for (; !error && at.has_relative_path(); at = at.parent_path()) {
    if (is_recording(at)) {
      return fail("{}: belongs to the recording {}; name another folder", folder.string(),
                  at.string());
    }
  }
  fs::directory_iterator entries(folder, error);
  if (error)
    return fail("{}: cannot be read: {}; choose another place", folder.string(), error.message());
  for (const fs::directory_entry& entry : entries) {
    if (entry.symlink_status(error).type() != fs::file_type::regular ||
        !is_numbered_png(entry.path())) {
      return fail(
          "{}: holds {}, which is no numbered picture; name a new folder, or a file ending in .mkv "
          "or .mp4",
          folder.string(), entry.path().filename().string());
    }
  }
  return {};
}

// What is no numbered picture stays, and the folder with it.
void remove_pictures(const fs::path& folder) {
  std::error_code ignored;
  std::vector<fs::path> pictures;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ignored)) {
    if (is_numbered_png(entry.path())) pictures.push_back(entry.path());
  }
  for (const fs::path& picture : pictures) fs::remove(picture, ignored);
  fs::remove(folder, ignored);
}

class PngWriter final : public FrameWriter {
 public:
  PngWriter(fs::path folder, const FrameFormat& format)
      : folder_(std::move(folder)), format_(format) {}
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;
  ~PngWriter() override {
    if (finished_ || partial_.empty()) return;
    std::error_code ignored;
    fs::remove_all(partial_, ignored);
  }

  Result<void> prepare() {
    std::error_code error;
    // A link is written through, not replaced.
    folder_ = follow_links(folder_);
    const fs::file_status status = fs::status(folder_, error);
    if (fs::exists(status)) {
      if (!fs::is_directory(status)) {
        return fail("{}: is not a folder; name a folder, or a file ending in .mkv or .mp4",
                    folder_.string());
      }
      if (auto checked = check_replaceable(folder_); !checked) return checked;
    }
    error.clear();
    if (folder_.has_parent_path()) fs::create_directories(folder_.parent_path(), error);
    if (!error) partial_ = make_beside(error);
    if (error) {
      return fail("{}: cannot be made: {}; choose another place", folder_.string(),
                  error.message());
    }
    return {};
  }

  Result<void> write(std::uint64_t number, std::int64_t /*timestamp_ns*/,
                     std::span<const std::uint8_t> rgba) override {
    PENUMBRA_ASSERT(!finished_);
    const std::string name = fmt::format("{:06}.png", number);
    auto saved = save_png(partial_ / name, format_.width, format_.height, rgba);
    any_ = any_ || saved.has_value();
    if (saved) return saved;
    std::error_code ignored;
    fs::remove(partial_ / name, ignored);
    // By the name that the user gave, not by that of the folder that is filled meanwhile.
    return fail("{}; free some space or choose another place",
                renamed(saved.error(), partial_, folder_).message);
  }

  Result<void> finish() override {
    PENUMBRA_ASSERT(!finished_);
    if (!any_) return fail("{}: no frame was written", folder_.string());
    std::error_code error;
    if (!fs::exists(folder_, error)) {
      fs::rename(partial_, folder_, error);
    } else {
      // The names were checked at the start; anything put there since is not ours to remove.
      if (auto checked = check_replaceable(folder_); !checked) return checked;
      // Aside first: at no time is the old set gone and the new one not there.
      const fs::path aside = make_beside(error);
      if (!error) fs::rename(folder_, aside, error);
      if (!error) {
        fs::rename(partial_, folder_, error);
        std::error_code ignored;
        if (error) {
          fs::rename(aside, folder_, ignored);
        } else {
          remove_pictures(aside);
        }
      } else if (!aside.empty()) {
        std::error_code ignored;
        fs::remove(aside, ignored);
      }
    }
    if (error) {
      return fail("{}: cannot be written: {}; choose another place", folder_.string(),
                  error.message());
    }
    finished_ = true;
    return {};
  }

  void rescue() override { (void)finish(); }

 private:
  // A new, empty folder with a name of its own.
  [[nodiscard]] fs::path make_beside(std::error_code& error) const {
    for (int attempt = 0; attempt < kPartialAttempts; ++attempt) {
      const fs::path path = partial_path(folder_, attempt);
      if (fs::create_directory(path, error)) return path;
      if (error) return {};
    }
    error = std::make_error_code(std::errc::file_exists);
    return {};
  }

  fs::path folder_;
  fs::path partial_;  // empty before it is made
  FrameFormat format_;
  bool any_ = false;
  bool finished_ = false;
};

// "out/" and "out" are the same folder, but only one of them has a name to add ".partial" to.
fs::path without_trailing_slash(const fs::path& path) {
  return path.has_filename() ? path : path.parent_path();
}

}  // namespace

Result<std::unique_ptr<FrameWriter>> create_png_writer(const fs::path& folder,
                                                       const FrameFormat& format) {
  const fs::path name = without_trailing_slash(folder.lexically_normal());
  if (name.empty() || name == "." || name.filename() == ".." || name == name.root_path()) {
    return fail("{}: cannot hold pictures and nothing else; name a new folder", folder.string());
  }
  auto writer = std::make_unique<PngWriter>(name, format);
  PENUMBRA_TRY_VOID(writer->prepare());
  return writer;
}

}  // namespace penumbra
