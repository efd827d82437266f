// Frame to frame: the known tag pattern is laid over the grey levels, with no detection.
//
// From a predicted pose the camera's pose is found that explains the grey levels around the edges
// of all visible tags of one rigid group best: a code search brings the prediction within a cell, a
// wide photometric stage, where the search did not end near enough for it, and a fine one
// (closed-form blurred edges, gain and offset per tag, Tukey's weights) solve one SE(3) pose over
// all tags with the full lens model, and the cells are decoded at the solved pose before it counts.
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
  fast,  // up to about `samples` pixels in all, of three tags and more `samples_per_tag` of each
  accurate,  // every pixel at an edge
};

struct AlignmentOptions {
  AlignmentEffort effort = AlignmentEffort::fast;
  int samples_per_tag = 400;
  int samples = 1920;  // of all tags together, where that gives a tag 128 and more; fast only
  // Sigma of the point spread, the pixel's box included: a lens of 0.5 px gives
  // sqrt(0.25 + 1/12) px.
  double blur_px = 0.58;
  // Linear light = (grey / 255) ^ exponent; the camera model's tone curve where it has one.
  double tone_exponent = 1.0;
  double min_cell_px = 0.7;               // tags whose cells are smaller across are left out
  const char* instruction_set = nullptr;  // name of the SIMD variant to use; null: the widest
};

struct AlignmentInput {
  ImageView luma;
  CameraPose predicted;  // T_table_camera
  // Of the prediction: T_table_camera * exp([nu; omega]) [m, rad], camera frame.
  Matrix6d covariance = Matrix6d::Identity();
  // The camera's motion during the exposure, the same kind of vector; zero when unknown.
  Vector6d exposure_motion = Vector6d::Zero();
  // The camera's velocity at the picture's middle row, T_table_camera * exp(t * velocity)
  // [m/s, rad/s]: where the camera model has a rolling shutter, rows are looked at from where they
  // were read out. Zero when unknown.
  Vector6d velocity = Vector6d::Zero();
  // Where sampling may stop early (set_sample_need): begin with so many in all; 0: with few.
  int first_samples = 0;
  // Whether the fine stage is likely to begin far from its end, as the last frame's did
  // (AlignmentCounters::far_start): it then begins with few samples.
  bool starts_far = false;
  // Of tags, in the list given to create: those that are not looked at.
  std::span<const int> left_out;
  // How clearly the search saw the tags in the last frame (AlignmentCounters::contrast): seen so
  // near by, they are not looked for further off. 0: unknown.
  double seen_contrast = 0.0;
};

// What the code search says before any pixel at an edge is read.
struct SearchedPose {
  CameraPose T_table_camera;
  // How far off it puts a tag's corner in the image, the worst of those in view [px], 1 sigma, by
  // how well the tags agree; infinite: too few to say, or cells that the search has not seen the
  // end of.
  double error_px = 0.0;
};

// From here on tags do not lie to each other as the map says, by more than noise:
// AlignmentResult::disagreement.
inline constexpr double kDisagree = 9.0;

struct TagAlignment {
  int index = 0;  // in the list given to create
  bool verified = false;
  double gain = 0.0;          // white - black [grey levels of linearised light]
  double offset = 0.0;        // black [the same]
  int cells_read = 0;         // data cells that were decided
  int cells_wrong = 0;        // of these
  double weight_share = 0.0;  // of the samples, after Tukey's weights
  // What share of the variance of its cells in the picture the model has; negative where too few of
  // them are seen.
  double explained = -1.0;
  bool displaced = false;  // its cells read right, its edges are elsewhere
  double cell_px = 0.0;    // the shorter way across one of its cells
};

struct AlignmentCounters {
  int tags_visible = 0;           // by the pose alone: they may be covered, or not there
  int tags_in_picture = 0;        // of these, with enough cells inside it to be read
  int tags_out_of_view = 0;       // or seen from behind: not looked at
  int tags_too_small = 0;         // the same
  bool sampling_stopped = false;  // where sampling may stop early: before all pixels were taken
  int searched_points = 0;        // of all windows that were searched
  int searched_px = 0;            // places in these windows
  double contrast = 0.0;          // of white over black cells where the search found them [grey]
  bool wide_stage = true;         // whether the fine stage needed to be brought near
  int samples = 0;                // of the last fine stage
  int evaluations = 0;            // of the sums over all tags
  std::int64_t samples_evaluated = 0;  // in all of these
  int fine_rounds = 0;
  bool far_start = false;   // the first of these moved the tags by so much that it was repeated
  bool second_try = false;  // whether the wider search was needed
};

