// A synthetic recording with exact ground truth: tags under a moving camera from PatternRenderer,
// and a scene's objects from the compositor.
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
  std::string camera_name;                     // in a file with several cameras
  std::filesystem::path tags;                  // tags.yaml
  std::filesystem::path trajectory;  // TUM: a frame per pose, at the middle of its exposure
  // Moving groups of tags by name: TUM, T_table_group over the same time; the identity leaves the
  // group as in tags.yaml.
  std::map<std::string, std::filesystem::path> groups;
  std::filesystem::path output;  // new or empty folder
  double noise_grey = 0.0;       // sigma of white noise [grey levels]
  double exposure_s = 0.0;       // >= 0
  std::uint64_t seed = 1;
  // Camera response (gamma exponent): linear light = (value / 255) ^ exponent. Empty: as in the
  // camera file, or 1.
  std::optional<double> tone_curve;
  double gain = 1.0;          // of the light, > 0
  double lens_blur_px = 0.5;  // sigma, >= 0
  double cover_share = 0.0;   // covered part of each tag, from its left side: 0 to 1
  int cover_from = 0;         // first frame with covered tags
  int threads = 1;            // for drawing the tags; any number gives the same bits
};

struct SimulateSummary {
  int frames = 0;
  bool interrupted = false;  // by Ctrl-C: the recording ends with the last drawn frame
};

// The folder appears when it is complete; an error leaves nothing. The same request gives the same
// bytes (with a scene: on the same OpenGL).
[[nodiscard]] Result<SimulateSummary> run_simulate(const SimulateRequest& request);

}  // namespace penumbra
