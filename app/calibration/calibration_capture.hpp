// Selects the images of a camera, a recording or a folder that add information to a calibration as
// its views. Shows which views are still missing.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "app/calibration/guide_window.hpp"
#include "app/capture/live_source.hpp"
#include "app/interrupt.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/report/view_guide.hpp"
#include "core/error.hpp"

namespace penumbra {

struct CaptureOptions {
  GuideOptions guide;
  std::optional<double> duration_s;  // wall-clock time from the first image
  // Folder for the accepted views, saved as grey images 000000.png, ...; a calibration from this
  // folder reads the same pixels.
  std::optional<std::filesystem::path> keep;
};

// Creates CaptureOptions::keep. Fails if that folder exists and is not empty.
[[nodiscard]] Result<void> create_keep_folder(const std::filesystem::path& folder);

enum class CaptureEnd { enough, duration, no_more_images, closed, interrupted };

struct Capture {
  CaptureEnd end = CaptureEnd::no_more_images;
  int images = 0;                               // number of images checked
  int views = 0;                                // number of these accepted as views
  std::string rejection_reason;                 // most frequent reason for rejecting an image
  std::vector<std::string> target_differences;  // TagCensus::differences() of the images
};

using CaptureSource = std::variant<LiveSource*, std::filesystem::path>;
// Takes views for `calibrator` from the newest images of a camera, or from all images of a
// recording or folder, and prints a line for each view. `window`, if not nullptr, shows the images;
// otherwise a terminal on standard error shows progress bars. Ends when the views suffice (camera
// only), when the duration is over, on Ctrl-C, when the window is closed, or after the last image.
// Ctrl-C leaves `interrupt` cleared. Fails if the camera fails or a view can't be saved.
[[nodiscard]] Result<Capture> capture_views(const CaptureSource& source, const Target& target,
                                            CaptureOptions options, InterruptWatch& interrupt,
                                            CameraCalibrator& calibrator, GuideWindow* window);

}  // namespace penumbra
