#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <array>
#include <limits>
#include <set>
#include <tuple>
#include <utility>

#include "recorded_frames.hpp"
#include "support/run_program.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

using Numbers = std::array<double, 8>;  // of a TUM line

// Returns the lines of a TUM file, without comments.
std::vector<Numbers> numbers_in(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::vector<Numbers> lines;
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with('#')) continue;
    Numbers& numbers = lines.emplace_back();
    const char* at = line.c_str();
    char* end = nullptr;
    for (double& number : numbers) {
      number = std::strtod(at, &end);
      at = end;
    }
  }
  return lines;
}

Numbers numbers_of(std::int64_t timestamp_ns, const tracking::Pose& pose) {
  const auto& [t, q] = pose;
  return {1e-9 * static_cast<double>(timestamp_ns), t[0], t[1], t[2], q[0], q[1], q[2], q[3]};
}

struct ReplayCase {
  const char* recording;
  const char* tracking;  // value of --tracking
  tracking::Mode mode;
  int frames;
};
class LibraryTrackerReplay : public testing::TestWithParam<ReplayCase> {};
INSTANTIATE_TEST_SUITE_P(
    Recordings, LibraryTrackerReplay,
    testing::Values(ReplayCase{"tabletop", "auto", tracking::Mode::automatic, 20},
                    ReplayCase{"tabletop", "fast", tracking::Mode::fast, 6},
                    ReplayCase{"tabletop", "accurate", tracking::Mode::accurate, 6},
                    ReplayCase{"tabletop", "detect", tracking::Mode::detect, 6},
                    ReplayCase{"corner", "auto", tracking::Mode::automatic, 8}),
    [](const auto& instance) {
      return std::string(instance.param.recording) + "_" + instance.param.tracking;
    });

TEST_P(LibraryTrackerReplay, PosesEqualThoseOfReplayBitForBit) {
  const ReplayCase& given = GetParam();
  const TemporaryFolder folder;
  const std::filesystem::path poses = folder.path() / "poses.tum";
  const ProgramResult replay =
      run_program(program(), {"replay", (recordings_dir() / given.recording).string(), "--frames",
                              "0:" + std::to_string(given.frames), "--no-window", "--tracking",
                              given.tracking, "--poses", poses.string()});
  ASSERT_EQ(replay.exit_code, 0) << replay.err;
  const std::vector<Numbers> expected = numbers_in(poses);
  ASSERT_GE(expected.size(), 5U);

  tracking::Tracker tracker(camera_of(given.recording), tags_of(given.recording),
                            {.mode = given.mode});
  std::vector<Numbers> found;
  for (const auto& [timestamp_ns, image] :
       recorded_images(given.recording, static_cast<std::size_t>(given.frames))) {
    const tracking::TrackedFrame frame = tracker.track(image.view(), timestamp_ns);
    if (frame.table.state == tracking::State::tracked) {
      found.push_back(numbers_of(timestamp_ns, frame.table.T_table_camera));
    }
  }
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_NEAR(found[i][0], expected[i][0], 1e-9);  // the time, in decimal seconds
    for (std::size_t k = 1; k < found[i].size(); ++k) EXPECT_EQ(found[i][k], expected[i][k]);
  }
}

// A wrong focal length makes the same frames uncertain as in replay, and is named once.
TEST(LibraryTracker, FindsWrongLensAsReplayDoes) {
  constexpr int kFrames = 60;
  const TemporaryFolder folder;
  const std::filesystem::path file = folder.path() / "wrong.yaml";
  const std::filesystem::path poses = folder.path() / "poses.tum";
  types::CameraParameters parameters = camera_of("tabletop").parameters();
  parameters.fx *= 1.01;
  parameters.fy *= 1.01;
  types::CameraModel(parameters).save(file);
  const ProgramResult replay =
      run_program(program(), {"replay", (recordings_dir() / "tabletop").string(), "--frames",
                              "0:" + std::to_string(kFrames), "--no-window", "--calibration",
                              file.string(), "--poses", poses.string()});
  ASSERT_EQ(replay.exit_code, 0) << replay.err;

  tracking::Tracker tracker(types::CameraModel::load(file), tags_of("tabletop"));
  std::vector<Numbers> found;
  std::vector<std::string> notices;
  int uncertain = 0;
  for (const auto& [timestamp_ns, image] : recorded_images("tabletop", kFrames)) {
    const tracking::TrackedFrame frame = tracker.track(image.view(), timestamp_ns);
    notices.insert(notices.end(), frame.notices.begin(), frame.notices.end());
    if (frame.table.state == tracking::State::tracked)
      found.push_back(numbers_of(timestamp_ns, frame.table.T_table_camera));
    uncertain += frame.table.state == tracking::State::uncertain ? 1 : 0;
  }
  EXPECT_GT(uncertain, 20);
  ASSERT_FALSE(notices.empty());
  for (const std::string& notice : notices) EXPECT_THAT(replay.err, HasSubstr(notice));
  EXPECT_EQ(std::set<std::string>(notices.begin(), notices.end()).size(), notices.size());
  const std::vector<Numbers> expected = numbers_in(poses);
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    for (std::size_t k = 1; k < found[i].size(); ++k) EXPECT_EQ(found[i][k], expected[i][k]);
  }
}

