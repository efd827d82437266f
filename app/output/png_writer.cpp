#include "app/output/frame_writer.hpp"

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

// Returns true for the names that write() uses: 000000.png to 999999.png, and up to nine digits for
// more frames. Images named by a time in nanoseconds belong to a recording.
bool is_numbered_png(const fs::path& file) {
  const std::string stem = file.stem().string();
  return file.extension() == ".png" && stem.size() >= 6 && stem.size() <= 9 &&
         (stem.size() == 6 || stem[0] != '0') &&
         std::ranges::all_of(stem, [](unsigned char c) { return std::isdigit(c) != 0; });
}

// Fails if the folder must not be replaced by a new set of numbered images.
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
          "{}: holds {}, which is not a numbered image; name a new folder, or a file ending in "
          ".mkv or .mp4",
          folder.string(), entry.path().filename().string());
    }
  }
  return {};
}

// Removes the numbered images, and the folder if it contains no other files.
void remove_images(const fs::path& folder) {
  std::error_code ignored;
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, ignored)) {
    if (is_numbered_png(entry.path())) files.push_back(entry.path());
  }
  for (const fs::path& image : files) fs::remove(image, ignored);
  fs::remove(folder, ignored);
}

class PngWriter final : public FrameWriter {
 public:
  explicit PngWriter(const FrameFormat& format) : format_(format) {}

  Result<void> prepare(const fs::path& folder) {
    std::error_code error;
    const fs::path target = follow_links(folder);  // a link is written through, not replaced
    const fs::file_status status = fs::status(target, error);
    if (fs::exists(status)) {
      if (!fs::is_directory(status)) {
        return fail("{}: is not a folder; name a folder, or a file ending in .mkv or .mp4",
                    target.string());
      }
      PENUMBRA_TRY_VOID(check_replaceable(target));
    }
    return folder_.create(target);
  }

  Result<void> write(std::uint64_t number, std::int64_t /*timestamp_ns*/,
                     std::span<const std::uint8_t> rgba) override {
    PENUMBRA_ASSERT(!finished_);
    const fs::path file = folder_.partial() / fmt::format("{:06}.png", number);
    auto saved = save_png(file, format_.width, format_.height, rgba);
    any_ = any_ || saved.has_value();
    if (saved) return saved;
    std::error_code ignored;
    fs::remove(file, ignored);
    return fail("{}; free some space or choose another place",
                folder_.failed(saved.error()).value().message);
  }

  Result<void> finish() override {
    PENUMBRA_ASSERT(!finished_);
    const fs::path& target = folder_.target();
    if (!any_) return fail("{}: no frame was written", target.string());
    std::error_code error;
    const bool replaces = fs::exists(target, error);
    // Checked again, because another program may have added files since the start.
    if (replaces) PENUMBRA_TRY_VOID(check_replaceable(target));
    fs::path old;
    error = folder_.commit(replaces ? &old : nullptr);
    if (error) {
      return fail("{}: cannot be written: {}; choose another place", target.string(),
                  error.message());
    }
    if (replaces) remove_images(old);
    finished_ = true;
    return {};
  }

  void rescue() override { (void)finish(); }

 private:
  OutputFolder folder_;
  FrameFormat format_;
  bool any_ = false;
  bool finished_ = false;
};

}  // namespace

Result<std::unique_ptr<FrameWriter>> create_png_writer(const fs::path& folder,
                                                       const FrameFormat& format) {
  const fs::path name = folder_name(folder);
  if (name.empty() || name == "." || name.filename() == ".." || name == name.root_path()) {
    return fail("{}: cannot hold images and nothing else; name a new folder", folder.string());
  }
  auto writer = std::make_unique<PngWriter>(format);
  PENUMBRA_TRY_VOID(writer->prepare(name));
  return writer;
}

}  // namespace penumbra
