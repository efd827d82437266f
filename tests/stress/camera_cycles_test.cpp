// Opening and closing a camera repeatedly must not leak descriptors, threads or memory. The camera
// is the bundled recording, or $PENUMBRA_CAMERA ("v4l2:/dev/video0") with its calibration in
// $PENUMBRA_CAMERA_CALIBRATION. $PENUMBRA_CAMERA_CYCLES sets the number of cycles.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <malloc.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "app/live/live_camera.hpp"
#include "core/camera/camera_file.hpp"
#include "support/paths.hpp"
#include "support/test_form.hpp"

namespace penumbra {
namespace {

std::string from_environment(const char* name, const std::string& otherwise) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : otherwise;
}

struct Resources {
  std::ptrdiff_t descriptors = 0, threads = 0;
  long resident_kib = 0;
};

Resources used_resources() {
  const auto entries = [](const char* folder) {
    return std::distance(std::filesystem::directory_iterator(folder), {});
  };
  malloc_trim(0);
  Resources now{entries("/proc/self/fd"), entries("/proc/self/task"), 0};
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("VmRSS:")) now.resident_kib = std::stol(line.substr(6));
  }
  return now;
}

// Reads the first row, which crashes if its memory was released.
unsigned sum_of(const Frame& frame) {
  unsigned sum = 0;
  for (int i = 0; i < frame.planes[0].width; ++i) sum += frame.planes[0].data[i];
  return sum;
}

TEST(CameraCycles, LeakNoDescriptorThreadOrMemory) {
  CameraRequest request;
  const std::string board = (test::recordings_dir() / "tabletop").string();
  request.source = from_environment("PENUMBRA_CAMERA", "recording:" + board);
  const auto camera =
      load_camera(from_environment("PENUMBRA_CAMERA_CALIBRATION", board + "/camera.yaml"));
  ASSERT_TRUE(camera) << camera.error().message;
  const int cycles = std::stoi(from_environment("PENUMBRA_CAMERA_CYCLES", "40"));
  const auto cycle = [&] {
    auto source = open_live_source(request, &*camera);
    ASSERT_TRUE(source) << source.error().message;
    // The frame is destroyed after its camera, which may also happen to a window's frame.
    auto frame = (*source)->next();
    ASSERT_TRUE(frame && *frame);
    (*source)->stop();
    source->reset();
    EXPECT_NE(sum_of(**frame), 0U);
  };
  // Libraries initialise themselves in the first cycles, which are not measured.
  for (int i = 0; i < std::max(4, cycles / 10); ++i) cycle();
  const Resources before = used_resources();
  for (int i = 0; i < cycles && !testing::Test::HasFailure(); ++i) cycle();
  const Resources after = used_resources();
  EXPECT_EQ(after.descriptors, before.descriptors);
  EXPECT_EQ(after.threads, before.threads);
  constexpr long kMaxGrowth_kib = 1024;
  // The address sanitizer finds leaks itself, and keeps memory that was freed.
  if (!test::kSanitized) {
    EXPECT_LE(after.resident_kib - before.resident_kib, kMaxGrowth_kib);
  }
  fmt::print("{} cycles of {}: {} KiB more, {} descriptors, {} threads\n", cycles, request.source,
             after.resident_kib - before.resident_kib, after.descriptors, after.threads);
}

}  // namespace
}  // namespace penumbra
