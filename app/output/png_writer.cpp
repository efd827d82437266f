#include "app/output/png_writer.hpp"

#include <algorithm>
#include <cctype>
#include <string_view>

#include "core/assert.hpp"
#include "core/image_file.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

bool is_numbered_png(const fs::path& file) {
  const std::string stem = file.stem().string();
  return file.extension() == ".png" && stem.size() >= 6 &&
         std::all_of(stem.begin(), stem.end(),
                     [](unsigned char c) { return std::isdigit(c) != 0; });
}

// Whether `folder` may be given away for a new set of numbered pictures.
Result<void> check_replaceable(const fs::path& folder) {
  std::error_code error;
  for (const char* file : {"timestamps.csv", "camera.yaml", "tags.yaml"}) {
    if (fs::exists(folder.parent_path() / file, error) && folder.filename() == "frames") {
      return fail("{}: holds the frames of the recording {}; name another folder", folder.string(),
                  folder.parent_path().string());
    }
  }
  fs::directory_iterator entries(folder, error);
  if (error) return fail("{}: cannot be read: {}", folder.string(), error.message());
  for (const fs::directory_entry& entry : entries) {
    if (!entry.is_regular_file(error) || !is_numbered_png(entry.path())) {
      return fail(
          "{}: holds {}, which is no numbered picture; name a new folder, or a file ending in .mkv "
          "or .mp4",
          folder.string(), entry.path().filename().string());
    }
  }
  return {};
}

class PngWriter final : public FrameWriter {
 public:
  PngWriter(fs::path folder, const FrameFormat& format)
      : folder_(std::move(folder)), partial_(folder_), format_(format) {
    partial_ += ".partial";
  }
  PngWriter(const PngWriter&) = delete;
  PngWriter& operator=(const PngWriter&) = delete;
  ~PngWriter() override {
    if (finished_ || !owns_partial_) return;
    std::error_code ignored;
    fs::remove_all(partial_, ignored);
  }

  Result<void> prepare() {
    std::error_code error;
    const fs::file_status status = fs::status(folder_, error);
    if (fs::exists(status)) {
      if (!fs::is_directory(status)) {
        return fail("{}: is no folder; name a folder, or a file ending in .mkv or .mp4",
                    folder_.string());
      }
      if (auto checked = check_replaceable(fs::absolute(folder_)); !checked) return checked;
    }
    if (fs::exists(partial_, error)) {
      // Left over from a run that was killed; nothing but pictures of ours may go.
      if (auto checked = check_replaceable(partial_); !checked) return checked;
      fs::remove_all(partial_, error);
    }
    fs::create_directories(partial_, error);
    if (error) {
      return fail("{}: cannot be made: {}; choose another place", folder_.string(),
                  error.message());
    }
    owns_partial_ = true;
    return {};
  }

  Result<void> write(std::uint64_t number, std::int64_t /*timestamp_ns*/,
                     std::span<const std::uint8_t> rgba) override {
    PENUMBRA_ASSERT(!finished_);
    any_ = true;
    return save_png(partial_ / fmt::format("{:06}.png", number), format_.width, format_.height,
                    rgba);
  }

  Result<void> finish() override {
    PENUMBRA_ASSERT(!finished_);
    if (!any_) return fail("{}: no frame was written", folder_.string());
    std::error_code error;
    // The names were checked at the start; anything put there since is not ours to remove.
    if (fs::exists(folder_, error)) {
      if (auto checked = check_replaceable(fs::absolute(folder_)); !checked) return checked;
      fs::remove_all(folder_, error);
    }
    fs::rename(partial_, folder_, error);
    if (error) {
      return fail("{}: cannot be written: {}; choose another place", folder_.string(),
                  error.message());
    }
    finished_ = true;
    return {};
  }

 private:
  fs::path folder_;
  fs::path partial_;
  FrameFormat format_;
  bool owns_partial_ = false;
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
  if (auto prepared = writer->prepare(); !prepared) return tl::unexpected(prepared.error());
  return writer;
}

}  // namespace penumbra
