// Renders grey images of tags by super-sampling the printed pattern through the full lens model.
// Shares no code with the tracker's image model, so that it does not share its approximations.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
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
  double white = 0.80;        // linear light of the paper
  double background = 0.35;   // linear light around the tags
  double gain = 1.0;          // exposure factor of black, white and background
  double gamma = 1.0;         // camera response: grey = 255 * linear ^ (1 / gamma)
  double noise_grey = 0.0;    // sigma of white noise, added after the camera response [grey levels]
  std::uint64_t seed = 1;
  int samples = 1024;             // sub-samples per pixel near an edge
  double covered_fraction = 0.0;  // occluded fraction of each tag's printed square, from its left
  double cover = 0.30;            // linear light of the occluding object
  // Rows [first_row, end_row) are rendered; other rows show the background.
  int first_row = 0;
  int end_row = std::numeric_limits<int>::max();
  int threads = 1;  // does not change the image
};

// Adds white noise to the colours of RGBA8, not to alpha. Reproducible on every machine.
void add_noise(std::span<std::uint8_t> rgba, double sigma_grey, std::uint64_t seed);

// Pose of a rigid group of tags.
struct GroupPlacement {
  std::string group;
  GroupPose T_table_group;
  // T_table_group at each pose of the camera's path during the exposure; empty: constant.
  std::vector<GroupPose> path = {};
};

class PatternRenderer {
 public:
  // Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<PatternRenderer> create(const CameraModel& camera,
                                                      std::span<const MappedTag> tags);
  PatternRenderer(PatternRenderer&&) noexcept;
  ~PatternRenderer();

  // Renders an exposure that consists of the poses of `path` for equal times. Omits tags whose back
  // faces the camera. Draws the nearest of overlapping tags.
  [[nodiscard]] GreyImage render(std::span<const CameraPose> path,
                                 const PatternRenderOptions& options,
                                 std::span<const GroupPlacement> placements = {});
  // Like render(), but returns linear light per pixel, without camera response, noise and rounding.
  [[nodiscard]] std::vector<double> render_light(std::span<const CameraPose> path,
                                                 const PatternRenderOptions& options,
                                                 std::span<const GroupPlacement> placements = {});

 private:
  struct Impl;
  explicit PatternRenderer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
