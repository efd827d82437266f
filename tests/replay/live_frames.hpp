// Compares the frames of a live session with those of its replay.
#pragma once

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "replay/replay_support.hpp"
#include "support/replay_tracking.hpp"

namespace penumbra::test {

// Returns the arguments of a live session that plays the recording `tabletop`. It is recorded in
// FOLDER/session, its images are in FOLDER/live and its poses in FOLDER/live.tum.
inline std::vector<std::string> live_arguments(const std::filesystem::path& folder,
                                               const std::vector<std::string>& more) {
  std::vector<std::string> words = {
      "live",          "--camera",         "recording:" + bundled("tabletop"),
      "--record",      folder / "session", "--output",
      folder / "live", "--poses",          folder / "live.tum",
      "--poses-all"};
  words.insert(words.end(), more.begin(), more.end());
  return words;
}

// Replays FOLDER/session with the poses of FOLDER/live.tum to FOLDER/NAME; returns the images.
// `done`: result of the program.
inline std::map<std::string, std::string> replay_session(const std::filesystem::path& folder,
                                                         const std::string& name,
                                                         const std::vector<std::string>& more,
                                                         ProgramResult& done) {
  std::vector<std::string> words = {"replay",       folder / "session",  "--no-window",
                                    "--poses-from", folder / "live.tum", "--output",
                                    folder / name};
  words.insert(words.end(), more.begin(), more.end());
  done = penumbra(words);
  EXPECT_EQ(done.exit_code, 0) << done.err;
  return contents_of(folder / name);
}

// Expects that all frames which both have are equal, and returns their number. `live`: images of a
// session whose camera has a fixed rate, numbered from its first pose in `poses`. `replayed`:
// contents_of() the images of the replay.
inline int expect_frames_of_live(const std::filesystem::path& live,
                                 const std::filesystem::path& poses,
                                 const std::filesystem::path& recording,
                                 const std::map<std::string, std::string>& replayed) {
  const auto seen = contents_of(live);
  const auto listed = list_frames(recording);
  const auto trajectory = load_trajectory(poses);
  if (!listed || !trajectory || trajectory->poses.empty()) {
    ADD_FAILURE() << "no frames or no poses";
    return 0;
  }
  // Dropped frames leave larger intervals.
  std::int64_t interval_ns = std::numeric_limits<std::int64_t>::max();
  for (std::size_t i = 1; i < listed->size(); ++i) {
    interval_ns = std::min(interval_ns, (*listed)[i].timestamp_ns - (*listed)[i - 1].timestamp_ns);
  }
  int compared = 0;
  for (std::size_t i = 0; i < listed->size(); ++i) {
    const auto age_ns =
        static_cast<double>((*listed)[i].timestamp_ns - trajectory->poses.front().timestamp_ns);
    const auto number = std::lround(age_ns / static_cast<double>(interval_ns));
    const auto image = seen.find(fmt::format("{:06}.png", number));
    if (image == seen.end()) continue;
    EXPECT_EQ(image->second, replayed.at(fmt::format("{:06}.png", i))) << i;
    ++compared;
  }
  return compared;
}

}  // namespace penumbra::test
