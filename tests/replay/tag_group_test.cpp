// A wall and a hand-held prop with tag groups, tracked through the program.
#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <numbers>
#include <regex>

#include "core/geometry/tag_map.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/image/image_file.hpp"
#include "core/text/text.hpp"
#include "core/units.hpp"
#include "replay_support.hpp"
#include "support/recording_folder.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

std::string corner_scene() {
  return (source_dir() / "scenes" / "corner.json").string();
}

class TagGroups : public testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  // Writes the tags of `corner` with the wall in a separate group whose map pose is wrong by T.
  void write_wrong_map(const std::string& name, const Eigen::Isometry3d& T) const {
    std::vector<MappedTag> tags =
        load_tag_map(recordings_dir() / "corner" / "tags-wall.yaml").value().tags();
    for (MappedTag& tag : tags) {
      if (tag.group != "wall") continue;
      tag.T_table_tag = {Eigen::Matrix3d(T.rotation() * tag.T_table_tag.rotation_matrix()),
                         T * tag.T_table_tag.translation()};
    }
    ASSERT_TRUE(write_text_file(file(name), tag_map_text(TagMap::make(tags).value())));
  }
  // Writes a scene whose wall has the same wrong pose. `tied`: the wall moves with its tag group.
  void write_wrong_scene(const std::string& name, const Eigen::Isometry3d& T, bool tied) const {
    nlohmann::json scene = read_json(corner_scene());
    nlohmann::json& wall = scene["planes"][1];
    const Eigen::Vector3d n = T.rotation() * Eigen::Vector3d(0, -1, 0);
    const Eigen::Vector3d p = T * Eigen::Vector3d(0, 0.165, 0.105);
    wall["normal"] = {n.x(), n.y(), n.z()};
    wall["point"] = {p.x(), p.y(), p.z()};
    if (!tied) wall.erase("tag_group");
    write_text(file(name), scene.dump());
  }
  // Writes tags, a camera, a camera path half a metre from the tags, and the path of a prop that
  // moves over the table.
  void write_simulation(int frames) const {
    std::string tags = "tags:\n";
    for (int i = 0; i < 4; ++i) {
      tags += fmt::format(
          "  - {{id: {}, family: tag36h11, size_m: 0.06, position: [{}, {}, 0], quaternion_xyzw: "
          "[0, 0, 0, 1]}}\n",
          i, i % 2 == 0 ? -0.045 : 0.045, i < 2 ? 0.045 : -0.045);
    }
    for (int i = 0; i < 2; ++i) {
      tags += fmt::format(
          "  - {{id: {}, family: tag36h11, size_m: 0.04, position: [{}, -0.01, 0.03], "
          "quaternion_xyzw: [0, 0, 0, 1], group: the prop}}\n",
          50 + i, 0.12 + 0.05 * i);
    }
    write_text(file("tags.yaml"), tags);
    write_text(file("camera.yaml"),
               "image_width: 480\nimage_height: 360\ncamera_name: made up\n"
               "camera_matrix:\n  rows: 3\n  cols: 3\n"
               "  data: [400.0, 0.0, 241.0, 0.0, 399.0, 178.0, 0.0, 0.0, 1.0]\n"
               "distortion_model: plumb_bob\n"
               "distortion_coefficients:\n  rows: 1\n  cols: 5\n"
               "  data: [-0.2, 0.06, 0.0008, -0.0006, -0.004]\n");
    Trajectory camera;
    Trajectory prop;
    for (int i = 0; i < frames; ++i) {
      const double t = i / 30.0;
      const std::int64_t time_ns = 1'000'000'000 + nanoseconds(t);
      const Eigen::Quaterniond down(
          Eigen::AngleAxisd(std::numbers::pi + 0.4 - 0.1 * t, Eigen::Vector3d::UnitX()));
      camera.poses.push_back(
          {time_ns, CameraPose(down, Eigen::Vector3d(0.04 + 0.03 * t, -0.2, 0.45)), {}});
      const Eigen::Quaterniond turn(
          Eigen::AngleAxisd(0.9 * t, Eigen::Vector3d(0.3, 0.1, 1.0).normalized()));
      prop.poses.push_back(
          {time_ns, CameraPose(turn, Eigen::Vector3d(-0.02 * t, 0.05 * t, 0.04 * t)), {}});
    }
    ASSERT_TRUE(save_trajectory(file("camera.tum"), camera));
    ASSERT_TRUE(save_trajectory(file("prop.tum"), prop));
  }
  [[nodiscard]] std::vector<std::string> simulation(const std::string& output,
                                                    const std::string& scene = "board") const {
    return {"simulate",     scene,
            "--camera",     file("camera.yaml"),
            "--tags",       file("tags.yaml"),
            "--trajectory", file("camera.tum"),
            "--group",      "the prop=" + file("prop.tum"),
            "--output",     file(output),
            "--noise",      "2",
            "--blur",       "0.004",
            "--seed",       "5"};
  }
  // Writes a scene with a box that stands on the prop, and the table that receives its shadow.
  void write_prop_scene(const std::string& name) const {
    write_text(file(name),
               R"({"objects":[{"name":"lid","shape":{"kind":"box","size":[0.03,0.03,0.02]},
             "position":[0.145,-0.01,0.05],"tag_group":"the prop"}],
            "planes":[{"name":"table"},
             {"name":"top","tag_group":"the prop","point":[0.145,-0.01,0.03],
              "outline":[[-0.09,-0.07],[0.09,-0.07],[0.09,0.07],[-0.09,0.07]]}],
            "shadows":[{"name":"s","technique":"layered","casters":["lid"],
             "planes":["table","top"],"layered":{"light_height":0.6,"light_ratio":3}}]})");
  }
  // Returns the fraction of pixels that differ by more than 8 grey levels, over all frames.
  [[nodiscard]] double differing(const std::string& a, const std::string& b) const {
    std::int64_t different = 0;
    std::int64_t all = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path() / a)) {
      const auto one = load_image(entry.path()).value();
      const auto other = load_image(folder_.path() / b / entry.path().filename()).value();
      for (int y = 0; y < one.height; ++y) {
        const std::uint8_t* p = one.planes[0].data + y * one.planes[0].stride;
        const std::uint8_t* q = other.planes[0].data + y * other.planes[0].stride;
        for (int x = 0; x < 3 * one.width; x += 3, ++all)
          different += std::abs(int{p[x]} - int{q[x]}) > 8 ? 1 : 0;
      }
    }
    return static_cast<double>(different) / static_cast<double>(all);
  }
  TemporaryFolder folder_;
};

