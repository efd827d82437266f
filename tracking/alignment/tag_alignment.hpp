// Aligns the printed pattern of known tags with an image, without detecting tags.
//
// From a predicted pose it finds the pose that best explains the grey levels around the edges of
// all visible tags of one rigid group: a pattern search, a wide photometric stage where the search
// ended too far off, and a fine one. Photometric stages solve one SE(3) pose over all tags with the
// full lens model, blurred edges, gain and offset per tag, and Tukey's weights. The pose is
// verified by the tags' cells. See docs/tracking.md#the-stages.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/pose_refiner.hpp"

namespace penumbra {

namespace simd {
struct Loops;
}

enum class AlignmentEffort {
  fast,      // a limited number of pixels
  accurate,  // every pixel at an edge
};

struct AlignmentOptions {
  AlignmentEffort effort = AlignmentEffort::fast;
  // Sigma of the point spread, the pixel's box included: sqrt(0.25 + 1/12) px for a lens of 0.5 px.
  double blur_px = 0.58;
  // Camera response: linear light = (grey / 255) ^ exponent. The camera model's own replaces it.
  double tone_exponent = 1.0;
  double min_cell_px = 0.7;            // tags with smaller cells are not used
  const simd::Loops* loops = nullptr;  // null: those for the widest instruction set
};

struct AlignmentInput {
  ImageView luma;
  MapFromCamera predicted;  // T_map_camera
  // Covariance of the prediction: T_map_camera * exp([nu; omega]) [m, rad], camera frame.
  Matrix6d covariance = Matrix6d::Identity();
  // The camera's motion during the exposure, a vector like [nu; omega]; zero when unknown.
  Vector6d exposure_motion = Vector6d::Zero();
  // The camera's velocity at the image's middle row, T_map_camera * exp(t * velocity) [m/s,
  // rad/s], for the rolling shutter; zero when unknown.
  Vector6d velocity = Vector6d::Zero();
  // Number of samples to begin with, if sampling may stop early (set_sample_need); 0: few.
  int first_samples = 0;
  // AlignmentCounters::far_start of the last frame: the fine stage then begins with few samples.
  bool starts_far = false;
  std::span<const int> rejected;  // tags that are not used, as indices into the list of create()
  // AlignmentCounters::contrast of the last frame: a search that reaches it ends. 0: unknown.
  double seen_contrast = 0.0;
};

// AlignmentResult::disagreement from which on the tags do not lie as the map says.
inline constexpr double kDisagree = 9.0;

struct TagAlignment {
  int index = 0;  // in the list of create()
  bool verified = false;
  double gain = 0.0;          // white - black [grey levels of linearised light]
  double weight_share = 0.0;  // of the samples, after Tukey's weights
  // Share of the variance of its cells that the model explains; negative with too few cells.
  double explained = -1.0;
  bool inconsistent = false;  // its cells read right, its edges are elsewhere
  double cell_px = 0.0;       // the smaller width of a cell
};

struct AlignmentCounters {
  int tags_visible = 0;           // by the pose alone: they may be covered, or missing
  int tags_in_image = 0;          // visible ones with enough cells inside the image to be read
  int tags_out_of_view = 0;       // or seen from behind: not used
  int tags_too_small = 0;         // not used
  bool sampling_stopped = false;  // before all pixels were taken
  int searched_px = 0;            // displacements in all windows that were searched
  double contrast = 0.0;          // of white over black cells where the search found them [grey]
  bool wide_stage = true;         // the wide stage ran
  int samples = 0;                // of the last fine round
  bool far_start = false;         // the first fine round moved the tags so far that it was repeated
};

struct AlignmentResult {
  bool verified = false;
  MapFromCamera T_map_camera;
  Matrix6d covariance = Matrix6d::Zero();  // as in MapPoseEstimate, the prior included
  double residual_rms = 0.0;               // weighted, as a share of the gain
  // Variance of an edge's mean residual over that of independent residuals, as in `covariance`.
  double design_effect = 1.0;
  // RMS displacement of whole tags from the map [px], and its variance over that expected from
  // independent residuals; of three tags and more, else 0 and 1.
  double displacement_px = 0.0;
  double disagreement = 1.0;
  // Pose covariance by wrong places of two to four tags in the map, beyond noise; mostly zero.
  // map_inconsistent: at a significance of 1 %.
  Matrix6d map_covariance = Matrix6d::Zero();
  bool map_inconsistent = false;
  int inconsistent_tag = -1;       // index of the tag without which the others agree; -1: none
  std::vector<TagAlignment> tags;  // the visible ones
  int tags_verified = 0;
  AlignmentCounters counters;
  std::string_view reason;  // why it is not verified
};

// Number of correlated samples that carry the information of one independent sample.
[[nodiscard]] double variance_inflation(const AlignmentResult& result);

// A pixel near an edge of a tag, in the image and by the pattern at the aligned pose.
struct EdgePixel {
  int tag = 0;              // in AlignmentResult::tags
  float grey = 0.0F;        // as captured, 0 to 255
  float model = 0.0F;       // the pattern's blurred value, 0 black to 1 white
  float model_blur = 0.0F;  // its derivative by the logarithm of the blur
};

// Factor of samples that an alignment still needs, given its result so far; 1 or less: enough.
using SampleNeed = std::function<double(const AlignmentResult&)>;

// Pose error that motion blur hides, 1 sigma.
struct MotionBlurError {
  double shift_px = 0.0;  // displacement of all tags together, RMS over those in the image
  // Covariance of the pose where the tags are displaced independently, as
  // AlignmentResult::covariance.
  Matrix6d covariance = Matrix6d::Zero();
  // The part of the motion that explains the image best; zero: sharp image or unknown motion.
  Vector6d motion = Vector6d::Zero();
};

// align(), refine() and search_pyramid() begin a new frame and forget the last result; only the
// options and the sample need survive. motion_blur_error() and edge_pixels() read the state of the
// last align() or refine(), so no search_pyramid() may come between.
class TagAligner {
 public:
  // `tags`: of one rigid group. Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<TagAligner> create(const CameraModel& camera,
                                                 std::span<const MappedTag> tags,
                                                 const AlignmentOptions& options = {});
  TagAligner(TagAligner&&) noexcept;
  ~TagAligner();

