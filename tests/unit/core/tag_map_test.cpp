#include "core/geometry/tag_map.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "core/text/text.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

constexpr const char* kTag =
    "  - {id: 3, family: tag36h11, size_m: 0.04, position: [0.1, 0.2, 0], quaternion_xyzw: [0, 0, "
    "0.7071067811865476, 0.7071067811865476]}\n";

class TagMapFile : public testing::Test {
 protected:
  Result<TagMap> load(std::string_view text) {
    EXPECT_TRUE(write_text_file(file_, text));
    return load_tag_map(file_);
  }
  void refuses(std::string_view text, const char* what) {
    const Result<TagMap> read = load(text);
    ASSERT_FALSE(read) << text;
    EXPECT_THAT(read.error().message,
                testing::AllOf(testing::HasSubstr("tags.yaml"), testing::HasSubstr(what)));
  }
  test::TemporaryFolder folder_;
  std::filesystem::path file_ = folder_.path() / "tags.yaml";
};

TEST_F(TagMapFile, ReadsTagAndPlacesItsCorners) {
  const auto map = load(std::string("tags:\n") + kTag);
  ASSERT_TRUE(map) << map.error().message;
  const MappedTag* tag = map->find(TagFamily::tag36h11, 3);
  ASSERT_NE(tag, nullptr);
  EXPECT_EQ(tag->group, "table");
  EXPECT_EQ(map->find(TagFamily::tag36h11, 4), nullptr);
  EXPECT_EQ(map->find(TagFamily::tag25h9, 3), nullptr);
  EXPECT_THAT(map->families(), testing::ElementsAre(TagFamily::tag36h11));
  // Rotated by 90 degrees about z: the tag's corner (-s/2, -s/2) is at (s/2, -s/2) from its centre.
  const auto corners = tag->corners();
  EXPECT_LT((corners[0] - Eigen::Vector3d(0.12, 0.18, 0)).norm(), 1e-12);
  EXPECT_LT((corners[1] - Eigen::Vector3d(0.12, 0.22, 0)).norm(), 1e-12);
  EXPECT_LT((corners[2] - Eigen::Vector3d(0.08, 0.22, 0)).norm(), 1e-12);
  EXPECT_LT((corners[3] - Eigen::Vector3d(0.08, 0.18, 0)).norm(), 1e-12);
}

TEST_F(TagMapFile, ReadsGroupsAndEveryFamily) {
  for (const char* family :
       {"tag36h11", "tag36h10", "tag25h9", "tag16h5", "tagCircle21h7", "tagCircle49h12",
        "tagStandard41h12", "tagStandard52h13", "tagCustom48h12", "DICT_4X4_50", "DICT_6X6_1000"}) {
    const auto map = load(std::string("tags: [{id: 0, family: ") + family +
                          ", size_m: 1, position: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1], "
                          "group: lid}]");
    ASSERT_TRUE(map) << map.error().message;
    EXPECT_EQ(map->tags()[0].group, "lid");
    EXPECT_EQ(to_string(map->tags()[0].family), family);
  }
}