// The wall's pose is measured, not taken from the map. Maps that are wrong by centimetres must give
// the same image.
TEST_F(TagGroups, MeasuresWallPoseDespiteWrongMap) {
  Eigen::Isometry3d wrong = Eigen::Isometry3d::Identity();
  wrong.translate(Eigen::Vector3d(0.01, 0.03, -0.02));
  wrong.rotate(Eigen::AngleAxisd(radians(9.0), Eigen::Vector3d(0.4, 1.0, 0.7).normalized()));
  write_wrong_map("wrong.yaml", wrong);
  write_wrong_scene("wrong.json", wrong, true);
  write_wrong_scene("fixed.json", Eigen::Isometry3d::Identity(), false);
  write_wrong_scene("believed.json", wrong, false);
  std::vector<std::string> recordings = {bundled("corner")};
  if (std::filesystem::exists(shared_dir() / "recordings" / "corner")) {
    recordings.push_back((shared_dir() / "recordings" / "corner").string());
  }
  for (const std::string& recording : recordings) {
    SCOPED_TRACE(recording);
    for (const char* old : {"measured", "fixed", "believed"}) {
      std::filesystem::remove_all(folder_.path() / old);
    }
    const bool is_bundled = recording == bundled("corner");
    const ProgramResult measured =
        penumbra({"replay", recording, "--no-window", "--tags", file("wrong.yaml"), "--scene",
                  file("wrong.json"), "--output", file("measured/"), "--frames",
                  is_bundled ? "0:4" : "40:44", "--group-poses", file("groups"), "--report",
                  file("report.json")});
    ASSERT_EQ(measured.exit_code, 0) << measured.err;
    EXPECT_EQ(measured.err, "");
    const nlohmann::json report = read_json(file("report.json"));
    EXPECT_EQ(report["groups"]["wall"]["frames_tracked"], 4);
    EXPECT_EQ(report["groups"]["wall"]["frames_lost"], 0);
    EXPECT_LT(report["groups"]["wall"]["reprojection_rms_px"]["max"].get<double>(), 0.5);
    EXPECT_EQ(report["tracking"]["full_detections"], 1);
    const Trajectory places = load_trajectory(folder_.path() / "groups" / "wall.tum").value();
    ASSERT_EQ(places.poses.size(), 4U);
    for (const StampedPose& place : places.poses) {
      // The measured pose must compensate for the map's error.
      const Eigen::Isometry3d found = Eigen::Isometry3d(place.T_table_camera.matrix()) * wrong;
      EXPECT_LT(Eigen::AngleAxisd(found.rotation()).angle(), radians(0.15));
      EXPECT_LT(
          (found * Eigen::Vector3d(0, 0.165, 0.105) - Eigen::Vector3d(0, 0.165, 0.105)).norm(),
          0.0006);
    }
    for (const auto& [name, scene] :
         {std::pair{"fixed", "fixed.json"}, std::pair{"believed", "believed.json"}}) {
      const ProgramResult other = penumbra(
          {"replay", recording, "--no-window", "--tags",
           (recordings_dir() / "corner" / "tags-wall.yaml").string(), "--scene", file(scene),
           "--output", file(std::string(name) + "/"), "--frames", is_bundled ? "0:4" : "40:44"});
      ASSERT_EQ(other.exit_code, 0) << other.err;
    }
    EXPECT_LT(differing("measured", "fixed"), 5e-4);
    EXPECT_GT(differing("measured", "believed"), 2e-3) << "a wrong wall pose must change the image";
    std::filesystem::remove_all(folder_.path() / "groups");
  }
}

