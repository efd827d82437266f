// Accuracy without ground truth: penumbra evaluate --split-half.
#include <gmock/gmock.h>

#include <algorithm>
#include <set>

#include "core/camera/camera_file.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/text/text.hpp"
#include "replay_support.hpp"
#include "support/recording_folder.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

nlohmann::json evaluated(const std::vector<std::string>& arguments) {
  std::vector<std::string> all = {"evaluate", "--json"};
  all.insert(all.begin() + 1, arguments.begin(), arguments.end());
  const ProgramResult result = penumbra(all);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  return nlohmann::json::parse(result.out);
}

TEST(SplitHalf, MeasuresRecordingWithoutSystematicErrors) {
  const nlohmann::json json = evaluated({"--split-half", bundled("tabletop")});
  const nlohmann::json& error = json["split_half_px"];
  EXPECT_GT(error["median"], 0.0);
  EXPECT_LT(error["median"], 0.2);
  EXPECT_LE(error["median"], error["p95"]);
  EXPECT_LT(error["rmse"], json["predicted_px"]["rmse"]);
  EXPECT_LT(json["ratio"], 1.0);
  EXPECT_EQ(json["share_above_3"], 0.0);
  EXPECT_EQ(json["tags"]["count"], 12);
  EXPECT_EQ(json["splits"].size(), 4U);
  int compared = 0;
  std::set<std::set<int>> halves;
  for (const auto& split : json["splits"]) {
    compared += split["frames_compared"].get<int>();
    const auto first = split["halves"][0].get<std::set<int>>();
    const auto second = split["halves"][1].get<std::set<int>>();
    EXPECT_EQ(first.size() + second.size(), 12U);
    std::set<int> both = first;
    both.insert(second.begin(), second.end());
    EXPECT_EQ(both.size(), 12U);
    halves.insert(first);
  }
  EXPECT_EQ(halves.size(), 4U);
  EXPECT_EQ(compared, json["frames_compared"]);
  const nlohmann::json& residuals = json["residuals"];
  EXPECT_GT(residuals["frames"], 8);
  for (const char* cause : {"paper", "lens", "shutter"}) {
    EXPECT_FALSE(residuals[cause]["significant"]) << cause;
    EXPECT_TRUE(residuals[cause]["overlay_px"].is_null()) << cause;
  }
}

TEST(SplitHalf, NamesAWrongCameraFile) {
  // The focal length of the camera file is 1 % too large.
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "camera.yaml";
  const CameraParameters given =
      load_camera(recordings_dir() / "tabletop" / "camera.yaml").value().parameters();
  CameraParameters wrong = given;
  wrong.fx *= 1.01;
  wrong.fy *= 1.01;
  ASSERT_TRUE(save_camera(file, CameraModel::make(wrong).value()));
  const std::filesystem::path json_file = folder.path() / "halves.json";
  const ProgramResult table = penumbra({"evaluate", "--split-half", bundled("tabletop"), "--camera",
                                        file.string(), "--json", json_file.string()});
  ASSERT_EQ(table.exit_code, 0) << table.err;
  const nlohmann::json json = read_json(json_file);
  // The camera moves so little that displaced tags explain the residuals almost as well.
  EXPECT_TRUE(json["residuals"]["lens"]["possible"]);
  EXPECT_NEAR(json["residuals"]["lens"]["focal_percent"].get<double>(), -0.99, 0.15);
  EXPECT_FALSE(json["residuals"]["shutter"]["possible"]);
  EXPECT_THAT(table.out, HasSubstr("lens or paper: this recording cannot separate these causes"));
}

TEST(SplitHalf, NamesAWrongMap) {
  const TemporaryFolder folder;
  std::vector<MappedTag> tags = load_tag_map(recordings_dir() / "tabletop" / "tags.yaml")->tags();
  for (std::size_t i = 0; i < tags.size(); ++i) {
    // Heights of a curled sheet.
    const Eigen::Vector3d p = tags[i].T_table_tag.translation();
    tags[i].T_table_tag = {tags[i].T_table_tag.rotation(),
                           p + Eigen::Vector3d(0.0, 0.0, 0.15 * p.x() * p.x())};
  }
  const std::string file = (folder.path() / "tags.yaml").string();
  ASSERT_TRUE(write_text_file(file, tag_map_text(TagMap::make(tags).value())));
  const nlohmann::json json = evaluated({"--split-half", bundled("tabletop"), "--tags", file});
  EXPECT_TRUE(json["residuals"]["paper"]["significant"]);
  EXPECT_FALSE(json["residuals"]["shutter"]["significant"]);
}

