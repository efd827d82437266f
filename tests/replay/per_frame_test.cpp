// Values of each frame: --frame-log of replay and live, evaluate --per-frame, wall-clock times.
#include <gmock/gmock.h>

#include <chrono>
#include <functional>
#include <map>
#include <set>

#include "core/evaluation/evaluation.hpp"
#include "core/text/text.hpp"
#include "replay_support.hpp"
#include "support/recording_folder.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;
using Rows = std::vector<nlohmann::json>;

Rows rows_of(const std::filesystem::path& file) {
  Rows rows;
  for (const std::string& line : lines_of(bytes_of(file)))
    rows.push_back(nlohmann::json::parse(line));
  return rows;
}

// Returns the known values of a column in the rows that `accepts` returns true for.
std::vector<double> column_of(const Rows& rows, const char* name,
                              const std::function<bool(const nlohmann::json&)>& accepts) {
  std::vector<double> values;
  for (const nlohmann::json& row : rows) {
    if (accepts(row) && !row.at(name).is_null()) values.push_back(row.at(name));
  }
  return values;
}

void expect_statistics(const nlohmann::json& reported, const std::vector<double>& values) {
  ASSERT_FALSE(values.empty());
  const Statistics statistics = statistics_of(values);
  EXPECT_NEAR(reported["rmse"], statistics.rmse, 1e-12);
  EXPECT_NEAR(reported["median"], statistics.median, 1e-12);
  EXPECT_NEAR(reported["p95"], statistics.p95, 1e-12);
  EXPECT_NEAR(reported["max"], statistics.max, 1e-12);
}

class PerFrame : public testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  [[nodiscard]] std::vector<std::string> evaluate_with(const std::string& estimated,
                                                       std::vector<std::string> more) const {
    const std::vector<std::string> begin = {"evaluate",
                                            "--estimated",
                                            estimated,
                                            "--groundtruth",
                                            file("truth.tum"),
                                            "--camera",
                                            bundled("tabletop") + "/camera.yaml"};
    more.insert(more.begin(), begin.begin(), begin.end());
    return more;
  }
  // Replays 12 frames, and keeps true poses up to the tenth, where the truth has a gap of 0.17 s.
  void replay_tabletop() const {
    const ProgramResult done =
        penumbra({"replay", bundled("tabletop"), "--frames", "0:12", "--no-window", "--scene",
                  empty_scene_in(folder_.path()), "--poses", file("out.tum"), "--frame-log",
                  file("log.csv"), "--report", file("report.json")});
    ASSERT_EQ(done.exit_code, 0) << done.err;
    std::string truth;
    int line_number = -1;
    for (const std::string& line : lines_of(bytes_of(bundled("tabletop") + "/groundtruth.tum"))) {
      if (line.starts_with("#")) continue;
      if (++line_number <= 9 && (line_number < 4 || line_number > 7)) truth += line + "\n";
    }
    std::ofstream(file("truth.tum")) << truth;
  }
  TemporaryFolder folder_;
};

