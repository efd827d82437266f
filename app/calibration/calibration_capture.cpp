#include "app/calibration/calibration_capture.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <functional>
#include <map>
#include <stop_token>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "app/calibration/image_folder.hpp"
#include "app/capture/mailbox.hpp"
#include "app/capture/newest_image.hpp"
#include "app/logging.hpp"
#include "core/image/image_file.hpp"
#include "core/propagate.hpp"
#include "core/stopwatch.hpp"
#include "tracking/detection/image_check.hpp"

namespace penumbra {
namespace {

using ImageVisitor = std::function<Result<bool>(const NamedImage&)>;
// Calls `visit` for each image until it returns false or an error, or a stop is requested.
using ImageFeed =
    std::function<Result<void>(const ImageVisitor& visit, const std::stop_token& stop)>;

ImageFeed newest_image_feed(LiveSource& source) {
  return [&source](const ImageVisitor& visit, const std::stop_token& stop) -> Result<void> {
    constexpr std::chrono::milliseconds kTakeTimeout(50);
    NewestImage images(source);
    std::vector<std::uint8_t> scratch;
    while (!stop.stop_requested()) {
      // Queried before take(), because the last image may arrive between the two calls.
      const bool finished = images.finished();
      const std::optional<Frame> frame = images.take(kTakeTimeout);
      if (!frame && finished) {
        if (const auto error = images.error()) return tl::unexpected(*error);
        return {};
      }
      if (!frame) continue;
      NamedImage image;
      image.name = "an image";
      image.timestamp_ns = frame->timestamp_ns;
      image.frame = *frame;
      image.luma = luma(*frame, scratch);
      PENUMBRA_TRY(const bool more, visit(image));
      if (!more) return {};
    }
    return {};
  };
}

ImageFeed all_of(const std::filesystem::path& recording) {
  return [recording](const ImageVisitor& visit, const std::stop_token& stop) {
    return for_each_image(recording, [&](const NamedImage& image) -> Result<bool> {
      if (stop.stop_requested()) return false;
      return visit(image);
    });
  };
}

std::string bar(const char* name, double fraction) {
  constexpr int kWidth = 10;
  const int filled = std::clamp(static_cast<int>(fraction * kWidth), 0, kWidth);
  return fmt::format("{} [{:#<{}}{: <{}}]", name, "", filled, "", kWidth - filled);
}

// Returns "image [######    ]  size [####      ] ...".
std::string guide_text(const GuideProgress& progress) {
  return fmt::format("{}  {}  {}  {}  {} views; {}", bar("image", progress.image),
                     bar("size", progress.size), bar("tilt", progress.tilt),
                     bar("certainty", progress.certainty), progress.views, progress.advice);
}

// Checks images one by one on its own thread, because solving for a view would block the window.
class ImageChecker {
 public:
  struct CheckedImage {
    Frame frame;
    GuideResult look;
    GuideProgress progress;
  };

  ImageChecker(ImageFeed image_feed, const CaptureOptions& options, CameraCalibrator& calibrator,
               ViewGuide guide, std::optional<ImageCheck> check, std::optional<TagCensus> census,
               std::stop_source stop, bool bars)
      : image_feed_(std::move(image_feed)),
        calibrator_(calibrator),
        options_(options),
        guide_(std::move(guide)),
        check_(std::move(check)),
        census_(std::move(census)),
        stop_(std::move(stop)),
        bars_(bars),
        thread_([this] { run(); }) {}
  ImageChecker(const ImageChecker&) = delete;
  ImageChecker& operator=(const ImageChecker&) = delete;
  ~ImageChecker() { stop(); }

  // Returns the newest checked image, or nullopt after `timeout`.
  [[nodiscard]] std::optional<CheckedImage> take(std::chrono::milliseconds timeout) {
    return checked_images_.take(timeout);
  }
  [[nodiscard]] bool finished() const { return checked_images_.finished(); }
  // Ends the thread; after that the caller may use the calibrator.
  void stop() {
    stop_.request_stop();
    if (thread_.joinable()) thread_.join();
  }
  // Call this after stop().
  [[nodiscard]] const std::optional<Error>& error() const { return error_; }
  [[nodiscard]] Capture capture(CaptureEnd end) const {
    Capture capture;
    capture.end = guide_.progress().enough ? CaptureEnd::enough : end;
    capture.images = images_checked_;
    capture.views = guide_.progress().views;
    if (census_) capture.target_differences = census_->differences();
    int max_times = 0;
    for (const auto& [why, times] : reasons_) {
      if (times > max_times) capture.rejection_reason = why;
      max_times = std::max(max_times, times);
    }
    return capture;
  }

 private:
  void run() {
    try {
      const auto done = image_feed_([this](const NamedImage& image) { return check_image(image); },
                                    stop_.get_token());
      if (!done) error_ = done.error();
    } catch (const std::exception& error) {
      error_ = Error{error.what()};
    }
    checked_images_.close();
  }