TEST_F(TagMapFile, ReportsFileTagAndFieldOfError) {
  const std::string head = "tags:\n";
  refuses("", "map");
  refuses("tags: 3\n", "tags");
  refuses("tags: []\n", "empty");
  refuses("other: []\n", "tags");
  refuses("tags: [1, 2]\n", "tags[0]");
  refuses("tags: [{id: 1\n", "line");
  refuses(head + kTag + kTag, "listed twice");
  const auto with = [](const char* id, const char* family, const char* size, const char* position,
                       const char* rotation) {
    return fmt::format(
        "tags: [{{id: {}, family: {}, size_m: {}, position: {}, quaternion_xyzw: {}}}]", id, family,
        size, position, rotation);
  };
  refuses(with("x", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 1]"), "id");
  refuses(with("-1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 1]"), "negative");
  refuses(with("1", "tag99h99", "0.1", "[0, 0, 0]", "[0, 0, 0, 1]"), "tag99h99");
  refuses(with("1", "tag36h11", "0", "[0, 0, 0]", "[0, 0, 0, 1]"), "size_m");
  refuses(with("1", "tag36h11", "-0.1", "[0, 0, 0]", "[0, 0, 0, 1]"), "size_m");
  refuses(with("1", "tag36h11", "nan", "[0, 0, 0]", "[0, 0, 0, 1]"), "size_m");
  refuses(with("1", "tag36h11", "0.1", "[0, 0]", "[0, 0, 0, 1]"), "position");
  refuses(with("1", "tag36h11", "0.1", "[0, .nan, 0]", "[0, 0, 0, 1]"), "position");
  refuses(with("1", "tag36h11", "0.1", "[0, 1e9, 0]", "[0, 0, 0, 1]"), "position");
  refuses(with("1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 0]"), "quaternion_xyzw");
  refuses(with("1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 1.01]"), "quaternion_xyzw");
  refuses(with("1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 1]"), "quaternion_xyzw");
  refuses("tags: [{id: 1, family: tag36h11}]", "size_m: is missing");
  const auto with_surface = [&](const char* surface) {
    std::string text = with("1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 1]");
    return text.insert(text.find("id"), fmt::format("surface: {}, ", surface));
  };
  refuses(with_surface("[1, 2]"), "surface");
  refuses(with_surface("[1, .nan, 2]"), "surface");
  refuses(with_surface("[0, 10.1, 0]"), "surface: has a curvature above 10 1/m");
  std::string misspelt = with("1", "tag36h11", "0.1", "[0, 0, 0]", "[0, 0, 0, 1]");
  misspelt.insert(misspelt.find("id"), "grop: wall, ");
  refuses(misspelt, "grop (line 1): is not known; did you mean `group`?");
  refuses(std::string(100000, '['), "YAML");
}

TEST(TagMap, CurvedTagHasCornersOnItsSurface) {
  MappedTag tag;
  tag.size_m = 0.1;
  tag.curvature = {0.8, 0.4, -0.2};
  tag.T_table_tag = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.0, 0.0, 1.0)};
  // At the corners x^2 = y^2 = h^2, so only 2 xy x y / 2 remains.
  const double saddle_m = 0.4 * 0.05 * 0.05;
  const auto corners = tag.corners();
  for (const auto& [k, sign] :
       {std::pair(0, 1.0), std::pair(1, -1.0), std::pair(2, 1.0), std::pair(3, -1.0)})
    EXPECT_NEAR(corners[static_cast<std::size_t>(k)].z(), 1.0 + sign * saddle_m, 1e-15) << k;
  EXPECT_NEAR(tag.curvature.height(0.0, 0.0, 0.1), -0.5 * (0.8 - 0.2) * 0.05 * 0.05, 1e-15);
}

TEST(TagMap, RefusesCurvatureThatIsNotANumber) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int i = 0; i < 3; ++i) {
    MappedTag tag;
    tag.size_m = 0.1;
    (i == 0 ? tag.curvature.xx : i == 1 ? tag.curvature.xy : tag.curvature.yy) = nan;
    EXPECT_FALSE(TagMap::make({tag})) << i;
  }
}

TEST(TagMap, RejectsInvalidTags) {
  MappedTag tag;
  tag.size_m = 0.1;
  EXPECT_TRUE(TagMap::make({tag}));
  EXPECT_FALSE(TagMap::make({}));
  EXPECT_FALSE(TagMap::make({tag, tag}));
  MappedTag bad = tag;
  bad.size_m = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(TagMap::make({bad}));
  bad = tag;
  bad.T_table_tag = {Eigen::Quaterniond::Identity(),
                     Eigen::Vector3d(0, 0, std::numeric_limits<double>::infinity())};
  EXPECT_FALSE(TagMap::make({bad}));
}

