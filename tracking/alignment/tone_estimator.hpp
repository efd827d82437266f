// Estimates the camera response (gamma exponent) from images of known tags.
//
// A non-linear response shifts blurred edges towards black. With the grey levels K of black and W
// of white (0 to 1), and the pattern's blurred value m, a pixel is
//
//   v = (K^g + (W^g - K^g) m)^(1/g),   linear light = v^g.
//
// For each image, g, the blur and each tag's K and W are fitted to the grey levels, because their
// noise is about uniform; in linear light it is not, which would bias the exponent. The estimate is
// a robust mean over the images.
#pragma once

#include <span>
#include <utility>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"
#include "tracking/alignment/tag_alignment.hpp"

namespace penumbra {

// Maximum sigma of an exponent that improves on an unknown exponent.
inline constexpr double kMaxToneSigma = 0.25;

struct ToneEstimate {
  double exponent = 1.0;  // linear light = (grey / 255) ^ exponent
  double sigma = 0.0;     // sigma of `exponent`, from the images' scatter and the model error
  double blur_px = 0.0;   // median sigma of the point spread, including the pixel's box
  int images = 0;
};

class ToneEstimator {
 public:
  // Fails if a tag's id does not exist in its family.
  [[nodiscard]] static Result<ToneEstimator> create(const CameraModel& camera,
                                                    std::span<const MappedTag> tags);

  // Adds an image with a pose that is accurate to 1 or 2 px at the tags. Returns false if the image
  // is not used: the pattern is not recognised, the tags are too small, too faint or overexposed,
  // or the image is blurred. Takes as long as several accurate alignments.
  bool add(ImageView luma, const CameraPose& T_table_camera);

  // Fails for too few images, or if sigma exceeds kMaxToneSigma. The same images give the same
  // bits.
  [[nodiscard]] Result<ToneEstimate> estimate() const;

 private:
  struct ImageTone {
    double exponent = 1.0;
    double sigma = 0.0;
    double blur_px = 0.0;
  };
  ToneEstimator(CameraModel camera, TagAligner aligner)
      : camera_(std::move(camera)), aligner_(std::move(aligner)) {}

  CameraModel camera_;
  TagAligner aligner_;
  std::vector<ImageTone> found_;
  double blur_px_ = AlignmentOptions().blur_px;  // blur found in the previous usable image
};

}  // namespace penumbra
