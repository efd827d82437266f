// The tone curve of a camera, from pictures of known tags.
//
// Cameras store light through a curve that lifts dark tones, and printing and glare do alike: in
// the picture white bleeds into black, and every edge lies in the dark. An edge's profile shows by
// how much. With K and W the grey levels of black and white (0 to 1) and m the pattern's own
// blurred value, 0 to 1, a pixel is
//   v = (K^g + (W^g - K^g) m)^(1/g),   linear light = v^g,
// and g, the blur and each tag's K and W are fitted to the grey levels themselves, where noise is
// about the same everywhere (in linear light it is not, which biases the exponent of least
// residuals). Picture by picture; what they agree in is the estimate.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/image_view.hpp"

namespace penumbra {

// A tone curve has to be known at least so well [1 sigma]: an exponent that is off by more does as
// much harm as none.
inline constexpr double kToneKnown = 0.25;

struct ToneEstimate {
  double exponent = 1.0;  // linear light = (grey / 255) ^ exponent
  double sigma = 0.0;     // 1 sigma, of the pictures' scatter and of what the model misses
  double blur_px = 0.0;   // sigma of the point spread, the pixel's box included; the middle one
  int pictures = 0;
};

class ToneEstimator {
 public:
  // Fails when a tag's id does not exist in its family.
  [[nodiscard]] static Result<ToneEstimator> create(const CameraModel& camera,
                                                    std::span<const MappedTag> tags);
  ToneEstimator(ToneEstimator&&) noexcept;
  ToneEstimator& operator=(ToneEstimator&&) noexcept;
  ~ToneEstimator();

  // A picture whose pose is known to a pixel or two at the tags: its exponent joins the estimate.
  // False when it says nothing: the pattern is not recognised there, the tags are too small, too
  // faint or overexposed, or the picture is blurred. Takes as long as some alignments of every
  // pixel.
  bool add(ImageView luma, const CameraPose& T_table_camera);
  [[nodiscard]] int pictures() const;

  // Fails with too few pictures, and when they do not fix an exponent to kToneKnown. The same
  // pictures give the same bits.
  [[nodiscard]] Result<ToneEstimate> estimate() const;

 private:
  struct Impl;
  explicit ToneEstimator(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
