#include "app/recording/recording_writer.hpp"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <csignal>
#include <cstring>
#include <new>
#include <optional>
#include <random>
#include <thread>

#include "app/recording/recording_source.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 66;
constexpr int kHeight = 34;

CapturedImage jpeg_image(int number) {
  const auto file =
      test::recordings_dir() / "tabletop" / "frames" / fmt::format("{:06}.jpg", number % 100);
  auto bytes = std::make_shared<const std::vector<std::uint8_t>>(read_file(file).value());
  CapturedImage image;
  image.sequence = static_cast<std::uint64_t>(number);
  image.timestamp_ns = 7'000'000'000'123 + number * std::int64_t{33'333'333};
  image.jpeg = *bytes;
  image.owner = bytes;
  return image;
}

// Each sample differs from its neighbours and from the same sample of the next frame.
CapturedImage raw_image(PixelFormat format, int number) {
  FrameBuffer buffer = allocate_frame(format, kWidth, kHeight);
  std::minstd_rand random(static_cast<unsigned>(number + 1));
  for (std::size_t i = 0; i < static_cast<std::size_t>(buffer.frame.plane_count); ++i) {
    const PixelPlane& plane = buffer.frame.planes[i];
    for (std::ptrdiff_t k = 0; k < plane.stride * plane.height; ++k) {
      buffer.plane_data[i][k] = static_cast<std::uint8_t>(random() >> 8U);
    }
  }
  CapturedImage image;
  image.frame = buffer.frame;
  image.frame.color_range = ColorRange::limited;
  image.frame.color_matrix = ColorMatrix::bt709;
  image.sequence = static_cast<std::uint64_t>(number);
  image.timestamp_ns = image.frame.timestamp_ns = 5'000'000'000 + number * std::int64_t{40'000'001};
  image.owner = image.frame.owner;
  return image;
}

