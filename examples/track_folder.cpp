// Tracks the tags in a folder of images and prints the camera's poses as a TUM file:
//   track_folder RECORDING > poses.tum
// RECORDING holds camera.yaml, tags.yaml and frames/, as in docs/files.md. The frames are taken to
// be 1/30 s apart.
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <penumbra/tracking.hpp>
#include <vector>

namespace fs = std::filesystem;
namespace tracking = penumbra::tracking;

int main(int argc, char** argv) try {
  if (argc != 2) {
    std::fprintf(stderr, "usage: track_folder RECORDING\n");
    return 2;
  }
  const fs::path recording = argv[1];
  const auto camera = tracking::CameraModel::load(recording / "camera.yaml");
  const auto tags = tracking::TagMap::load(recording / "tags.yaml");
  tracking::Tracker tracker(camera, tags);

  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(recording / "frames")) files.push_back(entry);
  std::sort(files.begin(), files.end());

  constexpr std::int64_t kInterval_ns = 33'333'333;
  std::int64_t time_ns = 0;
  for (const fs::path& file : files) {
    const auto image = tracking::Image::load(file);
    // Pixels of a camera: {pointer, width, height, stride, tracking::PixelFormat::yuyv}; of an
    // OpenCV image in grey: {mat.data, mat.cols, mat.rows, static_cast<std::ptrdiff_t>(mat.step)}.
    const tracking::TrackedFrame frame = tracker.track(image.view(), time_ns);
    if (frame.table.state == tracking::State::tracked) {
      const auto& [t, q] = frame.table.T_table_camera;
      std::printf("%.9f %.17g %.17g %.17g %.17g %.17g %.17g %.17g\n",
                  1e-9 * static_cast<double>(time_ns), t[0], t[1], t[2], q[0], q[1], q[2], q[3]);
    } else {
      std::fprintf(stderr, "%s: %s: %s\n", file.c_str(),
                   tracking::to_string(frame.table.state).c_str(), frame.table.reason.c_str());
    }
    time_ns += kInterval_ns;
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "track_folder: %s\n", error.what());
  return 1;
}