TEST_F(PerFrame, WritesErrorsThatEvaluateSums) {
  ASSERT_NO_FATAL_FAILURE(replay_tabletop());
  const ProgramResult done =
      penumbra(evaluate_with(file("log.csv"), {"--per-frame", file("errors.jsonl"), "--json"}));
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const nlohmann::json json = nlohmann::json::parse(done.out);
  const Rows rows = rows_of(file("errors.jsonl"));
  ASSERT_EQ(rows.size(), 12U);
  EXPECT_EQ(json["frames_estimated"], 12);
  EXPECT_EQ(json["not_judged"]["gap_too_long"], 4);
  EXPECT_EQ(json["not_judged"]["outside_truth"], 2);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(rows[i]["group"], "table");
    const char* cause = i > 9 ? "outside_truth" : i > 3 && i < 8 ? "gap_too_long" : nullptr;
    EXPECT_EQ(rows[i]["not_judged"], cause == nullptr ? nlohmann::json() : nlohmann::json(cause));
    EXPECT_EQ(rows[i]["translation_mm"].is_null(), cause != nullptr);
    EXPECT_FALSE(rows[i]["predicted_px"].is_null());
    EXPECT_EQ(rows[i]["jitter_px"].is_null(), cause != nullptr || i == 0 || i == 8);
  }
  const auto any = [](const nlohmann::json&) { return true; };
  for (const char* name : {"translation_mm", "rotation_deg", "overlay_frame_px", "frame_ratio"})
    expect_statistics(json[name], column_of(rows, name, any));
  EXPECT_NEAR(json["jitter_px"], statistics_of(column_of(rows, "jitter_px", any)).rmse, 1e-12);

  // The frame log and the pose file are the same poses. Only the log has predicted errors.
  const ProgramResult of_poses =
      penumbra(evaluate_with(file("out.tum"), {"--per-frame", file("poses.jsonl"), "--json"}));
  ASSERT_EQ(of_poses.exit_code, 0) << of_poses.err;
  const nlohmann::json json_of_poses = nlohmann::json::parse(of_poses.out);
  EXPECT_FALSE(json_of_poses.contains("frame_ratio"));
  for (const char* name : {"translation_mm", "rotation_deg", "overlay_px", "overlay_frame_px",
                           "jitter_px", "frames_judged"})
    EXPECT_EQ(json_of_poses[name], json[name]) << name;
  Rows unpredicted = rows;
  for (nlohmann::json& row : unpredicted) row["predicted_px"] = row["frame_ratio"] = nullptr;
  EXPECT_EQ(rows_of(file("poses.jsonl")), unpredicted);
}

TEST_F(PerFrame, CountsFramesOfLogWithoutTrackedPose) {
  ASSERT_NO_FATAL_FAILURE(replay_tabletop());
  EXPECT_THAT(penumbra(evaluate_with(file("log.csv"), {})).err,
              testing::Not(HasSubstr("no tracked pose")));
  std::string log = read_text_file(file("log.csv"), 1 << 20).value();
  const std::string tracked = ",table,tracked,";
  log.replace(log.find(tracked), tracked.size(), ",table,uncertain,");
  ASSERT_TRUE(write_text_file(file("log.csv"), log));
  const ProgramResult done = penumbra(evaluate_with(file("log.csv"), {}));
  EXPECT_EQ(done.exit_code, 0);
  EXPECT_THAT(done.err, HasSubstr("log.csv: 1 of 12 frames have no tracked pose"));
}

TEST_F(PerFrame, StreamsToStandardOutput) {
  ASSERT_NO_FATAL_FAILURE(replay_tabletop());
  const ProgramResult in_file =
      penumbra(evaluate_with(file("log.csv"), {"--per-frame", file("errors.csv")}));
  ASSERT_EQ(in_file.exit_code, 0) << in_file.err;
  EXPECT_THAT(in_file.out, HasSubstr("judged frames with a pose: 6 of 12"));
  const std::string csv = bytes_of(file("errors.csv"));
  EXPECT_TRUE(csv.starts_with("timestamp_s,group,not_judged,translation_mm,")) << csv;
  for (const char* name : {"-", "/dev/stdout"}) {
    const ProgramResult streamed = penumbra(evaluate_with(file("log.csv"), {"--per-frame", name}));
    EXPECT_EQ(streamed.exit_code, 0) << streamed.err;
    EXPECT_EQ(streamed.out, csv);
    EXPECT_EQ(streamed.err, in_file.out);
  }
  // Nothing is written if no pose can be compared.
  expect_failure(penumbra(evaluate_with(file("log.csv"),
                                        {"--per-frame", file("none.csv"), "--time-offset", "99"})),
                 {"log.csv", "no pose that can be compared"});
  EXPECT_FALSE(std::filesystem::exists(file("none.csv")));
}