RecordingHead head_for(const char* format, int width, int height) {
  const auto folder = test::recordings_dir() / "tabletop";
  RecordingHead head;
  head.camera = "a camera";
  head.format = {format, width, height, 1.0 / 30.0};
  head.controls = {{"Gain", 7}};
  head.camera_yaml = read_text_file(folder / "camera.yaml", 100'000).value();
  if (width != 640) {
    const std::string old = "image_width: 640\nimage_height: 480\n";
    const std::size_t at = head.camera_yaml.find(old);
    if (at != std::string::npos) {
      head.camera_yaml.replace(at, old.size(),
                               fmt::format("image_width: {}\nimage_height: {}\n", width, height));
    }
  }
  head.tags_yaml = read_text_file(folder / "tags.yaml", 100'000).value();
  return head;
}

OpenRecordingOptions no_camera() {
  OpenRecordingOptions options;
  options.require_camera = false;
  return options;
}

TEST(RecordingWriter, StoresCameraBytesAndTimestampsUnchanged) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  auto writer = RecordingWriter::create(folder, head_for("MJPEG", 640, 480));
  ASSERT_TRUE(writer) << writer.error().message;
  for (int i = 0; i < 20; ++i) (*writer)->add_image(jpeg_image(i));
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  (*writer)->add_pose(jpeg_image(3).timestamp_ns, pose);
  pose.status = TrackStatus::uncertain;
  (*writer)->add_pose(jpeg_image(4).timestamp_ns, pose);
  (*writer)->add_event(1'500'000'000, "gap", "two \"frames\"");
  ASSERT_TRUE((*writer)->finish());
  EXPECT_EQ((*writer)->counts().written, 20U);

  const auto recording = open_recording(folder);
  ASSERT_TRUE(recording) << recording.error().message;
  EXPECT_TRUE(recording->notices.empty());
  ASSERT_EQ(recording->frames.size(), 20U);
  for (int i = 0; i < 20; ++i) {
    const CapturedImage image = jpeg_image(i);
    const RecordedFrame& frame = recording->frames[static_cast<std::size_t>(i)];
    EXPECT_EQ(frame.timestamp_ns, image.timestamp_ns);
    const auto bytes = read_file(frame.file).value();
    EXPECT_TRUE(std::equal(bytes.begin(), bytes.end(), image.jpeg.begin(), image.jpeg.end())) << i;
  }
  const auto poses = load_trajectory(folder / "poses.tum");
  ASSERT_TRUE(poses) << poses.error().message;
  ASSERT_EQ(poses->poses.size(), 1U);
  EXPECT_EQ(poses->poses[0].timestamp_ns, jpeg_image(3).timestamp_ns);
  EXPECT_EQ(read_text_file(folder / "events.jsonl", 1000).value(),
            "{\"timestamp_s\":1.500000000,\"event\":\"gap\",\"detail\":\"two \\\"frames\\\"\"}\n");
  const std::string controls = read_text_file(folder / "controls.json", 10'000).value();
  EXPECT_NE(controls.find("\"Gain\": 7"), std::string::npos) << controls;
  EXPECT_NE(controls.find("\"frames_written\": 20"), std::string::npos) << controls;
}

// The frame list stores exposures. A group's pose file begins with its first tracked pose.
TEST(RecordingWriter, StoresExposuresAndGroupPoses) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  auto writer = RecordingWriter::create(folder, head_for("MJPEG", 640, 480));
  ASSERT_TRUE(writer) << writer.error().message;
  GroupEstimate group;
  group.name = "the prop";
  group.T_table_group = {Eigen::Quaterniond::Identity(), Eigen::Vector3d(0.25, 0.0, 0.5)};
  for (int i = 0; i < 4; ++i) {
    CapturedImage image = jpeg_image(i);
    if (i != 1) image.exposure_s = 0.008 + 0.001 * i;
    (*writer)->add_image(image);
    group.status = i < 2 ? TrackStatus::held : TrackStatus::tracked;
    (*writer)->add_group(image.timestamp_ns, group);
  }
  ASSERT_TRUE((*writer)->finish());
  const auto recording = open_recording(folder);
  ASSERT_TRUE(recording) << recording.error().message;
  ASSERT_EQ(recording->frames.size(), 4U);
  for (int i = 0; i < 4; ++i) {
    const auto& exposure_s = recording->frames[static_cast<std::size_t>(i)].exposure_s;
    ASSERT_EQ(exposure_s.has_value(), i != 1);
    if (exposure_s) {
      EXPECT_NEAR(*exposure_s, 0.008 + 0.001 * i, 1e-12);
    }
  }
  EXPECT_TRUE(recording->group_groundtruth.empty()) << "a tracked pose is not ground truth";
  const auto paths = load_group_paths(folder / kGroupPosesFolder, {"the prop", "another"});
  ASSERT_TRUE(paths) << paths.error().message;
  ASSERT_EQ(paths->size(), 1U);
  const Trajectory& path = paths->at("the prop");
  ASSERT_EQ(path.poses.size(), 2U);
  EXPECT_EQ(path.poses[0].timestamp_ns, jpeg_image(2).timestamp_ns);
  EXPECT_EQ(path.poses[0].T_table_camera.translation(), Eigen::Vector3d(0.25, 0.0, 0.5));
}

TEST(RecordingWriter, WarnsOnceOfGroupNameUnusableAsFileName) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  testing::internal::CaptureStdout();  // the log's default destination
  auto writer = RecordingWriter::create(folder, head_for("MJPEG", 640, 480));
  ASSERT_TRUE(writer) << writer.error().message;
  GroupEstimate group;
  group.status = TrackStatus::tracked;
  for (int i = 0; i < 3; ++i) {
    const CapturedImage image = jpeg_image(i);
    (*writer)->add_image(image);
    for (const char* name : {"../wall", "wall"}) {
      group.name = name;
      (*writer)->add_group(image.timestamp_ns, group);
    }
  }
  const auto finished = (*writer)->finish();
  const std::string reported = testing::internal::GetCapturedStdout();
  ASSERT_TRUE(finished);
  const auto first = reported.find("group '../wall': its name cannot be the name of a file");
  EXPECT_NE(first, std::string::npos) << reported;
  EXPECT_EQ(reported.find("cannot be the name of a file", first + 60), std::string::npos)
      << reported;
  EXPECT_FALSE(fs::exists(folder / "wall.tum"));
  const auto paths = load_group_paths(folder / kGroupPosesFolder, {"../wall", "wall"});
  ASSERT_TRUE(paths) << paths.error().message;
  EXPECT_EQ(paths->count("../wall"), 0U);
  EXPECT_EQ(paths->at("wall").poses.size(), 3U);
}

TEST(RecordingWriter, StoresWallClockTimesThatGoBack) {
  const std::array<std::optional<std::int64_t>, 4> times = {1'790'000'000'000'000'001, std::nullopt,
                                                            -5, 1'790'000'000'000'000'001};
  for (const bool with_exposure : {false, true}) {
    const test::TemporaryFolder temporary;
    const fs::path folder = temporary.path() / "session";
    auto writer = RecordingWriter::create(folder, head_for("MJPEG", 640, 480));
    ASSERT_TRUE(writer) << writer.error().message;
    for (std::size_t i = 0; i < times.size(); ++i) {
      CapturedImage image = jpeg_image(static_cast<int>(i));
      image.utc_ns = times[i];
      if (with_exposure) image.exposure_s = 0.0125;
      (*writer)->add_image(image);
    }
    ASSERT_TRUE((*writer)->finish());
    const std::string listing = read_text_file(folder / "timestamps.csv", 1000).value();
    EXPECT_TRUE(listing.starts_with(with_exposure
                                        ? "frame,timestamp_s,file,exposure_s,wall_time_ns\n"
                                        : "frame,timestamp_s,file,wall_time_ns\n"))
        << listing;
    const auto recording = open_recording(folder);
    ASSERT_TRUE(recording) << recording.error().message;
    EXPECT_TRUE(recording->notices.empty());
    ASSERT_EQ(recording->frames.size(), times.size());
    for (std::size_t i = 0; i < times.size(); ++i) {
      EXPECT_EQ(recording->frames[i].utc_ns, times[i]) << i;
      EXPECT_EQ(recording->frames[i].timestamp_ns, jpeg_image(static_cast<int>(i)).timestamp_ns);
      EXPECT_EQ(recording->frames[i].exposure_s.has_value(), with_exposure);
    }
  }
}

// The frame list has its header even without a frame; without exposures it has no exposure column.
TEST(RecordingWriter, WritesFrameListHeaderWithAndWithoutFrames) {
  for (const bool with_image : {false, true}) {
    const test::TemporaryFolder temporary;
    const fs::path folder = temporary.path() / "session";
    auto writer = RecordingWriter::create(folder, head_for("MJPEG", 640, 480));
    ASSERT_TRUE(writer) << writer.error().message;
    if (with_image) (*writer)->add_image(jpeg_image(0));
    ASSERT_TRUE((*writer)->finish());
    const std::string listing = read_text_file(folder / "timestamps.csv", 1000).value();
    EXPECT_TRUE(listing.starts_with("frame,timestamp_s,file\n")) << listing;
    EXPECT_FALSE(fs::exists(folder / kGroupPosesFolder));
  }
}

class RawRecording : public testing::TestWithParam<PixelFormat> {};

TEST_P(RawRecording, RoundTripsEverySample) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  auto writer = RecordingWriter::create(folder, head_for("raw", kWidth, kHeight));
  ASSERT_TRUE(writer) << writer.error().message;
  constexpr int kWritten = 5;
  for (int i = 0; i < kWritten; ++i) (*writer)->add_image(raw_image(GetParam(), i));
  ASSERT_TRUE((*writer)->finish());

  fs::remove(folder / "camera.yaml");
  const auto recording = open_recording(folder, no_camera());
  ASSERT_TRUE(recording) << recording.error().message;
  ASSERT_EQ(recording->frames.size(), static_cast<std::size_t>(kWritten));
  const auto source = open_recording_source(*recording);
  ASSERT_TRUE(source);
  for (int i = 0; i < kWritten; ++i) {
    const Frame sent = raw_image(GetParam(), i).frame;
    const auto read = (*source)->next();
    ASSERT_TRUE(read) << read.error().message;
    const Frame& frame = read->value();
    EXPECT_EQ(frame.timestamp_ns, sent.timestamp_ns);
    EXPECT_EQ(frame.color_range, sent.color_range);
    EXPECT_EQ(frame.color_matrix, sent.color_matrix);
    std::vector<std::uint8_t> scratch_sent, scratch_read;
    const ImageView a = luma(sent, scratch_sent);
    const ImageView b = luma(frame, scratch_read);
    for (int y = 0; y < kHeight; ++y) ASSERT_EQ(std::memcmp(a.row(y), b.row(y), kWidth), 0) << y;
    if (sent.plane_count == 1 && sent.format != PixelFormat::yuyv) continue;
    // U and V at each chroma position, in the layout of either format.
    const int rows = frame.planes[1].height;
    for (int y = 0; y < rows; ++y) {
      for (int x = 0; x < (kWidth + 1) / 2; ++x) {
        const auto at = [&](std::size_t plane, std::ptrdiff_t k) {
          return sent.planes[plane].data[y * sent.planes[plane].stride + k];
        };
        int u = 0;
        int v = 0;
        if (sent.format == PixelFormat::yuyv) {
          u = at(0, 4 * x + 1);
          v = at(0, 4 * x + 3);
        } else if (sent.format == PixelFormat::nv12) {
          u = at(1, 2 * x);
          v = at(1, 2 * x + 1);
        } else {
          u = at(1, x);
          v = at(2, x);
        }
        ASSERT_EQ(frame.planes[1].data[y * frame.planes[1].stride + x], u);
        ASSERT_EQ(frame.planes[2].data[y * frame.planes[2].stride + x], v);
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    Formats, RawRecording,
    testing::Values(PixelFormat::grey8, PixelFormat::yuyv, PixelFormat::nv12, PixelFormat::yuv420p),
    [](const auto& test) {
      return std::vector<std::string>({"Grey8", "Yuyv", "Nv12", "Yuv420p"}).at(test.index);
    });

TEST(RecordingWriter, RejectsNonEmptyFolder) {
  const test::TemporaryFolder temporary;
  ASSERT_TRUE(write_text_file(temporary.path() / "thesis.txt", "words"));
  const auto writer = RecordingWriter::create(temporary.path(), head_for("MJPEG", 640, 480));
  ASSERT_FALSE(writer);
  EXPECT_NE(writer.error().message.find("not empty"), std::string::npos);
}

// Limits the size of files that this process writes, while it exists.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) : handler_(std::signal(SIGXFSZ, SIG_IGN)) {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limited{bytes, before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limited);
  }
  FileSizeLimit(const FileSizeLimit&) = delete;
  FileSizeLimit& operator=(const FileSizeLimit&) = delete;
  ~FileSizeLimit() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  void (*handler_)(int);
};

// A failed start leaves no folder, so that the name can be used again once there is space.
TEST(RecordingWriter, RemovesFolderWhenCreationFails) {
  const RecordingHead head = head_for("MJPEG", 640, 480);
  for (const bool waits : {true, false}) {
    SCOPED_TRACE(waits);
    const test::TemporaryFolder temporary;
    const fs::path folder = temporary.path() / "of" / "today" / "session";
    {
      const FileSizeLimit limit(64);  // smaller than tags.yaml
      if (waits) {
        EXPECT_FALSE(RecordingWriter::create(folder, head));
      } else {
        const auto writer = RecordingWriter::begin(folder, head);
        writer->add_image(jpeg_image(0));
        EXPECT_FALSE(writer->finish());
        EXPECT_TRUE(writer->counts().error);
      }
    }
    EXPECT_TRUE(fs::is_empty(temporary.path()));
    auto again = RecordingWriter::begin(folder, head);
    again->add_image(jpeg_image(0));
    ASSERT_TRUE(again->finish());
    EXPECT_TRUE(open_recording(folder));
  }
}

// Files that the writer did not create are kept.
TEST(RecordingWriter, KeepsForeignFilesOfRejectedFolder) {
  const test::TemporaryFolder temporary;
  ASSERT_TRUE(write_text_file(temporary.path() / "camera.yaml", "mine"));
  auto writer = RecordingWriter::begin(temporary.path(), head_for("MJPEG", 640, 480));
  const auto finished = writer->finish();
  ASSERT_FALSE(finished);
  EXPECT_NE(finished.error().message.find("not empty"), std::string::npos);
  EXPECT_EQ(read_text_file(temporary.path() / "camera.yaml", 100).value(), "mine");
  EXPECT_EQ(std::distance(fs::directory_iterator(temporary.path()), fs::directory_iterator()), 1);
}

// Some cameras report their controls only after the first frames.
TEST(RecordingWriter, RereadsControlsDuringRecording) {
  const test::TemporaryFolder temporary;
  const fs::path folder = temporary.path() / "session";
  RecordingHead head = head_for("MJPEG", 640, 480);
  head.controls.clear();
  std::atomic<int> exposure = 0;
  head.read_controls = [&] {
    std::vector<std::pair<std::string, std::int64_t>> controls;
    if (exposure > 0) controls.emplace_back("exposure_time_us", exposure.load());
    return controls;
  };
  auto writer = RecordingWriter::create(folder, head);
  ASSERT_TRUE(writer) << writer.error().message;
  const auto controls = [&] { return read_text_file(folder / "controls.json", 10'000).value(); };
  EXPECT_EQ(controls().find("exposure"), std::string::npos);
  exposure = 8000;
  (*writer)->add_image(jpeg_image(0));
  while ((*writer)->counts().written < 1) std::this_thread::yield();
  (*writer)->add_event(1, "behind it");
  // Waits until the count is on disk. A kill at this moment would leave the same files.
  while (controls().find("\"frames_written\": 1") == std::string::npos) std::this_thread::yield();
  EXPECT_NE(controls().find("\"exposure_time_us\": 8000"), std::string::npos) << controls();
  exposure = 9000;
  (*writer)->add_image(jpeg_image(1));
  ASSERT_TRUE((*writer)->finish());
  EXPECT_NE(controls().find("\"exposure_time_us\": 9000"), std::string::npos) << controls();
  EXPECT_NE(controls().find("\"frames_written\": 2"), std::string::npos) << controls();
}

TEST(RecordingWriter, DropsAndCountsFramesWhenDiskIsTooSlow) {
  const test::TemporaryFolder temporary;
  auto writer =
      RecordingWriter::create(temporary.path() / "session", head_for("raw", kWidth, kHeight));
  ASSERT_TRUE(writer) << writer.error().message;
  constexpr int kWritten = 3000;
  const CapturedImage image = raw_image(PixelFormat::yuyv, 0);
  for (int i = 0; i < kWritten; ++i) {
    CapturedImage next = image;
    next.timestamp_ns += i;
    (*writer)->add_image(next);
  }
  ASSERT_TRUE((*writer)->finish());
  const RecordingCounts counts = (*writer)->counts();
  EXPECT_EQ(counts.written + counts.dropped, static_cast<std::uint64_t>(kWritten));
  EXPECT_GT(counts.dropped, 0U);
  // Each event has the time and the number of frames that were not recorded.
  const std::string events =
      read_text_file(temporary.path() / "session" / "events.jsonl", 1'000'000).value();
  std::uint64_t reported = 0;
  for (std::size_t at = 0; (at = events.find("\"left_out\"", at)) != std::string::npos; ++at) {
    constexpr std::string_view kDetail = "\"detail\":\"";
    reported += std::stoull(events.substr(events.find(kDetail, at) + kDetail.size()));
  }
  EXPECT_EQ(reported, counts.dropped) << events;
}

// After a kill at any moment, the files must contain every frame that the process reported as
// written.
class KilledRecording : public testing::TestWithParam<bool> {};

TEST_P(KilledRecording, OpensAndReadsBack) {
  const bool raw = GetParam();
  const int kills = test::nightly() ? 40 : 15;
  using Counter = std::atomic<std::uint64_t>;
  void* memory =
      mmap(nullptr, sizeof(Counter), PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(memory, MAP_FAILED);
  auto& written = *new (memory) Counter(0);
  std::minstd_rand random(20);
  for (int kill_number = 0; kill_number < kills; ++kill_number) {
    const test::TemporaryFolder temporary;
    const fs::path folder = temporary.path() / "session";
    written = 0;
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      auto writer = RecordingWriter::create(
          folder, raw ? head_for("raw", kWidth, kHeight) : head_for("MJPEG", 640, 480));
      if (!writer) _exit(1);
      for (int i = 0;; ++i) {
        (*writer)->add_image(raw ? raw_image(PixelFormat::yuyv, i) : jpeg_image(i));
        written = (*writer)->counts().written;
      }
    }
    while (written < 2 && waitpid(child, nullptr, WNOHANG) == 0) std::this_thread::yield();
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 30'000));
    ASSERT_EQ(kill(child, SIGKILL), 0);
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status));

    fs::remove(folder / "camera.yaml");
    const auto recording = open_recording(folder, no_camera());
    ASSERT_TRUE(recording) << "kill " << kill_number << ": " << recording.error().message;
    EXPECT_GE(recording->frames.size(), written.load()) << "kill " << kill_number;
    const auto source = open_recording_source(*recording);
    ASSERT_TRUE(source) << source.error().message;
    for (std::size_t i = 0; i < recording->frames.size(); ++i) {
      const auto frame = (*source)->next();
      ASSERT_TRUE(frame) << "kill " << kill_number << ": " << frame.error().message;
      ASSERT_TRUE(frame->has_value());
    }
  }
  munmap(memory, sizeof(Counter));
}

INSTANTIATE_TEST_SUITE_P(Formats, KilledRecording, testing::Bool(), [](const auto& test) {
  return test.param ? std::string("Raw") : std::string("Jpeg");
});

}  // namespace
}  // namespace penumbra