// A map with a displaced tag is noticed; a right one in its place ends that.
TEST(LibraryTracker, ForgetsWrongMapIfAnotherIsSet) {
  const tracking::TagMap right = tags_of("tabletop");
  std::vector<tracking::Tag> tags = right.tags();
  for (std::size_t i = 0; i < tags.size(); ++i)
    tags[i].T_table_tag.position[2] += i % 2 == 0 ? 0.002 : -0.002;
  tracking::Tracker tracker(camera_of("tabletop"), tracking::TagMap(tags));
  int noticed = 0;
  int frames = 0;
  for (const auto& [timestamp_ns, image] : recorded_images("tabletop", 100)) {
    const tracking::TrackedFrame frame = tracker.track(image.view(), timestamp_ns);
    ++frames;
    noticed += static_cast<int>(frame.notices.size());
    if (frames == 50) {
      EXPECT_GT(noticed, 0);
      noticed = 0;
      tracker.set_tag_map(right);
    }
    if (frames > 55) {
      EXPECT_EQ(frame.table.state, tracking::State::tracked) << frames;
    }
  }
  EXPECT_EQ(noticed, 0);
}

// A recording's first frame as luma without padding.
struct Luma {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> pixels;
};
Luma first_luma() {
  const types::Image image = recorded_images("tabletop", 1).front().image;
  const types::ImageView view = image.view();
  Luma luma{view.width, view.height, {}};
  for (int y = 0; y < view.height; ++y) {
    const std::uint8_t* row = view.data + y * view.stride;
    luma.pixels.insert(luma.pixels.end(), row, row + view.width);
  }
  return luma;
}

tracking::TrackedFrame track_once(const types::ImageView& view) {
  tracking::Tracker tracker(camera_of("tabletop"), tags_of("tabletop"));
  return tracker.track(view, 0);
}

TEST(LibraryTracker, GivesSamePoseForEveryPixelFormatAndStride) {
  const Luma luma = first_luma();
  const tracking::TrackedFrame expected =
      track_once({luma.pixels.data(), luma.width, luma.height, luma.width});
  ASSERT_EQ(expected.table.state, tracking::State::tracked);
  struct Format {
    types::PixelFormat format;
    std::size_t bytes;  // per pixel, in plane 0
  };
  for (const auto& [format, bytes] :
       {Format{types::PixelFormat::grey8, 1}, Format{types::PixelFormat::rgb24, 3},
        Format{types::PixelFormat::yuyv, 2}, Format{types::PixelFormat::nv12, 1},
        Format{types::PixelFormat::yuv420p, 1}, Format{types::PixelFormat::yuv422p, 1},
        Format{types::PixelFormat::yuv444p, 1}}) {
    const std::size_t stride = bytes * static_cast<std::size_t>(luma.width) + 13;
    std::vector<std::uint8_t> packed(stride * static_cast<std::size_t>(luma.height), 77);
    for (std::size_t y = 0; y < static_cast<std::size_t>(luma.height); ++y) {
      for (std::size_t x = 0; x < static_cast<std::size_t>(luma.width); ++x) {
        const std::uint8_t value = luma.pixels[y * static_cast<std::size_t>(luma.width) + x];
        std::uint8_t* pixel = packed.data() + y * stride + x * bytes;
        pixel[0] = value;
        if (format == types::PixelFormat::rgb24) pixel[1] = pixel[2] = value;
      }
    }
    const tracking::TrackedFrame frame = track_once(
        {packed.data(), luma.width, luma.height, static_cast<std::ptrdiff_t>(stride), format});
    EXPECT_EQ(numbers_of(0, frame.table.T_table_camera),
              numbers_of(0, expected.table.T_table_camera))
        << static_cast<int>(format);
    EXPECT_EQ(frame.table.covariance, expected.table.covariance);
  }
}