TEST(SplitHalf, WritesTableJsonAndPlot) {
  const TemporaryFolder folder;
  const auto json = folder.path() / "halves.json";
  const auto plot = folder.path() / "halves.svg";
  const std::filesystem::path some = folder.path() / "some";
  write_thinned_recording(some, bundled("tabletop"), 2);
  const std::vector<std::string> arguments = {"evaluate",    "--split-half", some.string(),
                                              "--tracking",  "fast",         "--json",
                                              json.string(), "--plot",       plot.string()};
  const ProgramResult first = penumbra(arguments);
  EXPECT_EQ(first.exit_code, 0) << first.err;
  EXPECT_EQ(first.err, "");
  EXPECT_THAT(first.out, HasSubstr("split 4"));
  EXPECT_THAT(first.out, HasSubstr("ratio: rmse / predicted"));
  EXPECT_THAT(first.out, HasSubstr("unique: share that no other cause explains"));
  EXPECT_THAT(first.out, HasSubstr("no cause is significant"));
  const std::string svg = bytes_of(plot);
  EXPECT_TRUE(svg.starts_with("<svg ")) << svg.substr(0, 100);
  EXPECT_TRUE(svg.ends_with("</svg>\n"));
  for (const char* group : {"difference", "prediction", "residuals"})
    EXPECT_THAT(svg, HasSubstr("<g id=\"" + std::string(group)));
  // The same recording gives the same results, bit for bit.
  const std::string before = bytes_of(json);
  EXPECT_EQ(penumbra(arguments).out, first.out);
  EXPECT_EQ(bytes_of(json), before);
  EXPECT_EQ(bytes_of(plot), svg);
}

TEST(SplitHalf, FailsInOneLineWithoutFourTags) {
  const TemporaryFolder folder;
  std::vector<MappedTag> tags = load_tag_map(recordings_dir() / "tabletop" / "tags.yaml")->tags();
  tags.resize(3);
  const std::string three = (folder.path() / "three.yaml").string();
  ASSERT_TRUE(write_text_file(three, tag_map_text(TagMap::make(tags).value())));
  const std::string some = (folder.path() / "tabletop").string();
  write_thinned_recording(some, bundled("tabletop"), 10);
  expect_failure(penumbra({"evaluate", "--split-half", some, "--tags", three}),
                 {"tabletop", "more than 3 tags", "not sufficient", "4 or more"});
  for (MappedTag& tag : tags) tag.id += 400;
  const std::string other = (folder.path() / "other.yaml").string();
  ASSERT_TRUE(write_text_file(other, tag_map_text(TagMap::make(tags).value())));
  expect_failure(penumbra({"evaluate", "--split-half", some, "--tags", other}),
                 {"tabletop", "no frame shows its tags", "--tags"});
}

TEST(SplitHalf, FailsInOneLineOnWrongPaths) {
  expect_failure(penumbra({"evaluate", "--split-half", "nowhere"}), {"nowhere"});
  expect_failure(penumbra({"evaluate", "--split-half", bundled("tabletop"), "--plot",
                           bundled("tabletop") + "/halves.svg"}),
                 {"halves.svg", "lies in the recording"});
  expect_failure(
      penumbra({"evaluate", "--split-half", bundled("tabletop"), "--plot", "/nowhere/halves.svg"}),
      {"/nowhere/halves.svg"});
}

TEST(SplitHalf, RejectsOptionsOfTheOtherComparison) {
  for (const std::vector<std::string>& wrong : std::vector<std::vector<std::string>>{
           {"evaluate", "--split-half", "r", "--estimated", "a.tum"},
           {"evaluate", "--split-half", "r", "--max-gap", "0.1"},
           {"evaluate", "--estimated", "a.tum", "--groundtruth", "b.tum", "--camera", "c.yaml",
            "--plot", "p.svg"},
           {"evaluate", "--split-half", "r", "--json", "x", "--plot", "x"}}) {
    const ProgramResult result = penumbra(wrong);
    EXPECT_EQ(result.exit_code, 2) << result.err;
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
  }
}

// Recordings with one known cause. `cause`: the significant one, or "".
struct SharedCase {
  const char* recording;
  const char* cause;
};

class SplitHalfRecordings : public testing::TestWithParam<SharedCase> {};

TEST_P(SplitHalfRecordings, ShowTheirCause) {
  if (shared_dir().empty()) GTEST_SKIP() << "no shared recordings beside the checkout";
  auto folder = shared_dir() / "recordings" / GetParam().recording;
  const TemporaryFolder temporary;
  if (!nightly() && std::string(GetParam().recording) == "bent") {
    // The slowest. Half of its frames determine the bend to 0.01 mm, so the bound is the same.
    write_thinned_recording(temporary.path() / "bent", folder, 2);
    folder = temporary.path() / "bent";
  }
  const nlohmann::json residuals = evaluated({"--split-half", folder.string()})["residuals"];
  for (const char* cause : {"paper", "lens", "shutter"})
    EXPECT_EQ(residuals[cause]["significant"], cause == std::string(GetParam().cause)) << cause;
  const std::string recording = GetParam().recording;
  if (recording == "bent") {
    EXPECT_NEAR(residuals["paper"]["off_flat_mm"], 1.8, 0.2);
  }
  if (recording == "lens") {
    EXPECT_NEAR(residuals["lens"]["focal_percent"], -0.6, 0.1);
    EXPECT_NEAR(residuals["overlay_px"], 1.92, 0.3);  // with the true lens and poses
  }
  if (recording == "rolling") {
    EXPECT_NEAR(residuals["shutter"]["row_time_us"], 40.0, 2.0);
    EXPECT_NEAR(residuals["overlay_px"], 2.69, 0.3);
  }
}
INSTANTIATE_TEST_SUITE_P(Causes, SplitHalfRecordings,
                         testing::Values(SharedCase{"bent", "paper"}, SharedCase{"lens", "lens"},
                                         SharedCase{"rolling", "shutter"},
                                         SharedCase{"tabletop", ""}, SharedCase{"still", ""}),
                         [](const auto& test) { return std::string(test.param.recording); });

}  // namespace
}  // namespace penumbra::test
