#include "benchmarks/peers/visp/visp_tags.hpp"

#include <visp3/detection/vpDetectorAprilTag.h>
#include <visp3/vision/vpPose.h>

namespace penumbra::peers {

struct VispTags::Impl {
  vpDetectorAprilTag detector{vpDetectorAprilTag::TAG_36h11};
};

VispTags::VispTags(float quad_decimate) : impl_(std::make_unique<Impl>()) {
  impl_->detector.setAprilTagQuadDecimate(quad_decimate);
  impl_->detector.setAprilTagNbThreads(1);
}
VispTags::~VispTags() = default;

std::vector<VispTag> VispTags::detect(const std::uint8_t* luma, int width, int height) {
  const vpImage<unsigned char> image(const_cast<std::uint8_t*>(luma), static_cast<unsigned>(height),
                                     static_cast<unsigned>(width), false);
  std::vector<VispTag> tags;
  if (!impl_->detector.detect(image)) return tags;
  const std::vector<std::vector<vpImagePoint>> corners = impl_->detector.getTagsCorners();
  const std::vector<int> ids = impl_->detector.getTagsId();
  for (std::size_t i = 0; i < ids.size() && i < corners.size(); ++i) {
    VispTag tag;
    tag.id = ids[i];
    for (std::size_t k = 0; k < 4; ++k)
      tag.corners_px[k] = {corners[i][k].get_u(), corners[i][k].get_v()};
    tags.push_back(tag);
  }
  return tags;
}

std::optional<std::array<double, 12>> visp_pose(const std::vector<VispPoint>& points) {
  if (points.size() < 4) return std::nullopt;
  vpPose solver;
  for (const VispPoint& point : points) {
    vpPoint p(point.object[0], point.object[1], point.object[2]);
    p.set_x(point.ray[0]);
    p.set_y(point.ray[1]);
    solver.addPoint(p);
  }
  // Refines the better one of the two linear starts, as vpPose::DEMENTHON_LAGRANGE_VIRTUAL_VS of
  // later versions does.
  vpHomogeneousMatrix best;
  double min_residual = -1.0;
  for (const vpPose::vpPoseMethodType start : {vpPose::DEMENTHON, vpPose::LAGRANGE}) {
    vpHomogeneousMatrix cMo;
    try {
      if (!solver.computePose(start, cMo)) continue;
    } catch (const vpException&) {
      continue;
    }
    const double residual = solver.computeResidual(cMo);
    if (min_residual < 0.0 || residual < min_residual) {
      min_residual = residual;
      best = cMo;
    }
  }
  if (min_residual < 0.0) return std::nullopt;
  try {
    solver.computePose(vpPose::VIRTUAL_VS, best);
  } catch (const vpException&) {
    return std::nullopt;
  }
  std::array<double, 12> pose{};
  for (unsigned r = 0; r < 3; ++r) {
    for (unsigned c = 0; c < 4; ++c) pose[4 * r + c] = best[r][c];
  }
  return pose;
}

}  // namespace penumbra::peers