TEST(LibraryTracker, ReportsUncertaintyAndTags) {
  const types::Image image = recorded_images("tabletop", 1).front().image;
  const tracking::TrackedFrame frame = track_once(image.view());
  EXPECT_EQ(frame.table.reason, "");
  EXPECT_GE(frame.table.tags_used, 4);
  EXPECT_GT(frame.table.predicted_overlay_px, 0.0);
  EXPECT_LT(frame.table.predicted_overlay_px, 2.0);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_GT(frame.table.covariance[7 * i], 0.0);
    for (std::size_t k = 0; k < 6; ++k)
      EXPECT_EQ(frame.table.covariance[6 * i + k], frame.table.covariance[6 * k + i]);
  }
}

TEST(LibraryTracker, ReportsWhyThePoseIsLost) {
  const Luma luma = first_luma();
  const std::vector<std::uint8_t> black(luma.pixels.size(), 0);
  const tracking::TrackedFrame frame =
      track_once({black.data(), luma.width, luma.height, luma.width});
  EXPECT_EQ(frame.table.state, tracking::State::lost);
  EXPECT_NE(frame.table.reason, "");
  EXPECT_EQ(frame.table.tags_used, 0);
}

TEST(LibraryTracker, TracksGroupsInOrderOfTheMap) {
  std::vector<tracking::Tag> tags = tags_of("corner").tags();
  for (tracking::Tag& tag : tags) {
    if (tag.id >= 30) tag.group = "wall";
  }
  tracking::Tracker tracker(camera_of("corner"), tracking::TagMap(tags));
  const auto images = recorded_images("corner", 3);
  tracking::TrackedFrame frame;
  for (const auto& [timestamp_ns, image] : images)
    frame = tracker.track(image.view(), timestamp_ns);
  ASSERT_EQ(frame.groups.size(), 1U);
  EXPECT_EQ(frame.groups.front().name, "wall");
  ASSERT_TRUE(frame.groups.front().has_pose());
  // The wall is where the map has it, so the group frame is the table frame.
  for (const double t : frame.groups.front().T_table_group.position) EXPECT_NEAR(t, 0.0, 2e-3);

  tracking::Tracker table_only(camera_of("corner"), tracking::TagMap(tags),
                               {.groups = std::vector<std::string>()});
  EXPECT_TRUE(table_only.track(images.front().image.view(), 0).groups.empty());
  EXPECT_THAT(message_of([&] {
                tracking::Tracker(camera_of("corner"), tracking::TagMap(tags),
                                  {.groups = std::vector<std::string>{"wal"}});
              }),
              HasSubstr("'wal'"));
}

TEST(LibraryTracker, IgnoresFramesThatItRejects) {
  const auto images = recorded_images("tabletop", 3);
  tracking::Tracker undisturbed(camera_of("tabletop"), tags_of("tabletop"));
  tracking::Tracker tracker(camera_of("tabletop"), tags_of("tabletop"));
  const types::ImageView good = images[0].image.view();
  const auto rejected = [&](const types::ImageView& view, std::int64_t time_ns,
                            std::optional<double> exposure_s = std::nullopt) {
    return message_of([&] { std::ignore = tracker.track(view, time_ns, exposure_s); });
  };
  const auto with = [&](auto member, auto value) {
    types::ImageView view = good;
    view.*member = value;
    return view;
  };
  for (const auto& [timestamp_ns, image] : images) {
    const auto expected = undisturbed.track(image.view(), timestamp_ns);
    const auto frame = tracker.track(image.view(), timestamp_ns);
    EXPECT_EQ(numbers_of(0, frame.table.T_table_camera),
              numbers_of(0, expected.table.T_table_camera));
    const std::int64_t next_ns = timestamp_ns + 1;
    EXPECT_THAT(rejected({}, next_ns), HasSubstr("data: is null"));
    EXPECT_THAT(rejected(with(&types::ImageView::data, nullptr), next_ns), HasSubstr("null"));
    EXPECT_THAT(rejected(with(&types::ImageView::width, 0), next_ns), HasSubstr("width"));
    EXPECT_THAT(rejected(with(&types::ImageView::width, -5), next_ns), HasSubstr("width"));
    EXPECT_THAT(rejected(with(&types::ImageView::height, std::numeric_limits<int>::max()), next_ns),
                HasSubstr("height"));
    EXPECT_THAT(rejected(with(&types::ImageView::stride, good.width - 1), next_ns),
                HasSubstr("stride"));
    EXPECT_THAT(rejected(with(&types::ImageView::stride, -good.width), next_ns),
                HasSubstr("stride"));
    EXPECT_THAT(rejected(with(&types::ImageView::format, types::PixelFormat{99}), next_ns),
                HasSubstr("format"));
    EXPECT_THAT(rejected(with(&types::ImageView::height, good.height - 2), next_ns),
                HasSubstr("camera model"));
    EXPECT_THAT(rejected(good, timestamp_ns), HasSubstr("is not after"));
    EXPECT_THAT(rejected(good, timestamp_ns - 1), HasSubstr("is not after"));
    EXPECT_THAT(rejected(good, std::numeric_limits<std::int64_t>::max()), HasSubstr("range"));
    EXPECT_THAT(rejected(good, std::numeric_limits<std::int64_t>::min()), HasSubstr("range"));
    EXPECT_THAT(rejected(good, next_ns, 0.0), HasSubstr("exposure"));
    EXPECT_THAT(rejected(good, next_ns, kNan), HasSubstr("exposure"));
  }
}

