// Aligns the printed pattern of known tags with an image, without detecting tags.
//
// From a predicted pose it finds the pose that best explains the grey levels around the edges of
// all visible tags of one rigid group. A pattern search brings the prediction within a cell. A wide
// photometric stage, skipped where the search ended near enough, and a fine one solve one SE(3)
// pose over all tags with the full lens model (closed-form blurred edges, gain and offset per tag,
// Tukey's weights). The pose counts once the cells decode at it. See docs/tracking.md.
#pragma once

#include <Eigen/Core>
#include <cstdint>
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

enum class AlignmentEffort {
  fast,  // up to about `samples` pixels in all, and from three tags on `samples_per_tag` of each
  accurate,  // every pixel at an edge
};

struct AlignmentOptions {
  AlignmentEffort effort = AlignmentEffort::fast;
  int samples_per_tag = 400;
  int samples = 1920;  // of all tags together, where that gives a tag 128 or more; fast only
  // Sigma of the point spread, the pixel's box included: a lens of 0.5 px gives
  // sqrt(0.25 + 1/12) px.
  double blur_px = 0.58;
  // Camera response: linear light = (grey / 255) ^ exponent. The camera model's own replaces it.
  double tone_exponent = 1.0;
  double min_cell_px = 0.7;               // tags whose cells are smaller are not used
  const char* instruction_set = nullptr;  // name of the SIMD loops to use; null: the widest
};

struct AlignmentInput {
  ImageView luma;
  CameraPose predicted;  // T_table_camera
  // Covariance of the prediction: T_table_camera * exp([nu; omega]) [m, rad], camera frame.
  Matrix6d covariance = Matrix6d::Identity();
  // The camera's motion during the exposure, the same kind of vector; zero when unknown.
  Vector6d exposure_motion = Vector6d::Zero();
  // The camera's velocity at the image's middle row, T_table_camera * exp(t * velocity)
  // [m/s, rad/s]: with a rolling shutter each row is modelled from where it was read out. Zero when
  // unknown.
  Vector6d velocity = Vector6d::Zero();
  // Number of samples to begin with where sampling may stop early (set_sample_need); 0: few.
  int first_samples = 0;
  // True if the fine stage probably begins far from its end, as the last frame's did
  // (AlignmentCounters::far_start): it then begins with few samples.
  bool starts_far = false;
  // Tags that are not looked at, as places in the list given to create.
  std::span<const int> rejected;
  // How clearly the search saw the tags in the last frame (AlignmentCounters::contrast): where they
  // are seen as clearly near by, the search ends there. 0: unknown.
  double seen_contrast = 0.0;
};

// Result of the pattern search, before pixels at edges are read.
struct SearchedPose {
  CameraPose T_table_camera;
  // Error of the image of a tag's corner, the worst of those in view [px], 1 sigma, by how well the
  // tags agree; infinite: unknown.
  double error_px = 0.0;
};

// AlignmentResult::disagreement from which on the tags do not lie as the map says.
inline constexpr double kDisagree = 9.0;

struct TagAlignment {
  int index = 0;  // in the list given to create
  bool verified = false;
  double gain = 0.0;          // white - black [grey levels of linearised light]
  double offset = 0.0;        // black [the same]
  int cells_read = 0;         // data cells that were decided
  int cells_wrong = 0;        // of these
  double weight_share = 0.0;  // of the samples, after Tukey's weights
  // Share of the variance of the tag's cells in the image that the model explains; negative where
  // too few cells are seen.
  double explained = -1.0;
  bool displaced = false;  // its cells read right, its edges are elsewhere
  double cell_px = 0.0;    // the shorter way across one of its cells
};

struct AlignmentCounters {
  int tags_visible = 0;           // by the pose alone: they may be covered, or missing
  int tags_in_image = 0;          // of these, with enough cells inside the image to be read
  int tags_out_of_view = 0;       // or seen from behind: not used
  int tags_too_small = 0;         // not used
  bool sampling_stopped = false;  // before all pixels were taken
  int searched_points = 0;        // of all windows that were searched
  int searched_px = 0;            // places in these windows
  double contrast = 0.0;          // of white over black cells where the search found them [grey]
  bool wide_stage = true;         // whether the wide stage ran
  int samples = 0;                // of the last fine round
  int evaluations = 0;            // of the normal equations of all tags
  std::int64_t samples_evaluated = 0;  // in all of these
  int fine_rounds = 0;
  bool far_start = false;   // the first fine round moved the tags so far that it was repeated
  bool second_try = false;  // whether the tags were searched for independently
};

