// Renders grey images of tags by super-sampling the printed pattern through the full lens model. It
// shares no code with the tracker's image model, whose approximations it must not repeat.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

struct GreyImage {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;  // rows top to bottom, without padding

  [[nodiscard]] ImageView view() const { return {pixels.data(), width, height, width}; }
};

struct PatternRenderOptions {
  double lens_blur_px = 0.5;  // sigma of the Gaussian point spread; the pixel's box is added
  double black = 0.06;        // linear light of the ink, 1 = sensor full
  double white = 0.80;        // of the paper
  double background = 0.35;   // around the tags
  double gain = 1.0;          // factor of all three, by the exposure
  double gamma = 1.0;         // tone curve: grey = 255 * linear ^ (1 / gamma)
  double noise_grey = 0.0;    // sigma of white noise, added after the tone curve [grey levels]
  std::uint64_t seed = 1;
  int samples = 1024;  // per pixel that sees an edge
  // Covered share of each tag's printed square, from its left side, and the cover's light.
  double cover_share = 0.0;
  double cover = 0.30;
  // First row that is drawn and the one after the last; other rows show the background.
  int first_row = 0;
  int end_row = std::numeric_limits<int>::max();
  int threads = 1;  // the image is the same, bit for bit
};

// Adds white noise to each colour of RGBA8, not to alpha; the same on every machine.
void add_noise(std::span<std::uint8_t> rgba, double sigma_grey, std::uint64_t seed);

// Motion of a rigid group of tags from its place in the tag map.
struct GroupPlacement {
  std::string group;
  Transform<frame::Table, frame::Table> T_table_group;
  // Its places during the exposure, one for each of the camera's poses; empty: T_table_group.
  std::vector<Transform<frame::Table, frame::Table>> path = {};
};

class PatternRenderer {
 public:
  // Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<PatternRenderer> create(const CameraModel& camera,
                                                      std::span<const MappedTag> tags);
  PatternRenderer(PatternRenderer&&) noexcept;
  ~PatternRenderer();

  // Renders an exposure during which the camera takes the poses of `path` for equal times. Tags
  // seen from behind are not drawn; the nearest of overlapping tags is.
  [[nodiscard]] GreyImage render(std::span<const CameraPose> path,
                                 const PatternRenderOptions& options,
                                 std::span<const GroupPlacement> placements = {});
  // The same in linear light per pixel, without tone curve, noise and rounding.
  [[nodiscard]] std::vector<double> render_light(std::span<const CameraPose> path,
                                                 const PatternRenderOptions& options,
                                                 std::span<const GroupPlacement> placements = {});

 private:
  struct Impl;
  explicit PatternRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
