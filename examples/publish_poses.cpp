// Tracks frames from standard input and writes one JSON line per frame, for another program to
// read:
//   ffmpeg -i video.mp4 -f rawvideo -pix_fmt gray - | publish_poses camera.yaml tags.yaml 30
// The frames are raw grey pixels of the camera's size. 30: frames per second.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <penumbra/tracking.hpp>
#include <vector>

namespace tracking = penumbra::tracking;

// Prints a pose as "NAME": [tx, ty, tz, qx, qy, qz, qw].
void print_pose(const char* name, const tracking::Pose& pose) {
  const auto& [t, q] = pose;
  std::printf(R"(,"%s":[%.9g,%.9g,%.9g,%.9g,%.9g,%.9g,%.9g])", name, t[0], t[1], t[2], q[0], q[1],
              q[2], q[3]);
}

int main(int argc, char** argv) try {
  const double rate = argc == 4 ? std::atof(argv[3]) : 0.0;
  if (!(rate >= 1.0)) {
    std::fprintf(stderr, "usage: publish_poses camera.yaml tags.yaml FRAMES_PER_SECOND\n");
    return 2;
  }
  const auto camera = tracking::CameraModel::load(argv[1]);
  const auto parameters = camera.parameters();
  // Another thread searches for lost tags, so that no frame waits for the search.
  tracking::Tracker tracker(camera, tracking::TagMap::load(argv[2]),
                            {.search = tracking::Search::when_done});

  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(parameters.width) *
                                   static_cast<std::size_t>(parameters.height));
  for (int i = 0; std::fread(pixels.data(), 1, pixels.size(), stdin) == pixels.size(); ++i) {
    const auto time_ns = static_cast<std::int64_t>(1e9 * i / rate);
    const auto frame = tracker.track(
        {pixels.data(), parameters.width, parameters.height, parameters.width}, time_ns);
    const auto& table = frame.table;
    std::printf(R"({"time_s":%.6f,"state":"%s","predicted_px":%.3g)",
                1e-9 * static_cast<double>(time_ns), tracking::to_string(table.state).c_str(),
                table.predicted_overlay_px);
    if (table.has_pose()) print_pose("T_table_camera", table.T_table_camera);
    for (const auto& group : frame.groups) {
      if (group.has_pose()) print_pose(group.name.c_str(), group.T_table_group);
    }
    std::printf("}\n");
    std::fflush(stdout);
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "publish_poses: %s\n", error.what());
  return 1;
}
