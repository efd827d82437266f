// Exact pictures of tags: poses -> grey image, by super-sampling the printed pattern through the
// full lens model. Nothing here is shared with the tracker's own image model: what the tracker is
// measured against must not repeat its approximations.
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
  double lens_blur_px =
      0.5;                   // sigma of the Gaussian point spread; the pixel's own box comes on top
  double black = 0.06;       // linear light of the ink, 1 = sensor full
  double white = 0.80;       // of the paper
  double background = 0.35;  // around the tags
  double gain = 1.0;         // exposure: multiplies all three
  double gamma = 1.0;        // tone curve: grey = 255 * linear ^ (1 / gamma)
  double noise_grey = 0.0;   // sigma of white noise, added after the tone curve [grey levels]
  std::uint64_t seed = 1;
  int samples = 1024;  // per pixel that sees an edge
  // Share of each tag's printed square that something covers, from its left side; its light.
  double cover_share = 0.0;
  double cover = 0.30;
  // The rows that are drawn, the first and one past the last; the others show the background.
  int first_row = 0;
  int end_row = std::numeric_limits<int>::max();
  int threads = 1;  // that draw; the picture is the same, bit for bit
};

// White noise of `sigma_grey` grey levels on RGBA8, each colour for itself, the same on every
// machine; alpha stays.
void add_noise(std::span<std::uint8_t> rgba, double sigma_grey, std::uint64_t seed);

// Where a rigid group of tags has moved to, from its place in the tag map.
struct GroupPlacement {
  std::string group;
  Transform<frame::Table, frame::Table> T_table_group;
  // Of a group that moves during the exposure: its places, one for each of the camera's poses;
  // none: it stays at T_table_group.
  std::vector<Transform<frame::Table, frame::Table>> path = {};
};

class PatternRenderer {
 public:
  // Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<PatternRenderer> create(const CameraModel& camera,
                                                      std::span<const MappedTag> tags);
  PatternRenderer(PatternRenderer&&) noexcept;
  PatternRenderer& operator=(PatternRenderer&&) noexcept;
  ~PatternRenderer();

  // The picture of an exposure during which the camera takes the poses of `path`, each for the same
  // share of the time (one pose: no motion). Tags seen from behind are not drawn; the nearest of
  // overlapping tags wins.
  [[nodiscard]] GreyImage render(std::span<const CameraPose> path,
                                 const PatternRenderOptions& options,
                                 std::span<const GroupPlacement> placements = {});
  // The same before the tone curve, the noise and the rounding: linear light per pixel.
  [[nodiscard]] std::vector<double> render_light(std::span<const CameraPose> path,
                                                 const PatternRenderOptions& options,
                                                 std::span<const GroupPlacement> placements = {});

 private:
  struct Impl;
  explicit PatternRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
