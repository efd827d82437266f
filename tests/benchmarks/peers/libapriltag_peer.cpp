#include <array>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <utility>

#include "benchmarks/peers/peer.hpp"
#include "core/assert.hpp"
#include "tracking/detection/board_pose.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra::peers {
namespace {

class Libapriltag : public Peer {
 public:
  Libapriltag(const CameraModel& camera, const TagMap& tags, float quad_decimate, PoseBy pose_by)
      : camera_(camera),
        tags_(tags),
        detector_(TagDetector::create(tags.families()).value()),
        quad_decimate_(quad_decimate),
        pose_by_(pose_by) {}

  std::optional<CameraPose> find(ImageView luma) override {
    const std::vector<TagDetection> detections = detector_.detect(luma, quad_decimate_);
    if (pose_by_ == PoseBy::pnp) {
      std::vector<PointObservation> points;
      for (const TagDetection& detection : detections)
        add_corners(tags_, detection.family, detection.id, detection.corners_px, points);
      return solve_pnp(camera_, points);
    }
    std::vector<TagObservation> observations;
    for (const TagDetection& detection : detections) {
      const MappedTag* tag = tags_.find(detection.family, detection.id);
      if (tag != nullptr && tag->group == "table")
        observations.push_back({tag->id, tag->corners(), detection.corners_px});
    }
    const auto board = estimate_board_pose(camera_, observations);
    if (!board) return std::nullopt;
    return as_table_pose(board->best.T_map_camera);
  }

 private:
  CameraModel camera_;
  TagMap tags_;
  TagDetector detector_;
  float quad_decimate_;
  PoseBy pose_by_;
};

}  // namespace

void add_corners(const TagMap& tags, TagFamily family, int id,
                 const std::array<Eigen::Vector2d, 4>& corners_px,
                 std::vector<PointObservation>& points) {
  const MappedTag* tag = tags.find(family, id);
  if (tag == nullptr || tag->group != "table") return;
  const std::array<Eigen::Vector3d, 4> corners = tag->corners();
  for (std::size_t k = 0; k < 4; ++k) points.push_back({corners[k], corners_px[k]});
}

std::optional<CameraPose> solve_pnp(const CameraModel& camera,
                                    std::span<const PointObservation> points) {
  if (points.size() < 4) return std::nullopt;
  const CameraParameters& p = camera.parameters();
  PENUMBRA_ASSERT(p.model == DistortionModel::plumb_bob);  // the recordings use this model
  const cv::Matx33d K(p.fx, 0.0, p.cx, 0.0, p.fy, p.cy, 0.0, 0.0, 1.0);
  const std::vector<double> lens(p.distortion.begin(), p.distortion.begin() + 5);
  std::vector<cv::Point3d> object;
  std::vector<cv::Point2d> image;
  for (const PointObservation& point : points) {
    object.emplace_back(point.p_map.x(), point.p_map.y(), point.p_map.z());
    image.emplace_back(point.pixel.x(), point.pixel.y());
  }
  cv::Vec3d rotation_vector;
  cv::Vec3d t;
  try {
    if (!cv::solvePnP(object, image, K, lens, rotation_vector, t)) return std::nullopt;
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  cv::Matx33d R;
  cv::Rodrigues(rotation_vector, R);
  Eigen::Matrix3d rotation;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) rotation(r, c) = R(r, c);
  }
  const Transform<frame::Camera, frame::Table> T_camera_table(rotation,
                                                              Eigen::Vector3d(t[0], t[1], t[2]));
  if (!T_camera_table.is_finite()) return std::nullopt;
  return T_camera_table.inverse();
}

std::unique_ptr<Peer> make_libapriltag(const CameraModel& camera, const TagMap& tags,
                                       float quad_decimate, PoseBy pose_by) {
  return std::make_unique<Libapriltag>(camera, tags, quad_decimate, pose_by);
}

}  // namespace penumbra::peers