TEST(TagMap, RoundTripsThroughFile) {
  std::vector<MappedTag> tags(2);
  tags[0].id = 3;
  tags[0].size_m = 0.1 / 3.0;
  tags[0].T_table_tag = {Eigen::Quaterniond(0.1, -0.7, 0.3, 0.6),
                         Eigen::Vector3d(1.0 / 7.0, -2e-9, 0.3)};
  tags[1].id = 3;
  tags[1].family = TagFamily::tag25h9;
  tags[1].size_m = 0.05;
  tags[1].group = "a \"quoted\" wall";
  tags[1].curvature = {1.0 / 3.0, -2e-7, -19.9};
  const TagMap map = TagMap::make(tags).value();
  const test::TemporaryFolder folder;
  ASSERT_TRUE(write_text_file(folder.path() / "tags.yaml", tag_map_text(map)));
  const auto read = load_tag_map(folder.path() / "tags.yaml");
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->tags().size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    const MappedTag& before = map.tags()[i];
    const MappedTag& after = read->tags()[i];
    EXPECT_EQ(after.id, before.id);
    EXPECT_EQ(after.family, before.family);
    EXPECT_EQ(after.group, before.group);
    EXPECT_EQ(after.size_m, before.size_m);
    EXPECT_EQ(after.curvature.xx, before.curvature.xx);
    EXPECT_EQ(after.curvature.xy, before.curvature.xy);
    EXPECT_EQ(after.curvature.yy, before.curvature.yy);
    EXPECT_EQ(after.T_table_tag.translation(), before.T_table_tag.translation());
    EXPECT_LT(
        (after.T_table_tag.rotation().coeffs() - before.T_table_tag.rotation().coeffs()).norm(),
        1e-15);
  }
}

TEST(TagMap, ReadsEverySharedMap) {
  const auto shared = test::shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  int read = 0;
  for (const auto& entry : std::filesystem::directory_iterator(shared / "recordings")) {
    const auto file = entry.path() / "tags.yaml";
    if (!std::filesystem::exists(file)) continue;
    const auto map = load_tag_map(file);
    ASSERT_TRUE(map) << map.error().message;
    ++read;
  }
  EXPECT_GE(read, 8);
}

TEST(TagFamilyName, IsReadInOpenCvRosAndAprilTagSpelling) {
  struct Names {
    TagFamily family;
    std::vector<const char*> names;
  };
  for (const auto& [family, names] : std::vector<Names>{
           {TagFamily::tag36h11,
            {"tag36h11", "36h11", "Tag36h11", "TAG36H11", "tag_36h11", "apriltag_36h11",
             "AprilTag 36h11", "apriltag36h11", "DICT_APRILTAG_36h11", "DICT_APRILTAG_36H11",
             "dict_apriltag_36h11", "cv2.aruco.DICT_APRILTAG_36h11", "tagCodes36h11", "t36h11"}},
           {TagFamily::tag36h10, {"36h10", "DICT_APRILTAG_36h10"}},
           {TagFamily::tag25h9, {"25h9", "DICT_APRILTAG_25h9", "tag25h9"}},
           {TagFamily::tag16h5, {"16h5", "DICT_APRILTAG_16h5", "Tag16h5"}},
           {TagFamily::tag_circle21h7, {"tagCircle21h7", "Circle21h7"}},
           {TagFamily::tag_standard41h12,
            {"tagStandard41h12", "Standard41h12", "standard41h12", "tag_standard_41h12"}},
           {TagFamily::tag_custom48h12, {"Custom48h12"}},
           {TagFamily::aruco_4x4_50,
            {"DICT_4X4_50", "4x4_50", "aruco_4x4_50", "ARUCO_4X4_50", "dict_4x4_50",
             "cv::aruco::DICT_4X4_50", "DICT_ARUCO_4X4_50"}},
           {TagFamily::aruco_6x6_1000, {"DICT_6X6_1000", "6x6_1000"}}}) {
    for (const char* name : names) EXPECT_EQ(tag_family_from_string(name), family) << name;
  }
}

TEST(TagFamilyName, RoundTripsForEveryFamily) {
  for (int i = 0; i <= static_cast<int>(TagFamily::aruco_6x6_1000); ++i) {
    const auto family = static_cast<TagFamily>(i);
    EXPECT_EQ(tag_family_from_string(to_string(family)), family) << to_string(family);
  }
}

TEST(TagFamilyName, IsRejectedWithKnownNamesWhenUnknown) {
  for (const char* name : {"", "tag", "dict", "DICT_", "tag36h12", "DICT_36h11", "aruco_36h11",
                           "DICT_7X7_50", "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12", "4x4",
                           "4x4_500", "t", "tt36h11", ":", "tag36h11 x"}) {
    EXPECT_EQ(tag_family_from_string(name), std::nullopt) << name;
  }
  EXPECT_THAT(unknown_tag_family("DICT_7X7_50"),
              testing::AllOf(testing::HasSubstr("'DICT_7X7_50' is not known; known: tag36h11, "),
                             testing::HasSubstr("DICT_6X6_1000")));
}

}  // namespace
}  // namespace penumbra
