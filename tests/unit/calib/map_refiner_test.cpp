// Refinement of a tag map from keyframes, on images with exact truth.
#include "calib/refinement/map_refiner.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <memory>
#include <vector>

#include "core/units.hpp"
#include "support/aligned_map.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

// Renders eight keyframes of a sheet; every fourth one is held out.
KeyframeList keyframes_of(const CameraModel& camera, const std::vector<MappedTag>& sheet) {
  PatternRenderer renderer = PatternRenderer::create(camera, sheet).value();
  KeyframeList keyframes;
  for (int k = 0; k < 8; ++k) {
    const CameraPose pose =
        test::looking_at({0.01 * (k % 3), 0.0, 0.0}, 0.5 + 0.03 * (k % 4),
                         radians(40.0 + 9.0 * (k % 5)), radians(75.0 * k), radians(4.0 * k));
    PatternRenderOptions options;
    options.noise_grey = 2.0;
    options.samples = 32;
    options.seed = 1 + static_cast<std::uint64_t>(k);
    GreyImage image = renderer.render(std::array{pose}, options);
    auto keyframe = std::make_shared<MapKeyframe>();
    keyframe->size = {image.width, image.height};
    keyframe->pixels = std::move(image.pixels);
    keyframe->camera_m = pose.translation();
    keyframe->held_out = k % 4 == 3;
    keyframes.push_back(std::move(keyframe));
  }
  return keyframes;
}

// A flat sheet as printed, and the same sheet with tags that are lifted and tilted.
class MapRefinerTest : public testing::Test {
 protected:
  static std::vector<MappedTag> bent_sheet() {
    std::vector<MappedTag> tags = test::board(3, 2, 0.06);
    for (MappedTag& tag : tags) {
      const double x = tag.T_table_tag.translation().x();
      const Eigen::AngleAxisd tilt(-0.6 * x, Eigen::Vector3d::UnitY());
      tag.T_table_tag = {Eigen::Quaterniond(tilt),
                         tag.T_table_tag.translation() + Eigen::Vector3d(0.0, 0.0, 0.3 * x * x)};
    }
    return tags;
  }
  static void SetUpTestSuite() {
    camera_ = test::wide_camera();
    bent_keyframes_ = keyframes_of(camera_, bent_sheet());
    bent_map_ = refined(flat_map(), bent_keyframes_);
  }
  static void TearDownTestSuite() { bent_keyframes_.clear(); }

  [[nodiscard]] static Result<TagMap> refined(const TagMap& given, const KeyframeList& keyframes,
                                              std::stop_token stop = {}) {
    return refine_map(camera_, {given, given}, keyframes, std::move(stop));
  }
  [[nodiscard]] static TagMap flat_map() { return TagMap::make(test::board(3, 2, 0.06)).value(); }

  static inline CameraModel camera_;
  static inline KeyframeList bent_keyframes_;
  static inline Result<TagMap> bent_map_ = fail("not refined");  // flat_map() refined from them
};

TEST_F(MapRefinerTest, FindsShapeOfBentSheetInTheGivenFrame) {
  const auto& map = bent_map_;
  ASSERT_TRUE(map) << map.error().message;
  EXPECT_LT(test::largest_error_m(*map, bent_sheet()), 1.5e-4);
  // The corners are on average where they were.
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < map->tags().size(); ++i) {
    for (std::size_t c = 0; c < 4; ++c)
      sum += map->tags()[i].corners()[c] - flat_map().tags()[i].corners()[c];
  }
  EXPECT_LT(sum.norm() / 24.0, 1e-9);
  const MapChange change = change_of_map(flat_map(), *map);
  EXPECT_GT(change.rms_m, 5e-4);
  EXPECT_GE(change.max_m, change.rms_m);
}

TEST_F(MapRefinerTest, GivesTheSameBitsForTheSameKeyframes) {
  const auto second = refined(flat_map(), bent_keyframes_);
  ASSERT_TRUE(bent_map_ && second);
  EXPECT_EQ(tag_map_text(*bent_map_), tag_map_text(*second));
}