TEST_F(TagGroups, ReusesShadowOfWallAtRest) {
  const ProgramResult run =
      penumbra({"replay", bundled("corner"), "--no-window", "--tags",
                (recordings_dir() / "corner" / "tags-wall.yaml").string(), "--scene",
                corner_scene(), "--shadow", "hard", "--report", file("report.json")});
  ASSERT_EQ(run.exit_code, 0) << run.err;
  EXPECT_EQ(run.err, "");
  EXPECT_THAT(run.out, HasSubstr("tag group wall: tracked 40"));
  const nlohmann::json report = read_json(file("report.json"));
  EXPECT_LE(report["work"]["plane_moved"].get<int>(), 6) << "moved planes in 39 frame changes";
  EXPECT_FALSE(report["skipped"].contains("group_not_seen"));
}

// A hand-held prop is compared with exact truth in every output.
TEST_F(TagGroups, TracksHandHeldPropToItsTruth) {
  const int frames = nightly() ? 24 : 8;
  write_simulation(frames);
  write_prop_scene("scene.json");
  const ProgramResult made = penumbra(simulation("made"));
  ASSERT_EQ(made.exit_code, 0) << made.err;
  const Trajectory truth =
      load_trajectory(folder_.path() / "made" / "groups" / "the prop.tum").value();
  EXPECT_EQ(truth.poses.size(), static_cast<std::size_t>(frames));
  const Trajectory given = load_trajectory(file("prop.tum")).value();
  for (std::size_t i = 0; i < truth.poses.size(); ++i) {
    EXPECT_EQ(truth.poses[i].timestamp_ns, given.poses[i].timestamp_ns);
    EXPECT_EQ(truth.poses[i].T_table_camera.matrix(), given.poses[i].T_table_camera.matrix());
  }
  EXPECT_THAT(bytes_of(file("made/groups/the prop.tum")), HasSubstr("T_table_group"));

  const auto run = [&](const std::string& output, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"replay",
                                          file("made"),
                                          "--no-window",
                                          "--scene",
                                          file("scene.json"),
                                          "--output",
                                          file(output + "/"),
                                          "--poses",
                                          file(output + ".tum"),
                                          "--report",
                                          file(output + ".json")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    const ProgramResult result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(result.err, "");
    return read_json(file(output + ".json"));
  };
  const nlohmann::json report = run("tracked", {"--group-poses", file("places")});
  const nlohmann::json& prop = report["groups"]["the prop"];
  EXPECT_GE(prop["frames_tracked"].get<int>(), frames * 11 / 12);
  EXPECT_LT(prop["accuracy"]["overlay_px"]["rmse"].get<double>(), 1.0);
  EXPECT_LT(prop["accuracy"]["overlay_px"]["max"].get<double>(), 3.0);
  EXPECT_LT(prop["accuracy"]["translation_mm"]["median"].get<double>(), 3.0);
  const Trajectory places = load_trajectory(file("places/the prop.tum")).value();
  EXPECT_EQ(static_cast<int>(places.poses.size()), prop["frames_tracked"].get<int>());

  // `evaluate` must report the same errors.
  const std::vector<std::string> evaluation = {"evaluate",
                                               "--estimated",
                                               file("tracked.tum"),
                                               "--groundtruth",
                                               file("made/groundtruth.tum"),
                                               "--camera",
                                               file("made/camera.yaml"),
                                               "--tags",
                                               file("made/tags.yaml"),
                                               "--estimated-groups",
                                               file("places"),
                                               "--groundtruth-groups",
                                               file("made/groups")};
  const ProgramResult evaluated = penumbra(evaluation);
  ASSERT_EQ(evaluated.exit_code, 0) << evaluated.err;
  EXPECT_THAT(evaluated.out, HasSubstr("tag group the prop"));
  std::vector<std::string> as_json = evaluation;
  as_json.insert(as_json.end(), {"--per-frame", file("errors.jsonl"), "--json"});
  const auto json = nlohmann::json::parse(penumbra(as_json).out, nullptr, false);
  ASSERT_TRUE(json.is_object());
  EXPECT_NEAR(json["groups"]["the prop"]["overlay_px"]["rmse"].get<double>(),
              prop["accuracy"]["overlay_px"]["rmse"].get<double>(), 1e-3);
  // Each row of the group follows that of the table at the same time.
  double squares = 0.0;
  int rows_of_prop = 0;
  nlohmann::json before;
  for (const std::string& line : lines_of(bytes_of(file("errors.jsonl")))) {
    const nlohmann::json row = nlohmann::json::parse(line);
    if (row["group"] == "the prop") {
      ++rows_of_prop;
      EXPECT_EQ(before["group"], "table");
      EXPECT_EQ(row["timestamp_s"], before["timestamp_s"]);
      squares += std::pow(row["overlay_frame_px"].get<double>(), 2);
    }
    before = row;
  }
  EXPECT_EQ(rows_of_prop, json["groups"]["the prop"]["frames_estimated"]);
  EXPECT_NEAR(std::sqrt(squares / rows_of_prop),
              json["groups"]["the prop"]["overlay_frame_px"]["rmse"], 1e-9);
  std::vector<std::string> elsewhere = evaluation;
  elsewhere.back() = file("made/frames");
  const ProgramResult none = penumbra(elsewhere);
  EXPECT_EQ(none.exit_code, 1);
  EXPECT_THAT(none.err, HasSubstr("has no file of a group"));
  elsewhere.back() = file("nowhere");
  const ProgramResult nowhere = penumbra(elsewhere);
  EXPECT_EQ(nowhere.exit_code, 1);
  EXPECT_THAT(nowhere.err, HasSubstr(file("nowhere") + ": is not a folder"));
  elsewhere.resize(elsewhere.size() - 2);
  EXPECT_EQ(penumbra(elsewhere).exit_code, 2);

  // Given poses must draw the same scene, except for the tracking error.
  run("given", {"--poses-from", "groundtruth"});
  EXPECT_LT(differing("tracked", "given"), 2e-3);
  // Without skipping, and for any number of threads, the bits must be the same.
  run("all", {"--no-skip", "--threads", "1"});
  EXPECT_EQ(contents_of(folder_.path() / "tracked"), contents_of(folder_.path() / "all"));
  EXPECT_EQ(bytes_of(file("tracked.tum")), bytes_of(file("all.tum")));
}

