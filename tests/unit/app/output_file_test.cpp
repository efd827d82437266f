#include "app/output/output_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <fstream>
#include <future>
#include <iterator>

#include "app/output/pose_writer.hpp"
#include "core/geometry/trajectory.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

std::string text_of(const fs::path& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
}

TEST(OutputFile, AppearsWhenComplete) {
  const test::TemporaryFolder folder;
  const fs::path target = folder.path() / "a.json";
  auto file = OutputFile::create(target);
  ASSERT_TRUE(file);
  EXPECT_FALSE(fs::exists(target));
  ASSERT_TRUE(write_text(*file, "{}\n"));
  EXPECT_EQ(text_of(target), "{}\n");
  EXPECT_FALSE(fs::exists(file->partial()));
}

TEST(OutputFile, LeavesNoFileWhenDestroyedUncommitted) {
  const test::TemporaryFolder folder;
  {
    auto file = OutputFile::create(folder.path() / "a.json");
    ASSERT_TRUE(file);
    OutputFile moved = std::move(*file);
    EXPECT_TRUE(fs::exists(moved.partial()));
  }
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(OutputFile, ReportsFailuresWithRequestedName) {
  const test::TemporaryFolder folder;
  fs::create_symlink(folder.path() / "real", folder.path() / "link");
  auto file = OutputFile::create(folder.path() / "link");
  ASSERT_TRUE(file);
  const std::string partial = file->partial().string();
  ASSERT_THAT(partial, testing::HasSubstr("real"));
  const std::string requested = (folder.path() / "link").string();
  EXPECT_EQ(file->failed({partial + ": is full; free some of " + partial}).value().message,
            requested + ": is full; free some of " + requested);
  EXPECT_EQ(file->failed({"no path"}).value().message, "no path");
  EXPECT_EQ(renamed({"a.partial-1-0/frames/3.png: no"}, "a.partial-1-0", "a").message,
            "a/frames/3.png: no");
}

TEST(OutputFile, CommitsSeveralFilesAtomically) {
  const test::TemporaryFolder folder;
  const fs::path replaced = folder.path() / "replaced";
  const fs::path created = folder.path() / "made";
  const fs::path last = folder.path() / "last";
  std::ofstream(replaced) << "before";
  const auto commit_all = [&](bool succeeds) {
    auto a = OutputFile::create(replaced);
    auto b = OutputFile::create(created);
    auto c = OutputFile::create(last);
    EXPECT_TRUE(a && b && c);
    for (OutputFile* file : {&*a, &*b, &*c}) EXPECT_TRUE(write_whole(*file, "after"));
    if (!succeeds) fs::create_directories(last / "in the way");
    return commit_together(std::array{&*a, &*b, &*c});
  };
  const auto failed = commit_all(false);
  ASSERT_FALSE(failed);
  EXPECT_THAT(failed.error().message, testing::StartsWith(last.string() + ": cannot be"));
  EXPECT_EQ(text_of(replaced), "before");
  EXPECT_FALSE(fs::exists(created));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 2) << "a .part file is left";
  fs::remove_all(last);
  ASSERT_TRUE(commit_all(true));
  for (const fs::path& file : {replaced, created, last}) EXPECT_EQ(text_of(file), "after");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 3) << "a .part file is left";
}

TEST(OutputFile, UsesDistinctPartialFilesForSameTarget) {
  const test::TemporaryFolder folder;
  auto first = OutputFile::create(folder.path() / "a.json");
  auto second = OutputFile::create(folder.path() / "a.json");
  ASSERT_TRUE(first && second);
  EXPECT_NE(first->partial(), second->partial());
  ASSERT_TRUE(write_text(*first, "one"));
  EXPECT_EQ(text_of(folder.path() / "a.json"), "one");
  ASSERT_TRUE(write_text(*second, "other"));
  EXPECT_EQ(text_of(folder.path() / "a.json"), "other");
}

TEST(OutputFile, WritesThroughSymlink) {
  const test::TemporaryFolder folder;
  fs::create_directory(folder.path() / "real");
  std::ofstream(folder.path() / "real" / "a") << "old";
  fs::create_symlink(folder.path() / "real" / "a", folder.path() / "link");
  auto file = OutputFile::create(folder.path() / "link");
  ASSERT_TRUE(file);
  ASSERT_TRUE(write_text(*file, "new"));
  EXPECT_TRUE(fs::is_symlink(folder.path() / "link"));
  EXPECT_EQ(text_of(folder.path() / "real" / "a"), "new");
}

TEST(OutputFile, WritesDeviceDirectly) {
  auto file = OutputFile::create("/dev/null");
  ASSERT_TRUE(file) << file.error().message;
  EXPECT_TRUE(write_text(*file, "text"));
  EXPECT_TRUE(fs::is_character_file("/dev/null"));
}

TEST(OutputFile, FailsWhenDiskIsFull) {
  auto file = OutputFile::create("/dev/full");
  ASSERT_TRUE(file) << file.error().message;
  const auto written = write_text(*file, "text");
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message,
              testing::StartsWith("/dev/full: cannot be written: No space"));
  EXPECT_FALSE(PoseWriter::create("/dev/full", false));
}

// Creates a named pipe and returns what its reader receives while `write` runs.
template <class Write>
std::string read_through_pipe(const fs::path& pipe, const Write& write) {
  EXPECT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  auto reader = std::async(std::launch::async, [&] { return text_of(pipe); });
  write();
  return reader.get();
}

