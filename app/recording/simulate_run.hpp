// A synthetic recording with exact truth: tags under a moving camera, from the exact pattern
// renderer; a scene's objects on top, from the compositor.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "core/error.hpp"

namespace penumbra {

struct SimulateRequest {
  std::optional<std::filesystem::path> scene;  // none: the tags alone
  std::filesystem::path camera;                // camera.yaml
  std::string camera_name;                     // of a file with several
  std::filesystem::path tags;                  // tags.yaml
  std::filesystem::path trajectory;  // TUM: a frame for each pose, at the middle of its exposure
  // Of groups of tags that move, by their names: TUM, T_table_group over the same time; the
  // identity is where tags.yaml has the group.
  std::map<std::string, std::filesystem::path> groups;
  std::filesystem::path output;  // folder; made, or empty
  double noise_grey = 0.0;       // sigma of white noise [grey levels]
  double exposure_s = 0.0;       // >= 0
  std::uint64_t seed = 1;
  // Exponent of the tone curve, linear light = (value / 255) ^ exponent; none: the camera file's,
  // or 1 where it has none.
  std::optional<double> tone_curve;
  double gain = 1.0;          // of the light, > 0
  double lens_blur_px = 0.5;  // sigma of the lens's own blur, >= 0
  double cover_share = 0.0;   // of each tag, hidden from its left side: 0 to 1
  int cover_from = 0;         // the first frame of which this holds
  int threads = 1;            // that draw the tags; the pictures are the same, bit for bit
};

struct SimulateSummary {
  int frames = 0;
  bool interrupted = false;  // by Ctrl-C: the recording holds the frames up to then
};

// The folder appears under its name when it is whole; an error leaves nothing. The same request
// gives the same bytes (a scene: with the same OpenGL).
[[nodiscard]] Result<SimulateSummary> run_simulate(const SimulateRequest& request);

}  // namespace penumbra
