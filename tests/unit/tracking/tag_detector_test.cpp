#include "tracking/detection/tag_detector.hpp"

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/image/image_file.hpp"
#include "support/paths.hpp"
#include "support/replay_tracking.hpp"
#include "tracking/alignment/tone_estimator.hpp"
#include "tracking/detection/tag_search.hpp"

namespace penumbra {
namespace {

constexpr std::array<TagFamily, 1> kFamily = {TagFamily::tag36h11};

struct Drawn {
  int width = 0;
  int height = 0;
  std::ptrdiff_t stride = 0;
  std::vector<std::uint8_t> pixels;
  std::array<Eigen::Vector2d, 4> corners_px;  // pixel centres at integers

  [[nodiscard]] ImageView view() const { return {pixels.data(), width, height, stride}; }
};

// Draws an upright tag of family 36h11, rotated by `angle` about its centre. Each pixel is the mean
// of 16 x 16 samples of the printed pattern.
Drawn draw_tag(int id, Eigen::Vector2d centre, double side_px, double angle, int padding) {
  Drawn drawn;
  drawn.width = 160;
  drawn.height = 120;
  drawn.stride = drawn.width + padding;
  drawn.pixels.assign(static_cast<std::size_t>(drawn.stride * drawn.height), 0);
  apriltag_family_t* family = tag36h11_create();
  image_u8_t* pattern = apriltag_to_image(family, id);
  const double cell = side_px / family->width_at_border;
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  constexpr int kSamples = 16;
  for (int y = 0; y < drawn.height; ++y) {
    for (int x = 0; x < drawn.width; ++x) {
      double sum = 0.0;
      for (int i = 0; i < kSamples * kSamples; ++i) {
        const double u = x - 0.5 + (i % kSamples + 0.5) / kSamples - centre.x();
        const double v = y - 0.5 + (i / kSamples + 0.5) / kSamples - centre.y();
        const int a = static_cast<int>(std::floor((c * u + s * v) / cell + 0.5 * pattern->width));
        const int b = static_cast<int>(std::floor((-s * u + c * v) / cell + 0.5 * pattern->height));
        const bool inside = a >= 0 && b >= 0 && a < pattern->width && b < pattern->height;
        sum += inside ? pattern->buf[b * pattern->stride + a] : 160.0;
      }
      drawn.pixels[static_cast<std::size_t>(y * drawn.stride + x)] =
          static_cast<std::uint8_t>(std::lround(20.0 + 0.8 * sum / (kSamples * kSamples)));
    }
  }
  const double h = 0.5 * side_px;
  // Upright: the tag's y axis points up in the image, whose rows run down.
  const std::array<Eigen::Vector2d, 4> upright = {{{-h, h}, {h, h}, {h, -h}, {-h, -h}}};
  for (std::size_t i = 0; i < 4; ++i) {
    drawn.corners_px[i] = centre + Eigen::Vector2d(c * upright[i].x() - s * upright[i].y(),
                                                   s * upright[i].x() + c * upright[i].y());
  }
  std::free(pattern->buf);  // Debian's library exports no image_u8_destroy
  std::free(pattern);
  tag36h11_destroy(family);
  return drawn;
}

TEST(TagDetector, OrdersCornersAndPlacesPixelCentresAtIntegers) {
  TagDetector detector = TagDetector::create(kFamily).value();
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  int count = 0;
  for (int i = 0; i < 24; ++i) {
    const Drawn drawn =
        draw_tag(i, {80.0 + 0.13 * i, 58.0 - 0.21 * i}, 44.0 + 0.37 * i, 0.26 * i, i % 3 * 7);
    const auto tags = detector.detect(drawn.view());
    ASSERT_EQ(tags.size(), 1U) << i;
    EXPECT_EQ(tags[0].id, i);
    for (std::size_t k = 0; k < 4; ++k) {
      const Eigen::Vector2d error = tags[0].corners_px[k] - drawn.corners_px[k];
      EXPECT_LT(error.norm(), 0.6) << i << " corner " << k;
      sum += error;
      ++count;
    }
  }
  // With libapriltag's own pixel origin the mean would be (0.5, 0.5).
  EXPECT_LT((sum / count).cwiseAbs().maxCoeff(), 0.06) << sum / count;
}

// Pixels in front of an inaccessible page, which detects overreads even without a sanitizer.
class GuardedPixels {
 public:
  GuardedPixels() {
    void* const pages =
        mmap(nullptr, 2 * size_, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (pages == MAP_FAILED) return;
    begin_ = static_cast<std::uint8_t*>(pages);
    if (mprotect(begin_ + size_, size_, PROT_NONE) != 0) return;
    std::mt19937 random(1);
    for (std::size_t i = 0; i < size_; ++i) begin_[i] = static_cast<std::uint8_t>(random());
    guarded_ = true;
  }
  GuardedPixels(const GuardedPixels&) = delete;
  GuardedPixels& operator=(const GuardedPixels&) = delete;
  ~GuardedPixels() {
    if (begin_ != nullptr) munmap(begin_, 2 * size_);
  }
  [[nodiscard]] bool guarded() const { return guarded_; }
  // A noise image whose last pixel is the last readable byte.
  [[nodiscard]] ImageView view(int width, int height, int stride) const {
    return {begin_ + size_ - stride * (height - 1) - width, width, height, stride};
  }

 private:
  std::size_t size_ = static_cast<std::size_t>(sysconf(_SC_PAGESIZE));
  std::uint8_t* begin_ = nullptr;
  bool guarded_ = false;
};

TEST(TagDetector, AcceptsImagesOfAnySize) {
  const GuardedPixels noise;
  ASSERT_TRUE(noise.guarded());
  TagDetector detector = TagDetector::create(kFamily).value();
  for (const float decimate : {1.0F, 1.5F, 2.0F, 3.0F, 4.0F}) {
    for (int height = 1; height <= 40; ++height) {
      for (int width = 1; width <= 40; ++width) {
        EXPECT_TRUE(detector.detect(noise.view(width, height, width), decimate).empty());
        EXPECT_TRUE(detector.detect(noise.view(width, height, 64), decimate).empty());
      }
    }
  }
}

TEST(TagDetector, FindsNoTagInEmptyOrBlankImages) {
  TagDetector detector = TagDetector::create(kFamily).value();
  EXPECT_TRUE(detector.detect({}).empty());
  const std::vector<std::uint8_t> pixels(100 * 100, 128);
  EXPECT_TRUE(detector.detect({pixels.data(), 100, 100, 100}).empty());
  EXPECT_TRUE(detector.detect({pixels.data(), 100, 100, 50}).empty()) << "rows that overlap";
  EXPECT_TRUE(detector.detect({pixels.data(), 0, 100, 100}).empty());
}

TEST(TagDetector, RequiresTagFamily) {
  EXPECT_FALSE(TagDetector::create({}));
}

TEST(TagDetector, IsDeterministic) {
  const Drawn drawn = draw_tag(7, {70.3, 60.8}, 50.0, 0.4, 0);
  TagDetector a = TagDetector::create(kFamily).value();
  TagDetector b = TagDetector::create(kFamily).value();
  const auto first = a.detect(drawn.view());
  ASSERT_EQ(first.size(), 1U);
  for (const auto& again : {a.detect(drawn.view()), b.detect(drawn.view())})
    EXPECT_EQ(again.at(0).corners_px, first[0].corners_px);
}

// A detector that changes its decimation must find the same tags as a new detector.
TEST(TagDetector, SearchesQuadsAtRequestedDecimation) {
  const auto image = load_image(test::recordings_dir() / "tabletop" / "frames" / "000000.jpg");
  ASSERT_TRUE(image);
  std::vector<std::uint8_t> scratch;
  const ImageView view = luma(*image, scratch);
  TagDetector reused = TagDetector::create(kFamily).value();
  std::size_t before = 0;
  for (const float decimate : {4.0F, 2.0F, 1.0F, 2.0F}) {
    SCOPED_TRACE(decimate);
    TagDetector fresh = TagDetector::create(kFamily).value();
    const std::vector<TagDetection> found = reused.detect(view, decimate);
    const std::vector<TagDetection> expected = fresh.detect(view, decimate);
    ASSERT_EQ(found.size(), expected.size());
    if (decimate == 4.0F) before = found.size();
    EXPECT_GE(found.size(), before) << "a finer search must find as many tags";
    for (std::size_t i = 0; i < found.size(); ++i) {
      EXPECT_EQ(found[i].id, expected[i].id);
      EXPECT_EQ(found[i].corners_px, expected[i].corners_px);
    }
  }
  EXPECT_EQ(reused.detect(view).size(), reused.detect(view, 1.0F).size());
}

// The camera response lets white bleed into black, so corners are detected inside the tags. After
// linearisation with the exponent estimated from the images, the corners must be unbiased.
TEST(TagDetector, DetectsUnbiasedCornersInLinearLight) {
  const auto recording = test::recordings_dir() / "tabletop";
  ASSERT_TRUE(std::filesystem::exists(recording / "camera.yaml")) << recording;
  const CameraModel camera = load_camera(recording / "camera.yaml").value();
  const TagMap map = load_tag_map(recording / "tags.yaml").value();
  const Trajectory truth = load_trajectory(recording / "groundtruth.tum").value();
  const auto frames = test::list_frames(recording).value();
  struct PosedImage {
    Frame frame;
    CameraPose T_table_camera;
  };
  std::vector<PosedImage> images;
  ToneEstimator estimator = ToneEstimator::create(camera, map.tags()).value();
  std::vector<std::uint8_t> scratch;
  for (std::size_t i = 0; i < frames.size(); i += 12) {
    images.push_back(
        {load_image(frames[i].file).value(), truth.at(frames[i].timestamp_ns)->T_table_camera});
    estimator.add(luma(images.back().frame, scratch), images.back().T_table_camera);
  }
  const auto estimate = estimator.estimate();
  ASSERT_TRUE(estimate) << estimate.error().message;
  const auto inward_px = [&](std::optional<double> tone_exponent) {
    TagSearch search = TagSearch::create(map.families(), tone_exponent).value();
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();
    double inward = 0.0;
    int count = 0;
    for (const PosedImage& image : images) {
      const auto T_camera_table = image.T_table_camera.inverse();
      search.begin(image.frame);
      for (const TagDetection& tag : search.tags(SearchResolution::full)) {
        const MappedTag* mapped = map.find(tag.family, tag.id);
        if (mapped == nullptr) {
          ADD_FAILURE() << "tag " << tag.id << " is not on the board";
          continue;
        }
        const auto corners = mapped->corners();
        const auto centre = *camera.project(T_camera_table * mapped->T_table_tag.translation());
        for (std::size_t k = 0; k < 4; ++k) {
          const Eigen::Vector2d exact = *camera.project(T_camera_table * corners[k]);
          const Eigen::Vector2d error = tag.corners_px[k] - exact;
          EXPECT_LT(error.norm(), 2.0) << "tag " << tag.id << " corner " << k;
          sum += error;
          inward += error.dot((centre - exact).normalized());
          ++count;
        }
      }
    }
    EXPECT_GT(count, 300);
    EXPECT_LT((sum / count).cwiseAbs().maxCoeff(), 0.1) << (sum / count).transpose();
    return inward / count;
  };
  const double captured_px = inward_px(std::nullopt);
  const double linear_px = inward_px(estimate->exponent);
  RecordProperty("inward_px", fmt::format("{:.3f}, by the exponent {:.2f} {:.3f}", captured_px,
                                          estimate->exponent, linear_px));
  EXPECT_GT(captured_px, 0.05);
  EXPECT_LT(captured_px, 0.4);
  EXPECT_LT(std::abs(linear_px), 0.3 * captured_px);
}

}  // namespace
}  // namespace penumbra