TEST(LibraryTracker, RejectsOptionsOutOfRange) {
  const auto message = [](const tracking::Options& options) {
    return message_of(
        [&] { tracking::Tracker(camera_of("tabletop"), tags_of("tabletop"), options); });
  };
  EXPECT_EQ(message({}), "");
  for (const double bad : {-1.0, kNan, kInfinity}) {
    EXPECT_THAT(message({.pose_budget_px = bad}), HasSubstr("pose_budget_px"));
    EXPECT_THAT(message({.hold_s = bad}), HasSubstr("hold_s"));
  }
  EXPECT_THAT(message({.mode = tracking::Mode{9}}), HasSubstr("mode"));
  EXPECT_THAT(message({.search = tracking::Search{9}}), HasSubstr("search"));
}

TEST(LibraryTagMap, RejectsInvalidTags) {
  const tracking::Tag good{.id = 1, .size_m = 0.04};
  const auto message = [](const std::vector<tracking::Tag>& tags) {
    return message_of([&] { tracking::TagMap map(tags); });
  };
  EXPECT_EQ(message({good}), "");
  EXPECT_THAT(message({}), HasSubstr("empty"));
  EXPECT_THAT(message({good, good}), HasSubstr("twice"));
  for (const double bad : {0.0, -1.0, kNan, kInfinity}) {
    tracking::Tag tag = good;
    tag.size_m = bad;
    EXPECT_THAT(message({tag}), HasSubstr("size_m"));
    tag = good;
    tag.T_table_tag.quaternion_xyzw = {0.0, 0.0, 0.0, bad};
    EXPECT_EQ(message({tag}).empty(), bad == -1.0) << bad;  // -1: the identity
    tag = good;
    tag.curvature[1] = bad;
    EXPECT_EQ(message({tag}).empty(), bad == 0.0 || bad == -1.0) << bad;
  }
  tracking::Tag tag = good;
  tag.T_table_tag.position[2] = kNan;
  EXPECT_THAT(message({tag}), HasSubstr("position"));
  tag = good;
  tag.family = "tag36h12";
  EXPECT_THAT(message({tag}), HasSubstr("not known"));
  tag = good;
  tag.group = "wall";
  EXPECT_THAT(
      message_of([&] { tracking::Tracker(camera_of("tabletop"), tracking::TagMap({tag})); }),
      HasSubstr("'table'"));
}

TEST(LibraryTagMap, RoundTripsThroughItsFile) {
  const TemporaryFolder folder;
  const tracking::TagMap map = tags_of("corner");
  map.save(folder.path() / "tags.yaml");
  const auto expected = map.tags();
  const auto found = tracking::TagMap::load(folder.path() / "tags.yaml").tags();
  ASSERT_EQ(found.size(), expected.size());
  for (std::size_t i = 0; i < found.size(); ++i) {
    EXPECT_EQ(found[i].id, expected[i].id);
    EXPECT_EQ(found[i].family, expected[i].family);
    EXPECT_EQ(found[i].size_m, expected[i].size_m);
    EXPECT_EQ(found[i].T_table_tag.position, expected[i].T_table_tag.position);
    EXPECT_EQ(found[i].group, expected[i].group);
  }
  EXPECT_THAT(
      message_of([&] { std::ignore = tracking::TagMap::load(folder.path() / "missing.yaml"); }),
      HasSubstr("missing.yaml"));
}

