#include "tracking/detection/tag_detector.hpp"

#include <apriltag/apriltag.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "core/assert.hpp"
#include "tracking/detection/tag_families.hpp"

namespace penumbra {
namespace {

// libapriltag 3.3.0 reads outside its buffers if an image has fewer than 3 rows or columns of 4x4
// px threshold tiles. Below this size [px], after decimation, no tag is readable.
constexpr int kSmallestSide = 16;
constexpr int kLargestSide = 32767;         // libapriltag's cluster points are 16-bit half pixels
constexpr int kMaxCorrectedBits = 1;        // detections with more wrong bits are rejected
constexpr double kDecodeSharpening = 0.25;  // libapriltag's default

struct DestroyDetections {
  void operator()(zarray_t* detections) const { apriltag_detections_destroy(detections); }
};

// Returns true if the corners are finite, convex, not collinear, and in the order of a tag that
// faces the camera.
bool is_proper(const std::array<Eigen::Vector2d, 4>& corners) {
  for (std::size_t i = 0; i < 4; ++i) {
    if (!corners[i].allFinite()) return false;
    const Eigen::Vector2d a = corners[(i + 1) % 4] - corners[i];
    const Eigen::Vector2d b = corners[(i + 2) % 4] - corners[(i + 1) % 4];
    // Counter-clockwise with y up; the sign is reversed because pixel rows count downwards.
    const double turn = a.x() * b.y() - a.y() * b.x();
    if (!(turn < -1e-2 * a.norm() * b.norm()) || a.norm() < 2.0) return false;
  }
  return true;
}

// libapriltag rounds other factors for the image, but not for the corners, which are then wrong.
bool is_decimation(float d) {
  return d == 1.5F || (d >= 1.0F && d <= 8.0F && d == std::floor(d));
}

}  // namespace

struct TagDetector::Impl {
  struct Family {
    TagFamily family = TagFamily::tag36h11;
    TagFamilyHandle handle;
  };

  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;
  ~Impl() {
    if (detector != nullptr) apriltag_detector_destroy(detector);
  }

  apriltag_detector_t* detector = nullptr;
  std::vector<Family> families;  // referenced by the detector
};

TagDetector::TagDetector(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
TagDetector::TagDetector(TagDetector&&) noexcept = default;
TagDetector& TagDetector::operator=(TagDetector&&) noexcept = default;
TagDetector::~TagDetector() = default;

Result<TagDetector> TagDetector::create(std::span<const TagFamily> families,
                                        const TagDetectorOptions& options) {
  if (families.empty()) return fail("tag detector: no tag family is given; name at least one");
  PENUMBRA_ASSERT(options.border_cells == 1 || options.border_cells == 2);
  auto impl = std::make_unique<Impl>();
  impl->detector = apriltag_detector_create();
  if (impl->detector == nullptr) return fail("tag detector: libapriltag gave none; free memory");
  // libapriltag 3.3.0 has data races with more threads (union-find, worker pool).
  impl->detector->nthreads = 1;
  impl->detector->quad_sigma = 0.0F;
  impl->detector->refine_edges = true;
  impl->detector->decode_sharpening = kDecodeSharpening;
  impl->detector->debug = false;
  std::vector<TagFamily> unique(families.begin(), families.end());
  std::sort(unique.begin(), unique.end());
  unique.erase(std::unique(unique.begin(), unique.end()), unique.end());
  for (const TagFamily family : unique) {
    TagFamilyHandle handle = make_tag_family(family);
    if (!handle) return fail("tag detector: no memory for the family {}", to_string(family));
    if (options.border_cells == 2) {
      if (family != TagFamily::tag36h11)
        return fail("tag detector: border_cells 2 is for tag36h11, not {}", to_string(family));
      // The codes are the same, one cell further inside.
      handle->width_at_border += 2;
      handle->total_width += 2;
      for (std::uint32_t bit = 0; bit < handle->nbits; ++bit) {
        ++handle->bit_x[bit];
        ++handle->bit_y[bit];
      }
    }
    apriltag_detector_add_family_bits(
        impl->detector, handle.get(),
        std::min({kMaxCorrectedBits, options.max_corrected_bits, max_corrected_bits(family)}));
    impl->families.push_back({family, std::move(handle)});
  }
  return TagDetector(std::move(impl));
}

std::vector<TagDetection> TagDetector::detect(ImageView luma, float quad_decimate) {
  PENUMBRA_ASSERT(is_decimation(quad_decimate));
  std::vector<TagDetection> result;
  if (luma.empty() || luma.stride < luma.width) return result;
  const auto decimated = [&](int side) {
    return static_cast<int>(std::floor(static_cast<float>(side) / quad_decimate));
  };
  if (std::min(decimated(luma.width), decimated(luma.height)) < kSmallestSide) return result;
  if (std::max(luma.width, luma.height) > kLargestSide || luma.stride > 1 << 24) return result;

  impl_->detector->quad_decimate = quad_decimate;
  // Wraps the caller's pixels, which libapriltag only reads (quad_sigma and debug are off).
  image_u8_t image = {luma.width, luma.height, static_cast<std::int32_t>(luma.stride),
                      const_cast<std::uint8_t*>(luma.data)};
  const std::unique_ptr<zarray_t, DestroyDetections> found(
      apriltag_detector_detect(impl_->detector, &image));
  if (!found) return result;
  for (int i = 0; i < zarray_size(found.get()); ++i) {
    apriltag_detection_t* detection = nullptr;
    zarray_get(found.get(), i, &detection);
    if (detection == nullptr || detection->hamming > kMaxCorrectedBits) continue;
    const auto family =
        std::find_if(impl_->families.begin(), impl_->families.end(),
                     [&](const Impl::Family& f) { return f.handle.get() == detection->family; });
    if (family == impl_->families.end()) continue;
    TagDetection tag;
    tag.family = family->family;
    tag.id = detection->id;
    // libapriltag's pixel (0, 0) is the corner of the top-left pixel.
    for (std::size_t c = 0; c < 4; ++c)
      tag.corners_px[c] = {detection->p[c][0] - 0.5, detection->p[c][1] - 0.5};
    if (is_proper(tag.corners_px)) result.push_back(tag);
  }
  std::sort(result.begin(), result.end(), [](const TagDetection& a, const TagDetection& b) {
    return std::tuple(a.family, a.id, a.corners_px[0].y(), a.corners_px[0].x()) <
           std::tuple(b.family, b.id, b.corners_px[0].y(), b.corners_px[0].x());
  });
  return result;
}

}  // namespace penumbra