TEST(OutputFile, WritesToNamedPipe) {
  const test::TemporaryFolder folder;
  const fs::path pipe = folder.path() / "pipe";
  const std::string long_text(1'000'000, 'x');  // more than a pipe's buffer holds
  const std::string text = read_through_pipe(pipe, [&] {
    auto file = OutputFile::create(pipe);
    ASSERT_TRUE(file) << file.error().message;
    EXPECT_TRUE(file->append("first "));
    EXPECT_TRUE(write_text(*file, long_text));
  });
  EXPECT_EQ(text, "first " + long_text);
  EXPECT_TRUE(fs::is_fifo(pipe)) << "the pipe was replaced by a file";
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path()), {}), 1) << "a .part file is left";
}

TEST(OutputFile, OpensPipeWithoutWaitingForReader) {
  const test::TemporaryFolder folder;
  ASSERT_EQ(mkfifo((folder.path() / "pipe").c_str(), 0600), 0);
  // create() does not wait for a reader, so a reader may open several pipes one after the other.
  EXPECT_TRUE(OutputFile::create(folder.path() / "pipe"));
  EXPECT_TRUE(OutputFile::create(folder.path() / "pipe"));
}

TEST(PoseWriter, StreamsPosesToPipe) {
  const test::TemporaryFolder folder;
  const fs::path pipe = folder.path() / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const int reader = open(pipe.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  ASSERT_GE(reader, 0);
  auto writer = PoseWriter::create(pipe, false);
  ASSERT_TRUE(writer) << writer.error().message;
  std::array<char, 4096> block{};
  EXPECT_GT(read(reader, block.data(), block.size()), 0) << "the header must arrive first";
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  ASSERT_TRUE(writer->write(1'000'000'000, pose));
  EXPECT_GT(read(reader, block.data(), block.size()), 0)
      << "poses must arrive before the writer finishes";
  // The reader closes its end.
  close(reader);
  const auto before = std::signal(SIGPIPE, SIG_IGN);
  const auto written = writer->write(2'000'000'000, pose);
  std::signal(SIGPIPE, before);
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, testing::HasSubstr("Broken pipe"));
}

// The output continues at the descriptor's current position and does not replace the file.
TEST(OutputFile, WritesToOpenDescriptor) {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "log";
  std::ofstream(path) << "before ";
  const int descriptor = open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC);
  ASSERT_GE(descriptor, 0);
  const fs::path name = "/dev/fd/" + std::to_string(descriptor);
  EXPECT_TRUE(is_stream(name));
  {
    auto file = OutputFile::create(name);
    ASSERT_TRUE(file) << file.error().message;
    EXPECT_TRUE(write_text(*file, "after"));
  }
  EXPECT_EQ(write(descriptor, " open", 5), 5) << "the descriptor was closed";
  close(descriptor);
  EXPECT_EQ(text_of(path), "before after open");
  EXPECT_FALSE(OutputFile::create("/dev/fd/876")) << "the descriptor is not open";
}

TEST(OutputFile, RecognisesStreamPaths) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "file") << "";
  for (const char* stream : {"-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"}) {
    EXPECT_TRUE(is_stream(stream)) << stream;
    EXPECT_TRUE(names_standard_output(stream)) << stream;
  }
  EXPECT_TRUE(is_stream("/dev/null"));
  EXPECT_FALSE(names_standard_output("/dev/null"));
  EXPECT_FALSE(names_standard_output("/dev/stderr"));
  for (const fs::path& file : {folder.path() / "file", folder.path() / "1", folder.path(),
                               fs::path("1"), fs::path("./-"), fs::path()}) {
    EXPECT_FALSE(is_stream(file)) << file;
  }
}

PoseEstimate pose_of(TrackStatus status) {
  PoseEstimate pose;
  pose.status = status;
  pose.T_table_camera = CameraPose(Eigen::Quaterniond(0.5, 0.5, -0.5, 0.5), {0.1, -0.2, 0.7});
  if (status != TrackStatus::tracked) pose.reason = {PoseCause::two_poses};
  return pose;
}

void write_every_state(const fs::path& file, bool all) {
  auto writer = PoseWriter::create(file, all);
  ASSERT_TRUE(writer);
  ASSERT_TRUE(writer->write(1'000'000'001, pose_of(TrackStatus::tracked)));
  ASSERT_TRUE(writer->write(1'033'000'000, pose_of(TrackStatus::uncertain)));
  ASSERT_TRUE(writer->write(1'066'000'000, pose_of(TrackStatus::held)));
  ASSERT_TRUE(writer->write(1'100'000'000, pose_of(TrackStatus::lost)));
  ASSERT_TRUE(writer->finish());
}

TEST(PoseWriter, WritesTrackedPosesOnly) {
  const test::TemporaryFolder folder;
  write_every_state(folder.path() / "a.tum", false);
  const auto read = load_trajectory(folder.path() / "a.tum");
  ASSERT_TRUE(read) << read.error().message;
  ASSERT_EQ(read->poses.size(), 1U);
  EXPECT_EQ(read->poses[0].timestamp_ns, 1'000'000'001);
  EXPECT_EQ(read->poses[0].T_table_camera.translation(), Eigen::Vector3d(0.1, -0.2, 0.7));
}

TEST(PoseWriter, WritesAllPosesWithCommentsWhenRequested) {
  const test::TemporaryFolder folder;
  write_every_state(folder.path() / "a.tum", true);
  const auto read = load_trajectory(folder.path() / "a.tum");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read->poses.size(), 3U);
  EXPECT_THAT(text_of(folder.path() / "a.tum"),
              testing::AllOf(testing::HasSubstr("# uncertain: two poses fit\n1.033000000 "),
                             testing::HasSubstr("# held: two poses fit\n1.066000000 ")));
}

}  // namespace
}  // namespace penumbra
