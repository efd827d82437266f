// Takes views for a calibration from a running camera when they add information, and shows what is
// still missing.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <variant>

#include "app/calibration/guide_window.hpp"
#include "app/capture/live_source.hpp"
#include "app/interrupt.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/report/view_guide.hpp"
#include "core/error.hpp"

namespace penumbra {

struct CaptureOptions {
  GuideOptions guide;
  std::optional<double> duration_s;  // from the first image, by the clock
  // Folder for the views that are taken, as grey images 000000.png, ...: a calibration from it gets
  // the same bytes.
  std::optional<std::filesystem::path> keep;
};

// Creates the folder for views that are kept. Fails if it is not empty.
[[nodiscard]] Result<void> create_keep_folder(const std::filesystem::path& folder);

enum class CaptureEnd { enough, duration, no_more, closed, interrupted };

struct Capture {
  CaptureEnd end = CaptureEnd::no_more;
  int pictures = 0;     // images that were checked
  int views = 0;        // of these, taken
  std::string why_not;  // most frequent reason of the others
};

// Takes views for `calibrator` from the newest images of a camera, or from all images of a
// recording or a folder, and prints a line for each. `window`, if any, shows the images; else a
// terminal on standard error shows bars. Ends when the views are enough (a recording: all are
// checked), after the duration, by Ctrl-C (then the next one counts again), when the window is
// closed, and when the images end. Fails if the camera does, or if a view can't be kept.
using CaptureSource = std::variant<LiveSource*, std::filesystem::path>;
[[nodiscard]] Result<Capture> capture_views(const CaptureSource& source, const Target& target,
                                            CaptureOptions options, InterruptWatch& interrupt,
                                            CameraCalibrator& calibrator, GuideWindow* window);

}  // namespace penumbra
