// Estimates the tone curve of a camera from images of known tags.
//
// Through a tone curve white bleeds into black, and every edge lies in the dark. With K and W the
// grey levels of black and white (0 to 1) and m the pattern's own blurred value, a pixel is
//
//   v = (K^g + (W^g - K^g) m)^(1/g),   linear light = v^g.
//
// g, the blur and each tag's K and W are fitted to the grey levels, where noise is about uniform
// (in linear light it is not, which biases the exponent), image by image; the estimate is their
// robust mean.
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

// Greatest error of a useful exponent [1 sigma]; a larger one does as much harm as no exponent.
inline constexpr double kGreatestToneSigma = 0.25;

struct ToneEstimate {
  double exponent = 1.0;  // linear light = (grey / 255) ^ exponent
  double sigma = 0.0;     // 1 sigma, by the scatter of the images and the error of the model
  double blur_px = 0.0;   // median sigma of the point spread, the pixel's box included
  int pictures = 0;
};

class ToneEstimator {
 public:
  // Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<ToneEstimator> create(const CameraModel& camera,
                                                    std::span<const MappedTag> tags);

  // Adds an image whose pose is known to a pixel or two at the tags. False if it is not used: the
  // pattern is not recognised, the tags are too small, too faint or overexposed, or the image is
  // blurred. Takes as long as some alignments of every pixel.
  bool add(ImageView luma, const CameraPose& T_table_camera);

  // Fails with too few images, and when they leave a sigma above kGreatestToneSigma. The same
  // images give the same bits.
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
  double blur_px_ = AlignmentOptions().blur_px;  // of the last image
};

}  // namespace penumbra