  [[nodiscard]] const AlignmentOptions& options() const;
  void set_effort(AlignmentEffort effort);
  void set_tone_exponent(double exponent);
  void set_blur(double blur_px);
  // Sampling then begins with few pixels and continues, up to the limit of the effort, until `need`
  // is met.
  void set_sample_need(SampleNeed need);

  // The image's size must be the camera's. The same input gives the same bits.
  [[nodiscard]] AlignmentResult align(const AlignmentInput& input);

  // Verifies and refines a pose from elsewhere (a detection) without a search.
  [[nodiscard]] AlignmentResult refine(const AlignmentInput& input);

  // Searches a smaller image, which reaches further: a guess to align from, off by some pixels or
  // entirely wrong. `further`: in one smaller again. Nothing where no tag is seen.
  [[nodiscard]] std::optional<MapFromCamera> search_pyramid(const AlignmentInput& input,
                                                            bool further);

  // Estimates the error of the last alignment's pose along a motion that blurred the image, beyond
  // its covariance; zero for a sharp image or a blur below a cell. `motion`: of the exposure;
  // nothing: unknown. Not `known`: the longest one, of which the image shows a part.
  // `longest_cells`: the longest blur in any direction that explains the rest of the image, where
  // the motion may be wrong; else 0.
  [[nodiscard]] MotionBlurError motion_blur_error(const std::optional<Vector6d>& motion, bool known,
                                                  double longest_cells = 0.0);

  // All pixels at the edges of verified tags. The aligned image must exist, and its camera rest.
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();

 private:
  struct Impl;
  explicit TagAligner(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