// A recorded session contains the groups' poses and replays with them.
TEST_F(TagGroups, RecordsGroupPosesInLiveSession) {
  write_simulation(10);
  write_prop_scene("scene.json");
  ASSERT_EQ(penumbra(simulation("made")).exit_code, 0);
  const ProgramResult live = penumbra(
      {"live", "--camera", "recording:" + file("made"), "--calibration", file("made/camera.yaml"),
       "--tags", file("made/tags.yaml"), "--scene", file("scene.json"), "--no-window", "--fps",
       "15", "--duration", "0.7", "--record", file("session"), "--report", file("live.json")});
  ASSERT_EQ(live.exit_code, 0) << live.err;
  const nlohmann::json report = read_json(file("live.json"));
  const int tracked = report["groups"]["the prop"]["frames_tracked"];
  // After a gap of seconds between the frames of an instrumented program, the prop is searched
  // again.
  EXPECT_GE(tracked, kSanitized ? 2 : 6);
  const Trajectory places =
      load_trajectory(folder_.path() / "session" / "group-poses" / "the prop.tum").value();
  EXPECT_EQ(static_cast<int>(places.poses.size()), tracked);

  // Tracking the recording again is deterministic and finds table and prop at their poses.
  const auto replayed = [&](const std::string& threads) {
    const ProgramResult replay =
        penumbra({"replay", file("session"), "--no-window", "--scene", file("scene.json"),
                  "--threads", threads, "--poses", file("replay" + threads + ".tum"),
                  "--group-poses", file("places" + threads)});
    EXPECT_EQ(replay.exit_code, 0) << replay.err;
  };
  replayed("1");
  replayed("2");
  EXPECT_EQ(bytes_of(file("replay1.tum")), bytes_of(file("replay2.tum")));
  EXPECT_EQ(bytes_of(file("places1/the prop.tum")), bytes_of(file("places2/the prop.tum")));
  const ProgramResult compared = penumbra(
      {"evaluate", "--estimated", file("session/poses.tum"), "--groundtruth", file("replay1.tum"),
       "--camera", file("made/camera.yaml"), "--tags", file("made/tags.yaml"), "--estimated-groups",
       file("session/group-poses"), "--groundtruth-groups", file("places1"), "--json"});
  ASSERT_EQ(compared.exit_code, 0) << compared.err;
  const auto json = nlohmann::json::parse(compared.out, nullptr, false);
  EXPECT_LT(json["overlay_frame_px"]["max"].get<double>(), 0.2);
  EXPECT_LT(json["groups"]["the prop"]["overlay_frame_px"]["median"].get<double>(), 0.3);
  // The poses of the tracked session include those of the groups.
  const ProgramResult given =
      penumbra({"replay", file("session"), "--no-window", "--scene", file("scene.json"),
                "--poses-from", file("session/poses.tum"), "--report", file("given.json")});
  ASSERT_EQ(given.exit_code, 0) << given.err;
  EXPECT_EQ(read_json(file("given.json"))["groups"]["the prop"]["frames_tracked"], tracked);
}

