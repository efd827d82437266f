#include "benchmarks/peers/peer.hpp"

#ifdef PENUMBRA_PEER_ARUCO
#include <opencv2/aruco.hpp>
#include <opencv2/core.hpp>
#endif

namespace penumbra::peers {

#ifdef PENUMBRA_PEER_ARUCO

namespace {

class Aruco : public Peer {
 public:
  Aruco(const CameraModel& camera, const TagMap& tags, ArucoCorners corners)
      : camera_(camera),
        tags_(tags),
        dictionary_(cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11)),
        parameters_(cv::aruco::DetectorParameters::create()),
        half_pixel_(corners == ArucoCorners::apriltag) {
    parameters_->cornerRefinementMethod = corners == ArucoCorners::subpix
                                              ? cv::aruco::CORNER_REFINE_SUBPIX
                                              : cv::aruco::CORNER_REFINE_APRILTAG;
    // The default value rejects neighbouring tags with a gap of one or two cells.
    parameters_->minMarkerDistanceRate = 0.01;
    cv::setNumThreads(1);
  }

  std::optional<CameraPose> find(ImageView luma) override {
    const cv::Mat image(luma.height, luma.width, CV_8UC1, const_cast<std::uint8_t*>(luma.data),
                        static_cast<std::size_t>(luma.stride));
    std::vector<std::vector<cv::Point2f>> corners;
    std::vector<int> ids;
    cv::aruco::detectMarkers(image, dictionary_, corners, ids, parameters_);
    std::vector<PointObservation> points;
    for (std::size_t i = 0; i < ids.size(); ++i) {
      // OpenCV's version of the family is rotated by 180 degrees, and its corners are clockwise.
      constexpr std::array<std::size_t, 4> kOurs = {1, 0, 3, 2};
      std::array<Eigen::Vector2d, 4> corners_px;
      for (std::size_t k = 0; k < 4; ++k) {
        const cv::Point2f& p = corners[i][k];
        corners_px[kOurs[k]] = Eigen::Vector2d(static_cast<double>(p.x), static_cast<double>(p.y));
        // OpenCV's port of the AprilTag quad detector has its origin at a pixel's corner.
        if (half_pixel_) corners_px[kOurs[k]] -= Eigen::Vector2d(0.5, 0.5);
      }
      add_corners(tags_, TagFamily::tag36h11, ids[i], corners_px, points);
    }
    return solve_pnp(camera_, points);
  }

 private:
  CameraModel camera_;
  TagMap tags_;
  cv::Ptr<cv::aruco::Dictionary> dictionary_;
  cv::Ptr<cv::aruco::DetectorParameters> parameters_;
  bool half_pixel_;
};

}  // namespace

std::unique_ptr<Peer> make_aruco(const CameraModel& camera, const TagMap& tags,
                                 ArucoCorners corners) {
  return std::make_unique<Aruco>(camera, tags, corners);
}

#else

std::unique_ptr<Peer> make_aruco(const CameraModel&, const TagMap&, ArucoCorners) {
  return nullptr;
}

#endif

}  // namespace penumbra::peers