// Any view either is rejected or gives a state, and never reads outside the pixels that its stride
// and size describe (the sanitizer presets check that).
RC_GTEST_PROP(LibraryTracker, AcceptsOrRejectsAnyView, ()) {
  const auto format = static_cast<types::PixelFormat>(*rc::gen::inRange(-1, 8));
  const int width = *rc::gen::inRange(-2, 70);
  const int height = *rc::gen::inRange(-2, 70);
  const int stride = *rc::gen::inRange(-10, 300);
  const auto last_ns = *rc::gen::arbitrary<std::int64_t>();
  types::CameraParameters parameters;
  parameters.width = std::max(width, 1);
  parameters.height = std::max(height, 1);
  parameters.fx = parameters.fy = 60.0;
  parameters.cx = 0.5 * parameters.width;
  parameters.cy = 0.5 * parameters.height;
  tracking::Tracker tracker(types::CameraModel(parameters), tags_of("tabletop"));
  const auto bytes =
      static_cast<std::size_t>(std::max(stride, 1)) * static_cast<std::size_t>(std::max(height, 1));
  const auto seed = *rc::gen::arbitrary<std::uint8_t>();
  std::vector<std::uint8_t> pixels(bytes);
  for (std::size_t i = 0; i < bytes; ++i)
    pixels[i] = static_cast<std::uint8_t>(seed * i + (i >> 4U));
  for (const std::int64_t time_ns : {std::int64_t{0}, std::int64_t{1}, last_ns}) {
    try {
      const tracking::TrackedFrame frame =
          tracker.track({pixels.data(), width, height, stride, format}, time_ns);
      RC_ASSERT(frame.timestamp_ns == time_ns);
      RC_ASSERT(frame.table.has_pose() || !frame.table.reason.empty());
    } catch (const Exception& error) {
      RC_ASSERT(std::string(error.what()).find('\n') == std::string::npos);
    }
  }
}

// The refined map of the same tags is tracked; maps of other tags or groups are refused.
TEST(LibraryTracker, TakesOnlyMapsOfTheSameTags) {
  tracking::Tracker tracker(camera_of("tabletop"), tags_of("tabletop"));
  std::vector<tracking::Tag> tags = tags_of("tabletop").tags();
  const auto images = recorded_images("tabletop", 2);
  ASSERT_EQ(tracker.track(images[0].image.view(), images[0].timestamp_ns).table.state,
            tracking::State::tracked);
  const auto set = [&](const std::vector<tracking::Tag>& with) {
    tracker.set_tag_map(tracking::TagMap(with));
  };
  auto fewer = tags;
  fewer.pop_back();
  EXPECT_THROW(set(fewer), Exception);
  auto elsewhere = tags;
  for (tracking::Tag& tag : elsewhere) tag.group = "prop";
  EXPECT_THROW(set(elsewhere), Exception);
  auto others = tags;
  others.back().id = 500;
  EXPECT_THROW(set(others), Exception);
  for (tracking::Tag& tag : tags) tag.T_table_tag.position[0] += 0.1;  // another origin
  set(tags);
  const auto moved = tracker.track(images[1].image.view(), images[1].timestamp_ns);
  ASSERT_EQ(moved.table.state, tracking::State::tracked);
  tracking::Tracker fresh(camera_of("tabletop"), tags_of("tabletop"));
  const auto before = fresh.track(images[1].image.view(), images[1].timestamp_ns);
  EXPECT_NEAR(moved.table.T_table_camera.position[0] - before.table.T_table_camera.position[0], 0.1,
              2e-3);
}

TEST(LibraryTracker, ThrowsAfterItWasMovedFrom) {
  tracking::Tracker tracker(camera_of("tabletop"), tags_of("tabletop"));
  tracking::Tracker other(std::move(tracker));
  const auto image = recorded_images("tabletop", 1).front().image;
  EXPECT_THROW((void)tracker.track(image.view(), 0), Exception);  // NOLINT(bugprone-use-after-move)
  EXPECT_THROW(tracker.set_tag_map(tags_of("tabletop")), Exception);
  EXPECT_EQ(other.track(image.view(), 0).table.state, tracking::State::tracked);
}

TEST(LibraryTracker, RefusesStridesFarBeyondTheImage) {
  const Luma luma = first_luma();
  for (const std::ptrdiff_t stride :
       {std::ptrdiff_t{1} << 30U, std::numeric_limits<std::ptrdiff_t>::max()}) {
    EXPECT_THROW((void)track_once({luma.pixels.data(), luma.width, luma.height, stride}),
                 Exception);
  }
}

}  // namespace
}  // namespace penumbra::test