// Groups that the scene does not use are not tracked. The program reports that, and the output is
// the same.
TEST_F(TagGroups, SkipsGroupsUnusedByScene) {
  write_simulation(3);
  ASSERT_EQ(penumbra(simulation("made")).exit_code, 0);
  const std::string scene = (source_dir() / "scenes" / "default.json").string();
  const auto run = [&](const std::string& output, const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"replay",
                                          file("made"),
                                          "--no-window",
                                          "--scene",
                                          scene,
                                          "--output",
                                          file(output + "/"),
                                          "--poses",
                                          file(output + ".tum"),
                                          "--report",
                                          file(output + ".json")};
    arguments.insert(arguments.end(), more.begin(), more.end());
    EXPECT_EQ(penumbra(arguments).exit_code, 0);
    return read_json(file(output + ".json"));
  };
  const nlohmann::json skipping = run("skipping", {});
  EXPECT_EQ(skipping["skipped"]["group_not_in_scene"], 3);
  EXPECT_FALSE(skipping.contains("groups"));
  const nlohmann::json all = run("all", {"--no-skip"});
  EXPECT_FALSE(all["skipped"].contains("group_not_in_scene"));
  EXPECT_EQ(all["groups"]["the prop"]["frames_tracked"], 3);
  EXPECT_EQ(contents_of(folder_.path() / "skipping"), contents_of(folder_.path() / "all"));
  EXPECT_EQ(bytes_of(file("skipping.tum")), bytes_of(file("all.tum")));
}

