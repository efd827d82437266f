// Views for a calibration from a camera that runs: taken by themselves when they say something new,
// with a bar for each thing that is still missing.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "app/calibration/guide_window.hpp"
#include "app/capture/live_source.hpp"
#include "app/interrupt.hpp"
#include "calib/camera_calibration.hpp"
#include "calib/report/view_guide.hpp"
#include "core/error.hpp"

namespace penumbra {

// "[######    ] image   60 %   [####      ] size ..."
[[nodiscard]] std::string guide_text(const GuideProgress& progress);

struct CaptureOptions {
  GuideOptions guide;
  std::optional<double> duration_s;  // from the first picture, by the clock
  // Views that are taken are kept here, as 000000.png, 000001.png, ...: grey, so that calibrating
  // from the folder has the same bytes to look at.
  std::optional<std::filesystem::path> keep;
};

// Makes the folder for views that are kept. Fails where it holds anything.
[[nodiscard]] Result<void> create_keep_folder(const std::filesystem::path& folder);

enum class CaptureEnd { enough, duration, no_more, closed, interrupted };

struct Capture {
  CaptureEnd end = CaptureEnd::no_more;
  int pictures = 0;     // that were looked at
  int views = 0;        // of them, that were taken
  std::string why_not;  // most often told of the others
};

// From a camera. Always looks at the newest picture. What is taken goes to `calibrator`, and is
// told on standard output, a line each; `window`, where there is one, shows what was looked at,
// else the bars stand on standard error where that is a terminal. Ends when it is enough, after the
// duration, by Ctrl-C (the next one is asked for anew), when the window is closed, and when the
// camera gives no more. Fails when the camera does, and when a view can't be kept.
[[nodiscard]] Result<Capture> capture_views(LiveSource& source, const Target& target,
                                            const CaptureOptions& options,
                                            InterruptWatch& interrupt, CameraCalibrator& calibrator,
                                            GuideWindow* window);
// From a recording or a folder of pictures, as if it were a camera: looks at each of them, in order
// and to the end, as fast as that goes. Pictures that can't be read are `calibrator`'s to tell.
[[nodiscard]] Result<Capture> capture_views(const std::filesystem::path& recording,
                                            const Target& target, const CaptureOptions& options,
                                            InterruptWatch& interrupt, CameraCalibrator& calibrator,
                                            GuideWindow* window);

}  // namespace penumbra
