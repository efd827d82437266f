// Aligns the printed pattern of known tags with an image, without tag detection.
//
// Starting from a predicted pose, it finds the pose that best explains the grey levels at the edges
// of all visible tags of one rigid group. The stages are a pattern search, a wide photometric stage
// if the search was inaccurate, and a fine photometric stage. Photometric stages solve for one
// SE(3) pose of all tags, with the full lens model, blurred edges, gain and offset per tag, and
// Tukey's weights. The tags' cells verify the pose. See docs/tracking.md#the-stages.
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
  fast,      // limited number of pixels
  accurate,  // every pixel at an edge
};

struct AlignmentOptions {
  AlignmentEffort effort = AlignmentEffort::fast;
  // Sigma of the point spread including the pixel's box: sqrt(0.25 + 1/12) px for a lens of 0.5 px.
  double blur_px = 0.58;
  // Camera response: linear light = (grey / 255) ^ exponent. The camera's tone_curve overrides it.
  double tone_exponent = 1.0;
  double min_cell_px = 0.8;            // tags with smaller cells are not used
  const simd::Loops* loops = nullptr;  // null: widest_loops()
};

// Prior of the velocity, given together with that of the pose.
struct VelocityPrior {
  Matrix6d covariance = Matrix6d::Zero();        // of AlignmentInput::velocity
  Matrix6d cross_covariance = Matrix6d::Zero();  // rows: velocity; columns: pose
};

// The camera's velocity at the image's middle row, estimated together with the pose.
struct VelocityEstimate {
  Vector6d velocity = Vector6d::Zero();    // as AlignmentInput::velocity
  Matrix6d covariance = Matrix6d::Zero();  // the prior included
  // For the pose's covariance if the image's errors are larger than assumed; with the information A
  // of pose and velocity and P^-1 of their prior: the pose's block of A^-1 P^-1 A^-1.
  Matrix6d prior_share = Matrix6d::Zero();
  // The image's information on the pose; the velocity is marginalised, with its prior for
  // a known pose.
  Matrix6d image_information = Matrix6d::Zero();
};

struct AlignmentInput {
  ImageView luma;
  MapFromCamera predicted;  // T_map_camera
  // Covariance of the prediction: T_map_camera * exp([nu; omega]) [m, rad], camera frame.
  Matrix6d covariance = Matrix6d::Identity();
  // The camera's motion during the exposure as [nu; omega]; zero if unknown.
  Vector6d exposure_motion = Vector6d::Zero();
  // The camera's velocity at the image's middle row, T_map_camera * exp(t * velocity) [m/s,
  // rad/s], for the rolling shutter; zero when unknown.
  Vector6d velocity = Vector6d::Zero();
  // If given, a camera with a rolling shutter solves for pose and velocity together. Otherwise
  // `velocity` is taken as exact.
  std::optional<VelocityPrior> velocity_prior;
  // Initial number of samples if sampling may stop early (set_sample_need()); 0: few.
  int first_samples = 0;
  // AlignmentCounters::far_start of the previous frame: if true, begins with few samples.
  bool starts_far = false;
  std::span<const int> rejected;  // tags to ignore, as indices into the list of create()
  // AlignmentCounters::contrast of the previous frame; a similar peak ends a search. 0: unknown.
  double previous_contrast = 0.0;
  // If above 0, the pose is the one that fits best if the map has displaced every tag
  // independently, with this standard deviation per axis [m]. For known velocities only. See
  // docs/tracking.md#displaced-tags.
  double map_sigma_m = 0.0;
};

// Tags are inconsistent with the map if AlignmentResult::disagreement is at least this.
inline constexpr double kInconsistentDisagreement = 9.0;

struct TagAlignment {
  int index = 0;  // index into the list of create()
  bool verified = false;
  double gain = 0.0;          // white - black [grey levels of linearised light]
  double weight_share = 0.0;  // fraction of the samples' weight that Tukey's weights leave
  // Fraction of the variance of its cells that the model explains; negative for too few cells.
  double explained = -1.0;
  bool inconsistent = false;  // the cells are read correctly, but the edges are displaced
  double cell_px = 0.0;       // smaller width of a cell
};

struct AlignmentCounters {
  int tags_visible = 0;           // visible at the pose; they may be occluded or missing
  int tags_in_image = 0;          // visible tags with enough cells inside the image
  int tags_out_of_view = 0;       // tags not used: outside the image or facing away
  int tags_too_small = 0;         // tags not used: cells below min_cell_px
  bool sampling_stopped = false;  // the sample need was met before all pixels were used
  int searched_px = 0;            // number of displacements in all search windows
  double contrast = 0.0;          // white minus black cells at the position found [grey]
  bool wide_stage = true;         // the wide stage ran
  int samples = 0;                // number of samples in the final fine round
  bool far_start = false;         // the first fine round moved the tags so far that it was repeated
};

