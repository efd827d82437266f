// Renders a synthetic recording with exact ground truth: tags seen by a moving camera
// (PatternRenderer) and the objects of a scene (compositor).
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "core/error.hpp"

namespace penumbra {

struct SimulateRequest {
  std::optional<std::filesystem::path> scene;  // empty: only the tags
  std::filesystem::path camera;                // camera.yaml
  std::string camera_name;                     // selects one camera of a file with several
  std::filesystem::path tags;                  // tags.yaml
  std::filesystem::path trajectory;            // TUM: one frame per pose, at its mid-exposure
  // TUM files of moving tag groups by name: T_table_group over the camera's times. With the
  // identity, the group has its pose of tags.yaml.
  std::map<std::string, std::filesystem::path> groups;
  std::filesystem::path output;  // new or empty folder
  double noise_grey = 0.0;       // sigma of white noise [grey levels]
  double exposure_s = 0.0;       // >= 0
  std::uint64_t seed = 1;
  // Camera response (gamma exponent): linear light = (value / 255) ^ exponent. Default: the
  // exponent of the camera file, or 1.
  std::optional<double> tone_curve;
  double gain = 1.0;              // factor of the light, > 0
  double lens_blur_px = 0.5;      // sigma, >= 0
  double covered_fraction = 0.0;  // covered fraction of each tag, from its left side: 0 to 1
  int cover_from = 0;             // first frame with covered tags
  int threads = 1;                // threads that draw the tags; do not affect the result
};

struct SimulateSummary {
  int frames = 0;
  bool interrupted = false;  // Ctrl-C: the recording ends with the last drawn frame
};

// The output folder appears when it is complete; an error leaves no files. The same request gives
// the same bytes (with a scene: with the same OpenGL driver).
[[nodiscard]] Result<SimulateSummary> run_simulate(const SimulateRequest& request);

}  // namespace penumbra