TEST_F(MapRefinerTest, KeepsMapThatExplainsHeldOutKeyframes) {
  const auto exact = TagMap::make(bent_sheet()).value();
  const auto map = refined(exact, bent_keyframes_);
  ASSERT_FALSE(map);
  EXPECT_THAT(map.error().message, HasSubstr("held-out"));
}

TEST_F(MapRefinerTest, ReplacesRefinedMapByOneThatIsAboutAsGood) {
  ASSERT_TRUE(bent_map_);
  const auto second = refine_map(camera_, {flat_map(), *bent_map_}, bent_keyframes_, {});
  ASSERT_TRUE(second) << second.error().message;
  EXPECT_EQ(tag_map_text(*bent_map_), tag_map_text(*second));
}

TEST_F(MapRefinerTest, KeepsTableFrameWhenOneTagMoved) {
  std::vector<MappedTag> given = bent_sheet();
  MappedTag& moved = given[4];
  moved.T_table_tag = {moved.T_table_tag.rotation(),
                       moved.T_table_tag.translation() + Eigen::Vector3d(0.012, 0.009, 0.0)};
  const auto map = refined(TagMap::make(given).value(), bent_keyframes_);
  ASSERT_TRUE(map) << map.error().message;
  const auto truth = bent_sheet();
  for (std::size_t i = 0; i < truth.size(); ++i) {
    for (std::size_t c = 0; c < 4; ++c)
      EXPECT_LT((map->tags()[i].corners()[c] - truth[i].corners()[c]).norm(), 3e-4) << i;
  }
}

TEST_F(MapRefinerTest, KeepsUnseenTagsAndOtherGroups) {
  std::vector<MappedTag> given = test::board(3, 2, 0.06);
  MappedTag unseen;
  unseen.id = 77;
  unseen.size_m = 0.05;
  unseen.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.4, 0.0, 0.0)};
  given.push_back(unseen);
  given[5].group = "prop";  // visible, but not fixed to the table
  const auto map = refined(TagMap::make(given).value(), bent_keyframes_);
  ASSERT_TRUE(map) << map.error().message;
  for (const std::size_t kept : {5U, 6U}) {
    EXPECT_EQ(map->tags()[kept].T_table_tag.matrix(), given[kept].T_table_tag.matrix());
    EXPECT_EQ(map->tags()[kept].curvature, given[kept].curvature);
    EXPECT_EQ(map->tags()[kept].group, given[kept].group);
  }
  EXPECT_NE(map->tags()[0].T_table_tag.matrix(), given[0].T_table_tag.matrix());
}

TEST_F(MapRefinerTest, FailsWithoutEnoughTagsOrKeyframes) {
  EXPECT_FALSE(refined(flat_map(), {}));
  const KeyframeList one(bent_keyframes_.begin(), bent_keyframes_.begin() + 1);
  EXPECT_FALSE(refined(flat_map(), one));
  KeyframeList none_held_out = bent_keyframes_;
  std::erase_if(none_held_out, [](const auto& keyframe) { return keyframe->held_out; });
  EXPECT_FALSE(refined(flat_map(), none_held_out));
  KeyframeList only_held_out = bent_keyframes_;
  std::erase_if(only_held_out, [](const auto& keyframe) { return !keyframe->held_out; });
  EXPECT_FALSE(refined(flat_map(), only_held_out));
  KeyframeList blank;
  for (const auto& keyframe : bent_keyframes_) {
    auto copy = std::make_shared<MapKeyframe>(*keyframe);
    std::ranges::fill(copy->pixels, std::uint8_t{128});
    blank.push_back(std::move(copy));
  }
  const auto without_tags = refined(flat_map(), blank);
  ASSERT_FALSE(without_tags);
  EXPECT_THAT(without_tags.error().message, HasSubstr("no tag"));
  // Held-out keyframes that show only one tag of the map compare no maps.
  const auto single = TagMap::make({test::board(3, 2, 0.06)[2]}).value();
  EXPECT_FALSE(refined(single, bent_keyframes_));
}

TEST_F(MapRefinerTest, EndsSoonWhenStopped) {
  std::stop_source stop;
  stop.request_stop();
  const auto map = refined(flat_map(), bent_keyframes_, stop.get_token());
  ASSERT_FALSE(map);
  EXPECT_EQ(map.error().message, "ended early");
}

}  // namespace
}  // namespace penumbra