// Objects in a simulated recording move with the prop.
TEST_F(TagGroups, DrawsSimulatedObjectsOnTheirGroup) {
  write_simulation(2);
  write_prop_scene("scene.json");
  ASSERT_EQ(penumbra(simulation("board")).exit_code, 0);
  const ProgramResult made = penumbra(simulation("scene", file("scene.json")));
  ASSERT_EQ(made.exit_code, 0) << made.err;
  EXPECT_EQ(bytes_of(file("scene/groups/the prop.tum")),
            bytes_of(file("board/groups/the prop.tum")));
  const auto again = penumbra(simulation("again", file("scene.json")));
  EXPECT_EQ(contents_of(folder_.path() / "scene" / "frames"),
            contents_of(folder_.path() / "again" / "frames"));
  const auto changed = [&](const char* frame) {
    const auto plain = load_image(folder_.path() / "board" / "frames" / frame).value();
    const auto drawn = load_image(folder_.path() / "scene" / "frames" / frame).value();
    int count = 0;
    for (int y = 0; y < plain.height; ++y) {
      for (int x = 0; x < plain.width; ++x) {
        count += std::abs(int{plain.planes[0].data[y * plain.planes[0].stride + x]} -
                          int{drawn.planes[0].data[y * drawn.planes[0].stride + 3 * x]}) > 25
                     ? 1
                     : 0;
      }
    }
    return count;
  };
  EXPECT_GT(changed("000001.png"), 200);
}

TEST_F(TagGroups, ReportsErrorsInOneLine) {
  write_simulation(2);
  const auto with_group = [&](const std::string& group) {
    std::vector<std::string> arguments = simulation("never");
    arguments[9] = group;
    return penumbra(arguments);
  };
  expect_failure(with_group("unknown=" + file("prop.tum")),
                 {"unknown", "tags.yaml", "it has the prop"});
  expect_failure(with_group("the prop=" + file("none.tum")), {"none.tum"});
  write_text(file("short.tum"), "1 0 0 0 0 0 0 1\n1.01 0 0 0 0 0 0 1\n");
  expect_failure(with_group("the prop=" + file("short.tum")), {"short.tum", "camera"});
  EXPECT_EQ(with_group("the prop").exit_code, 2);
  EXPECT_EQ(with_group("=x.tum").exit_code, 2);
  EXPECT_FALSE(std::filesystem::exists(file("never")));

  // A scene with a group that the recording's tags lack gives a warning.
  const ProgramResult warned =
      penumbra({"replay", bundled("tabletop"), "--no-window", "--scene", corner_scene(), "--frames",
                "0:3", "--report", file("report.json")});
  EXPECT_EQ(warned.exit_code, 0);
  ASSERT_EQ(lines_of(warned.err).size(), 1U) << warned.err;
  EXPECT_THAT(warned.err, testing::AllOf(HasSubstr("corner.json"), HasSubstr("\"wall\""),
                                         HasSubstr("tags.yaml")));
  EXPECT_EQ(read_json(file("report.json"))["skipped"]["group_not_seen"], 3);

  // The pose file of a group may be damaged, and a group's name may be invalid as a file name.
  ASSERT_EQ(penumbra(simulation("made")).exit_code, 0);
  write_text(file("made/groups/the prop.tum"), "1 0 0 nan 0 0 0 1\n");
  expect_failure(penumbra({"replay", file("made"), "--no-window"}), {"the prop.tum", "line 1"});
  std::filesystem::remove(file("made/groups/the prop.tum"));
  std::string tags = bytes_of(file("made/tags.yaml"));
  tags = std::regex_replace(tags, std::regex("the prop"), "a/b");
  write_text(file("slash.yaml"), tags);
  expect_failure(penumbra({"replay", file("made"), "--no-window", "--tags", file("slash.yaml"),
                           "--group-poses", file("places")}),
                 {"a/b"});
  EXPECT_EQ(
      penumbra({"replay", file("made"), "--no-window", "--tags", file("slash.yaml")}).exit_code, 0);
  expect_failure(
      penumbra({"replay", file("made"), "--no-window", "--group-poses", file("made/places")}),
      {"made/places", "only read"});
  write_text(file("a_file"), "x");
  expect_failure(penumbra({"replay", file("made"), "--no-window", "--group-poses", file("a_file")}),
                 {"a_file", "folder"});
}

}  // namespace
}  // namespace penumbra::test