  // Returns false if the capture should end.
  [[nodiscard]] Result<bool> check_image(const NamedImage& image) {
    ++images_checked_;
    for (const std::string& notice : image.notices) log_warning("{}", notice);
    if (image.luma.empty()) {
      calibrator_.add_unreadable(image.name, image.unreadable);
      ++reasons_["can't be read"];
      return true;
    }
    if (width_ == 0) {
      width_ = image.luma.width;
      height_ = image.luma.height;
    } else if (image.luma.width != width_ || image.luma.height != height_) {
      return fail(
          "{}: is {} x {} px, but those before are {} x {}; give images of one camera and "
          "one size",
          image.name, image.luma.width, image.luma.height, width_, height_);
    }
    GuideResult look = guide_.look(image.luma);
    if (check_ && !look.corners.empty()) check_.reset();
    note_tags(image.luma, look);
    if (image.timestamp_ns) calibrator_.add_motion(*image.timestamp_ns, look.corners);
    if (check_) {
      if (const auto fault = check_->check_untagged(image.luma)) {
        return fail("{}: {}", image.name, advice(*fault));
      }
    }
    const GuideProgress& progress = guide_.progress();
    if (look.taken) {
      PENUMBRA_TRY_VOID(add_view(image.luma, progress));
    } else {
      ++reasons_[look.why];
    }
    if (bars_) {
      fmt::print(stderr, "\r{}{}\033[K", guide_text(progress),
                 look.taken ? "" : fmt::format(" ({})", look.why));
      std::fflush(stderr);
    }
    checked_images_.put({image.frame, std::move(look), progress});
    // A recording is always read to its end.
    return !options_.guide.held || !progress.enough;
  }

  // Replaces the reason of an image without the target if it shows another sheet.
  void note_tags(ImageView image, GuideResult& look) {
    if (!census_) return;
    census_->add(look.tags, image);
    if (look.taken || !look.tags.seen.empty()) return;
    if (auto differences = census_->differences(); !differences.empty())
      look.why = std::move(differences.front());
  }

  [[nodiscard]] Result<void> add_view(ImageView image, const GuideProgress& progress) {
    std::string name = fmt::format("view {}", progress.views);
    std::string file;
    if (options_.keep) {
      name = fmt::format("{:06}.png", progress.views - 1);
      const std::filesystem::path path = *options_.keep / name;
      PENUMBRA_TRY_VOID(save_grey_png(path, image));
      file = fmt::format(" ({})", path.string());
    }
    PENUMBRA_TRY_VOID(calibrator_.add(name, image));
    if (bars_) std::fputs("\r\033[K", stderr);
    fmt::print("view {}{}: image {:.0f} %, size {:.0f} %, tilt {:.0f} %, {}; {}{}\n",
               progress.views, file, 100.0 * progress.image, 100.0 * progress.size,
               100.0 * progress.tilt,
               progress.largest_px ? fmt::format("projection to {:.2f} px", *progress.largest_px)
                                   : std::string("no lens yet"),
               options_.guide.held && !progress.enough ? "next: " : "", progress.advice);
    std::fflush(stdout);
    return {};
  }

  const ImageFeed image_feed_;
  CameraCalibrator& calibrator_;
  const CaptureOptions& options_;
  ViewGuide guide_;
  std::optional<ImageCheck> check_;  // set until the target is detected for the first time
  std::optional<TagCensus> census_;  // for targets with tags
  std::stop_source stop_;
  const bool bars_;
  // Only the thread uses the members below until it ends.
  std::optional<Error> error_;
  int images_checked_ = 0;
  int width_ = 0;
  int height_ = 0;
  std::map<std::string, int> reasons_;  // counts of reasons for rejecting images
  Mailbox<CheckedImage> checked_images_;
  std::thread thread_;  // declared last, because the thread uses the other members
};

}  // namespace

Result<void> create_keep_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!error && !std::filesystem::is_empty(folder, error) && !error) {
    return fail("{}: holds files already; name a new folder for the views", folder.string());
  }
  if (error) {
    return fail("{}: is not a folder that can be made and written: {}", folder.string(),
                error.message());
  }
  return {};
}

Result<Capture> capture_views(const CaptureSource& source, const Target& target,
                              CaptureOptions options, InterruptWatch& interrupt,
                              CameraCalibrator& calibrator, GuideWindow* window) {
  constexpr std::chrono::milliseconds kPollInterval(30);  // for the window and Ctrl-C
  LiveSource* const* camera = std::get_if<LiveSource*>(&source);
  std::stop_source stop;
  options.guide.held = camera != nullptr;
  options.guide.stop = stop.get_token();
  PENUMBRA_TRY(auto guide, ViewGuide::create(target, options.guide));
  std::optional<ImageCheck> check;
  std::optional<TagCensus> census;
  if (target.tags) {
    PENUMBRA_TRY(check, ImageCheck::create(*target.tags));
    census.emplace(*target.tags);
  }
  const bool bars = window == nullptr && isatty(STDERR_FILENO) == 1;
  CaptureEnd end = CaptureEnd::no_more_images;
  ImageChecker checker(
      camera != nullptr ? newest_image_feed(**camera) : all_of(std::get<1>(source)), options,
      calibrator, std::move(guide), std::move(check), std::move(census), stop, bars);
  for (std::optional<Stopwatch> since_first; !checker.finished();) {
    auto checked = checker.take(kPollInterval);
    if (checked && !since_first) since_first.emplace();
    if (window != nullptr) {
      if (checked) {
        auto shown =
            window->show(checked->frame, std::move(checked->look), std::move(checked->progress));
        if (!shown && !window->display_lost()) return tl::unexpected(shown.error());
      }
      window->refresh();
    }
    if (interrupt.interrupted()) {
      end = CaptureEnd::interrupted;
      interrupt.clear_interrupted();  // the views may suffice; another Ctrl-C stops the solver
    } else if (window != nullptr && window->closed()) {
      end = CaptureEnd::closed;
      if (window->display_lost()) {
        log_warning("the connection to the display was lost; going on with the views taken so far");
      }
    } else if (options.duration_s && since_first &&
               since_first->elapsed().wall_ms >= 1e3 * *options.duration_s) {
      end = CaptureEnd::duration;
    }
    if (end != CaptureEnd::no_more_images) break;
  }
  checker.stop();
  if (bars) std::fputs("\r\033[K", stderr);
  if (checker.error()) return tl::unexpected(*checker.error());
  return checker.capture(end);
}

}  // namespace penumbra