struct AlignmentResult {
  bool verified = false;
  MapFromCamera T_map_camera;
  Matrix6d covariance = Matrix6d::Zero();    // as in MapPoseEstimate, the prior included
  std::optional<VelocityEstimate> velocity;  // if the velocity was solved for
  double residual_rms = 0.0;                 // weighted, as a share of the gain
  // Variance of an edge's mean residual, divided by its variance for independent residuals.
  double design_effect = 1.0;
  double displacement_px = 0.0;  // RMS displacement of whole tags from the map [px]; 0: unknown
  // Variance of that displacement over its variance for independent residuals; 1: unknown.
  double disagreement = 1.0;
  // Pose covariance caused by errors of the map (two to four tags); zero if they are below noise.
  Matrix6d map_covariance = Matrix6d::Zero();
  bool map_inconsistent = false;  // the map's errors are significant at 1 %
  int inconsistent_tag = -1;      // index of the tag whose removal makes the others agree; -1: none
  std::vector<TagAlignment> tags;  // the visible tags
  int tags_verified = 0;
  AlignmentCounters counters;
  std::string_view reason;  // why the pose is not verified
};

// Number of correlated samples that carry the information of one independent sample.
[[nodiscard]] double variance_inflation(const AlignmentResult& result);

// A pixel near an edge of a tag: value in the image and value of the model at the aligned pose.
struct EdgePixel {
  int tag = 0;              // index into AlignmentResult::tags
  float grey = 0.0F;        // as captured, 0 to 255
  float model = 0.0F;       // the pattern's blurred value, 0 black to 1 white
  float model_blur = 0.0F;  // d model / d log(blur)
};

// Returns the factor by which an alignment must increase its samples; <= 1: they are enough.
using SampleNeed = std::function<double(const AlignmentResult&)>;

// Pose error that motion blur makes unobservable, 1 sigma.
struct MotionBlurError {
  double shift_px = 0.0;  // common displacement of all tags, RMS over the tags in the image
  // Covariance of the pose if the tags are displaced independently, as AlignmentResult::covariance.
  Matrix6d covariance = Matrix6d::Zero();
  // The fraction of the motion that explains the image best; zero: sharp image or unknown motion.
  Vector6d motion = Vector6d::Zero();
};

// align(), refine() and search_pyramid() begin a new frame and discard the previous result; they
// keep only the options and the sample need. motion_blur_error() and edge_pixels() use the state of
// the latest align() or refine(): do not call search_pyramid() in between.
class TagAligner {
 public:
  // `tags` must belong to one rigid group. Fails if a tag's id does not exist in its family.
  [[nodiscard]] static Result<TagAligner> create(const CameraModel& camera,
                                                 std::span<const MappedTag> tags,
                                                 const AlignmentOptions& options = {});
  TagAligner(TagAligner&&) noexcept;
  ~TagAligner();

  [[nodiscard]] const AlignmentOptions& options() const;
  void set_effort(AlignmentEffort effort);
  void set_tone_exponent(double exponent);
  void set_blur(double blur_px);
  // Makes sampling start with few pixels and continue until `need` is met or the limit of the
  // effort is reached.
  void set_sample_need(SampleNeed need);

  // The image must have the camera's size. The same input gives the same bits.
  [[nodiscard]] AlignmentResult align(const AlignmentInput& input);

  // Verifies and refines a pose from another source (a detection) without a search.
  [[nodiscard]] AlignmentResult refine(const AlignmentInput& input);

  // Searches a reduced image, which has a larger range; `further`: a smaller image. Returns a
  // start for an alignment, which may be off by some pixels or wrong; nullopt if no tag is found.
  [[nodiscard]] std::optional<MapFromCamera> search_pyramid(const AlignmentInput& input,
                                                            bool further);

  // Estimates the error of the latest alignment's pose along a motion that blurred the image, in
  // addition to its covariance. Zero for a sharp image or a blur below a cell.
  // - `motion`: during the exposure; nullopt if unknown.
  // - `known`: false if the exposure covers an unknown fraction of `motion`.
  // - `longest_cells`: maximum blur in any direction for tags that `motion` does not explain.
  [[nodiscard]] MotionBlurError motion_blur_error(const std::optional<Vector6d>& motion, bool known,
                                                  double longest_cells = 0.0);

  // Returns all pixels at edges of verified tags. The image must exist and have no motion blur.
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();

 private:
  struct Impl;
  explicit TagAligner(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