TEST_F(PerFrame, WritesDifferencesOfHalves) {
  const std::filesystem::path recording = folder_.path() / "some";
  write_thinned_recording(recording, bundled("tabletop"), 12);
  std::string listing;
  int line_number = 0;
  for (const std::string& line : lines_of(bytes_of(recording / "timestamps.csv"))) {
    listing +=
        line +
        (line_number == 0 ? ",wall_time_ns"
                          : "," + std::to_string(1'790'000'000 - line_number) + "000000005") +
        "\n";
    ++line_number;
  }
  write_text(recording / "timestamps.csv", listing);
  const std::vector<std::string> arguments = {"evaluate",   "--split-half", recording.string(),
                                              "--tracking", "fast",         "--per-frame"};
  std::vector<std::string> to_file = arguments;
  to_file.insert(to_file.end(), {file("halves.jsonl"), "--json"});
  const ProgramResult done = penumbra(to_file);
  ASSERT_EQ(done.exit_code, 0) << done.err;
  const nlohmann::json json = nlohmann::json::parse(done.out);
  const Rows rows = rows_of(file("halves.jsonl"));
  ASSERT_EQ(rows.size(), 40U);
  std::set<std::string> walls;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(rows[i]["frame"], i / 4 * 12);
    EXPECT_EQ(rows[i]["split"], i % 4 + 1);
    walls.insert(rows[i]["wall_time"]);
  }
  EXPECT_EQ(walls.size(), 10U);
  EXPECT_EQ(rows[0]["wall_time"], "2026-09-21T14:13:19.000000005Z");
  const auto any = [](const nlohmann::json&) { return true; };
  EXPECT_EQ(column_of(rows, "split_half_px", any).size(), json["frames_compared"]);
  for (const char* name : {"split_half_px", "predicted_px", "frame_ratio"}) {
    expect_statistics(json[name], column_of(rows, name, any));
    for (int split = 0; split < 4; ++split) {
      expect_statistics(json["splits"][split][name],
                        column_of(rows, name, [split](const nlohmann::json& row) {
                          return row["split"] == split + 1;
                        }));
    }
  }
  std::vector<std::string> streaming = arguments;
  streaming.emplace_back("-");
  const ProgramResult streamed = penumbra(streaming);
  EXPECT_EQ(streamed.exit_code, 0);
  EXPECT_EQ(lines_of(streamed.out).size(), 41U);
  EXPECT_TRUE(streamed.out.starts_with("frame,timestamp_s,wall_time,split,rejected,"));
  EXPECT_THAT(streamed.err, HasSubstr("frames compared: "));
}

TEST_F(PerFrame, RejectsWrongFiles) {
  const std::string recording = bundled("tabletop");
  std::ofstream(file("a.tum")) << "0 0 0 1 0 0 0 1\n";
  const auto pair = [&](std::vector<std::string> more) {
    std::vector<std::string> arguments = {"evaluate",
                                          "--estimated",
                                          file("a.tum"),
                                          "--groundtruth",
                                          file("a.tum"),
                                          "--camera",
                                          recording + "/camera.yaml"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  };
  struct Wrong {
    std::vector<std::string> arguments;
    const char* message;
  };
  for (const Wrong& wrong :
       {Wrong{pair({"--per-frame", file("errors.txt")}), "end it in .csv or .jsonl"},
        Wrong{pair({"--per-frame"}), "--per-frame"},
        Wrong{pair({"--per-frame", file("e.csv"), "--json", file("e.csv")}), "e.csv"},
        Wrong{pair({"--per-frame", "-", "--json"}), "standard output is taken by --json"},
        Wrong{pair({"--per-frame", "/dev/stdout", "--json", "-"}),
              "standard output is taken by --json"},
        Wrong{{"evaluate", "--split-half", "r", "--per-frame", "-", "--plot", "-"},
              "standard output is taken by --per-frame"},
        Wrong{{"evaluate", "--split-half", "r", "--per-frame", file("x.csv"), "--plot",
               file("x.csv")},
              ".svg"}}) {
    const ProgramResult result = penumbra(wrong.arguments);
    EXPECT_EQ(result.exit_code, 2) << result.err;
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
    EXPECT_THAT(result.err, HasSubstr(wrong.message));
  }
  // The estimate is never replaced.
  std::filesystem::copy_file(file("a.tum"), file("log.csv"));
  std::vector<std::string> onto_input = pair({"--per-frame", file("log.csv")});
  onto_input[2] = file("log.csv");
  const ProgramResult result = penumbra(onto_input);
  EXPECT_EQ(result.exit_code, 2) << result.err;
  EXPECT_EQ(bytes_of(file("log.csv")), bytes_of(file("a.tum")));
  expect_failure(
      penumbra({"evaluate", "--split-half", recording, "--per-frame", recording + "/halves.csv"}),
      {"halves.csv", "lies in the recording"});
  expect_failure(
      penumbra({"evaluate", "--split-half", recording, "--per-frame", "/nowhere/halves.csv"}),
      {"/nowhere/halves.csv"});
  expect_failure(penumbra(pair({"--per-frame", "/nowhere/e.csv"})), {"/nowhere/e.csv"});
}

// A live session: recording, frame log and replay have the same wall-clock time of a frame.
TEST_F(PerFrame, LiveSessionHasWallClockTimes) {
  const auto system_ns = [] {
    return std::chrono::system_clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
  };
  const std::int64_t begin_ns = system_ns();
  const ProgramResult live =
      penumbra({"live", "--camera", "recording:" + bundled("tabletop"), "--no-window", "--scene",
                empty_scene_in(folder_.path()), "--duration", "0.6", "--record", file("session"),
                "--frame-log", file("live.jsonl")});
  ASSERT_EQ(live.exit_code, 0) << live.err;
  const std::int64_t end_ns = system_ns();
  const std::vector<std::string> listing =
      lines_of(bytes_of(folder_.path() / "session" / "timestamps.csv"));
  EXPECT_EQ(listing.at(0), "frame,timestamp_s,file,wall_time_ns");
  ASSERT_GT(listing.size(), 2U);
  for (std::size_t i = 1; i < listing.size(); ++i) {
    const std::int64_t wall_ns = std::stoll(listing[i].substr(listing[i].rfind(',') + 1));
    EXPECT_GE(wall_ns, begin_ns) << listing[i];
    EXPECT_LE(wall_ns, end_ns) << listing[i];
  }

  const auto replay = [&](const std::string& name) {
    const ProgramResult done = penumbra(
        {"replay", file("session"), "--no-window", "--scene", empty_scene_in(folder_.path()),
         "--poses", file(name + ".tum"), "--frame-log", file(name + ".jsonl")});
    ASSERT_EQ(done.exit_code, 0) << done.err;
    EXPECT_EQ(done.err, "");
  };
  replay("replay");
  std::map<double, std::string> replayed;
  for (const nlohmann::json& row : rows_of(file("replay.jsonl")))
    replayed[row["timestamp_s"]] = row["wall_time"];
  EXPECT_EQ(replayed.size(), listing.size() - 1);
  std::size_t common = 0;
  for (const nlohmann::json& row : rows_of(file("live.jsonl"))) {
    const auto found = replayed.find(row["timestamp_s"]);
    if (found == replayed.end()) continue;
    ++common;
    EXPECT_EQ(row["wall_time"], found->second);
  }
  EXPECT_GT(common, 0U);

  // Without the column, as older versions recorded, the poses are the same.
  std::string older;
  for (const std::string& line : listing) older += line.substr(0, line.rfind(',')) + "\n";
  write_text(folder_.path() / "session" / "timestamps.csv", older);
  replay("older");
  EXPECT_EQ(bytes_of(file("older.tum")), bytes_of(file("replay.tum")));
  for (const nlohmann::json& row : rows_of(file("older.jsonl")))
    EXPECT_TRUE(row["wall_time"].is_null());
}

TEST_F(PerFrame, ReportsMalformedWallClockTimeInOneLine) {
  const std::filesystem::path recording = folder_.path() / "some";
  write_thinned_recording(recording, bundled("tabletop"), 40);
  std::string listing;
  for (const std::string& line : lines_of(bytes_of(recording / "timestamps.csv")))
    listing += line + (listing.empty() ? ",wall_time_ns" : ",2026-11-28T04:29:37Z") + "\n";
  write_text(recording / "timestamps.csv", listing);
  expect_failure(penumbra({"replay", recording.string(), "--no-window"}),
                 {"timestamps.csv: line 2: wall_time_ns: '2026-11-28T04:29:37Z'", "nanoseconds"});
}

}  // namespace
}  // namespace penumbra::test