struct AlignmentResult {
  bool verified = false;
  CameraPose T_table_camera;
  Matrix6d covariance = Matrix6d::Zero();  // as in PoseEstimate, the prior included
  double residual_rms = 0.0;               // weighted, as a share of the gain
  // Variance of an edge's mean residual over that of independent residuals. The covariance is that
  // of independent ones.
  double design_effect = 1.0;
  // Displacement of the tags from where the map has them, each as a whole: RMS of those that took
  // part [px], and its variance over what independent residuals leave of it. Of three tags and
  // more, else 0 and 1.
  double displaced_px = 0.0;
  double disagreement = 1.0;
  // Covariance of the pose by wrong places in the map, as far as the tags in view contradict them
  // beyond noise; mostly zero. map_contradicted: noise would do as much to one in a hundred. Of two
  // to four tags.
  Matrix6d map_covariance = Matrix6d::Zero();
  bool map_contradicted = false;
  // The tag without which the others agree, in the list given to create; -1: none.
  int contradicting = -1;
  std::vector<TagAlignment> tags;  // the visible ones
  int tags_verified = 0;
  AlignmentCounters counters;
  std::string_view reason;  // why it is not verified
};

// Number of correlated samples that carry the information of one independent sample: residuals
// along an edge are correlated.
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
  // Displacement of all tags together, RMS over those in the image.
  double shift_px = 0.0;
  // Covariance of the pose where each tag is displaced by itself, which turns the pose. As
  // AlignmentResult::covariance.
  Matrix6d covariance = Matrix6d::Zero();
  // The part of the motion that explains the image best, as AlignmentInput::exposure_motion; zero
  // where the image is sharp or the motion unknown.
  Vector6d motion = Vector6d::Zero();
};

class TagAligner {
 public:
  // `tags`: of one rigid group. Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<TagAligner> create(const CameraModel& camera,
                                                 std::span<const MappedTag> tags,
                                                 const AlignmentOptions& options = {});
  TagAligner(TagAligner&&) noexcept;
  TagAligner& operator=(TagAligner&&) noexcept;
  ~TagAligner();

  [[nodiscard]] const AlignmentOptions& options() const;
  void set_effort(AlignmentEffort effort);
  void set_tone_exponent(double exponent);
  void set_blur(double blur_px);
  // Sampling then begins with few pixels and continues, up to what the effort allows, until `need`
  // has enough. None: what the effort allows.
  void set_sample_need(SampleNeed need);

  // The image's size must be the camera's. The same input gives the same bits.
  [[nodiscard]] AlignmentResult align(const AlignmentInput& input);

  // Verifies a pose from elsewhere (a detection) as align does its own, and refines it without a
  // search.
  [[nodiscard]] AlignmentResult refine(const AlignmentInput& input);

  // The pose by the pattern search alone, as align begins with it. Nothing where the tags are not
  // found.
  [[nodiscard]] std::optional<SearchedPose> search(const AlignmentInput& input);

  // The same in a smaller image, which reaches as many times further: a guess to align from, off by
  // some pixels or entirely wrong. `further`: in one smaller again, where a cell is less than a
  // pixel. Nothing where no tag is seen.
  [[nodiscard]] std::optional<CameraPose> search_pyramid(const AlignmentInput& input, bool further);

  // How far off the pose of the last alignment may be along a motion that blurred the image, beyond
  // its covariance. `motion`: of the exposure, as AlignmentInput::exposure_motion; where it is not
  // `known`, the longest one, and the image decides which part of it there was. Nothing where the
  // blur is shorter than a cell or the image sharp: an edge then has one place. `longest_cells`:
  // where the motion itself may be wrong, the longest blur in any direction that may explain the
  // rest of the image [cells]; 0 where the motion is right.
  [[nodiscard]] MotionBlurError motion_blur_error(const Vector6d& motion, bool known,
                                                  double longest_cells = 0.0);
  // The same where nothing is known of the motion.
  [[nodiscard]] MotionBlurError motion_blur_error(double longest_cells);

  // The pixels at the edges of the tags that the last alignment verified, as many of each as the
  // effort allows. The aligned image must still exist, and its camera rest (no velocity, no motion
  // during the exposure).
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();

 private:
  struct Impl;
  explicit TagAligner(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