struct AlignmentResult {
  bool verified = false;
  CameraPose T_table_camera;
  Matrix6d covariance = Matrix6d::Zero();  // as in PoseEstimate, the prior included
  double residual_rms = 0.0;               // weighted, as a share of the gain
  // Variance of an edge's mean residual over that of independent ones: how many samples are worth
  // one. The covariance is that of independent ones.
  double design_effect = 1.0;
  // How far the tags lie from where the map has them, each as a whole, when the pose is solved: RMS
  // of those that took part [px]; and the variance of that over what independent residuals leave
  // of it, 1 where these are all there is. Of three tags and more, else 0 and 1.
  double displaced_px = 0.0;
  double disagreement = 1.0;
  // Of the pose, because of places in the map that are wrong, as far as the tags in view contradict
  // them: the mean of what noise does is taken out of it, and zero is what is left mostly.
  // map_contradicted: noise would do as much to one in a hundred. Of two to four tags.
  Matrix6d map_covariance = Matrix6d::Zero();
  bool map_contradicted = false;
  // The tag without which the others agree, in the list given to create; -1: there is none, or they
  // agree as it is.
  int contradicting = -1;
  std::vector<TagAlignment> tags;  // the visible ones
  int tags_verified = 0;
  AlignmentCounters counters;
  std::string_view reason;  // why it is not verified
};

// Number of correlated samples that carry the information of one independent sample: residuals
// along an edge are correlated.
[[nodiscard]] double variance_inflation(const AlignmentResult& result);

// A pixel near an edge of a tag, as the picture has it and as the pattern at the aligned pose
// would.
struct EdgePixel {
  int tag = 0;              // in AlignmentResult::tags
  float grey = 0.0F;        // as captured, 0 to 255
  float model = 0.0F;       // the pattern's blurred value, 0 black to 1 white
  float model_blur = 0.0F;  // its derivative by the logarithm of the blur
};

// How many times more samples an alignment needs, from its pose, covariance, design effect and
// counters so far; 1 and less: it has enough.
using SampleNeed = std::function<double(const AlignmentResult&)>;

// What a smear of the picture hides of the pose, 1 sigma.
struct MotionBlurError {
  // By which all tags may be off together, RMS over those in the picture.
  double shift_px = 0.0;
  // Of the pose, where each of them is off by itself: that turns it. As
  // AlignmentResult::covariance.
  Matrix6d covariance = Matrix6d::Zero();
  // The part of the motion that explains the picture best, as AlignmentInput::exposure_motion; zero
  // where the picture is clear, or the motion not told.
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
  // Sampling then begins with few pixels and goes on, up to what the effort allows, until `need`
  // has enough. None: what the effort allows.
  void set_sample_need(SampleNeed need);

  // The image's size must be the camera's. Same input, same bits.
  [[nodiscard]] AlignmentResult align(const AlignmentInput& input);

  // Verifies a pose that came from elsewhere (a detection) as align does its own, and refines it
  // with no search.
  [[nodiscard]] AlignmentResult refine(const AlignmentInput& input);

  // Where the code search alone would put the camera, as align begins with it. Nothing where the
  // tags are not found.
  [[nodiscard]] std::optional<SearchedPose> search(const AlignmentInput& input);

  // The same in a picture made smaller, which reaches as many times further: a guess to align from,
  // off by some pixels or all wrong. `further`: in one smaller again, where a cell is less than a
  // pixel. Nothing where no tag is seen.
  [[nodiscard]] std::optional<CameraPose> search_pyramid(const AlignmentInput& input, bool further);

  // How far off, along a motion that smeared the picture, the last pose (verified) may be by what
  // the equations don't know. `motion`: what went on during the exposure, as
  // AlignmentInput::exposure_motion; where that is not `known`, the most that may have, and how
  // much of it did the picture says. Nothing where the smear is shorter than a cell, or the picture
  // as clear as if it were: then an edge has but one place to be. `longest_cells`: where the motion
  // itself may be wrong, what it doesn't explain of the picture may be a smear over up to so many
  // cells in any direction; 0 where it is right.
  [[nodiscard]] MotionBlurError motion_blur_error(const Vector6d& motion, bool known,
                                                  double longest_cells = 0.0);
  // The same where nothing is known of the motion: of a smear over up to so many cells, in any
  // direction.
  [[nodiscard]] MotionBlurError motion_blur_error(double longest_cells);

  // The pixels at the edges of the tags that the last alignment verified, as many of each as the
  // effort allows. The picture that was aligned must still be there, and its camera at rest (no
  // velocity, no motion during the exposure).
  [[nodiscard]] std::vector<EdgePixel> edge_pixels();

 private:
  struct Impl;
  explicit TagAligner(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
