#include "benchmarks/peers/peer.hpp"

#ifdef PENUMBRA_PEER_VISP
#include "benchmarks/peers/visp/visp_tags.hpp"
#endif

namespace penumbra::peers {

#ifdef PENUMBRA_PEER_VISP

namespace {

class Visp : public Peer {
 public:
  Visp(const CameraModel& camera, const TagMap& tags, float quad_decimate)
      : camera_(camera), tags_(tags), detector_(quad_decimate) {}

  std::optional<CameraPose> find(ImageView luma) override {
    if (luma.stride != luma.width) return std::nullopt;
    std::vector<PointObservation> points;
    for (const VispTag& tag : detector_.detect(luma.data, luma.width, luma.height)) {
      std::array<Eigen::Vector2d, 4> corners_px;
      // ViSP returns the corners in libapriltag's order, with the origin at a pixel's corner.
      for (std::size_t k = 0; k < 4; ++k)
        corners_px[k] = Eigen::Vector2d(tag.corners_px[k][0] - 0.5, tag.corners_px[k][1] - 0.5);
      add_corners(tags_, TagFamily::tag36h11, tag.id, corners_px, points);
    }
    std::vector<VispPoint> rays;
    for (const PointObservation& point : points) {
      const std::optional<Eigen::Vector3d> ray = camera_.unproject(point.pixel);
      const Eigen::Vector3d& p = point.p_map;
      if (ray) rays.push_back({{p.x(), p.y(), p.z()}, {ray->x(), ray->y()}});
    }
    const auto pose = visp_pose(rays);
    if (!pose) return std::nullopt;
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> P(pose->data());
    if (!P.allFinite()) return std::nullopt;
    return Transform<frame::Camera, frame::Table>(Eigen::Matrix3d(P.leftCols<3>()),
                                                  Eigen::Vector3d(P.col(3)))
        .inverse();
  }

 private:
  CameraModel camera_;
  TagMap tags_;
  VispTags detector_;
};

}  // namespace

std::unique_ptr<Peer> make_visp(const CameraModel& camera, const TagMap& tags,
                                float quad_decimate) {
  return std::make_unique<Visp>(camera, tags, quad_decimate);
}

#else

std::unique_ptr<Peer> make_visp(const CameraModel&, const TagMap&, float) {
  return nullptr;
}

#endif

}  // namespace penumbra::peers
