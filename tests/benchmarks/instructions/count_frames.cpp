// Draws frames for callgrind to count: count_frames TRIANGLES still|moving|cut|over-box|over-ball
// FRAMES TECHNIQUE:TRANSLUCENCY..., 1280 x 720, video as YUYV, a torus of so many triangles over
// the table; over-box and over-ball: moving over a phantom, which its shadow climbs. Of each
// technique counted from the fourth frame on, when programs are compiled and what stays as it is
// has been made; dumped under its name. Prints how many draw calls the last frame of each had.
// scripts/count-instructions runs it.
#include <valgrind/callgrind.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>

#include "core/text/text.hpp"
#include "counted_scene.hpp"

namespace penumbra {
namespace {

using counted::kWarmFrames;

struct Row {
  std::string name;
  counted::TechniqueChoice choice;
  Translucency translucency = Translucency::blend;
};
std::optional<Row> row_of(const std::string& name) {
  const std::size_t colon = name.find(':');
  if (colon == std::string::npos) return std::nullopt;
  const auto choice = counted::technique_of(name.substr(0, colon));
  const auto translucency = translucency_from_string(name.substr(colon + 1));
  if (!choice || !translucency) return std::nullopt;
  return Row{name, *choice, *translucency};
}

void count(test::Studio& studio, int triangles, counted::Motion motion, int frames,
           const Row& row) {
  const Scene& scene = studio.scene();
  const PoseEstimate pose = counted::pose();
  PlanOptions options;
  options.technique = row.choice.technique;
  options.layers = row.choice.layers;
  options.translucency = row.translucency;
  SceneState state = evaluate_scene(scene, 0.0);
  const auto video = triangles == 12 ? counted::Video::checkerboard : counted::Video::gradients;
  // In turn, so that each is uploaded.
  const std::array<Frame, 2> frames_of_video = {counted::video(video), counted::video(video)};
  std::int64_t calls = 0;
  for (int i = 0; i < kWarmFrames + frames; ++i) {
    if (i == kWarmFrames) {
      CALLGRIND_START_INSTRUMENTATION;
    }
    if (motion != counted::Motion::still)
      counted::move_on(state, i, motion, scene.shadows[0].layered.umbra_height);
    const Frame& frame = frames_of_video[static_cast<std::size_t>(i % 2)];
    const FramePlan plan = plan_frame(scene, state, pose, studio.camera(), options);
    calls = studio.compositor().draw(frame, plan).value()[Counter::draw_calls];
  }
  CALLGRIND_STOP_INSTRUMENTATION;
  CALLGRIND_DUMP_STATS_AT(row.name.c_str());
  std::printf("%s %lld\n", row.name.c_str(), static_cast<long long>(calls));
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  const auto misused = [] {
    std::fprintf(stderr,
                 "count_frames TRIANGLES still|moving|cut|over-box|over-ball FRAMES "
                 "TECHNIQUE:TRANSLUCENCY...\n");
    return 2;
  };
  if (argc < 5) return misused();
  // No value is none of the numbers asked for.
  const auto triangles = static_cast<int>(parse_integer(argv[1]).value_or(0));
  const std::string named = argv[2];
  using counted::Motion;
  using counted::Receiver;
  struct Kind {
    std::string_view name;
    Motion motion;
    Receiver receiver;
  };
  constexpr std::array kKinds = {
      Kind{"still", Motion::still, Receiver::none}, Kind{"moving", Motion::moving, Receiver::none},
      Kind{"cut", Motion::cut, Receiver::none}, Kind{"over-box", Motion::moving, Receiver::box},
      Kind{"over-ball", Motion::moving, Receiver::ball}};
  const auto kind = std::ranges::find(kKinds, std::string_view(argv[2]), &Kind::name);
  const auto frames = static_cast<int>(parse_integer(argv[3]).value_or(0));
  if ((triangles != 12 && triangles < 32) || frames < 1 || kind == kKinds.end()) return misused();
  counted::use_one_thread_of_software_gl();
  const auto scene = std::make_shared<const Scene>(counted::scene_of(
      counted::body(triangles), make_layered_constants(0.7, 2.5, 0.0).value(), kind->receiver));
  test::Studio studio(scene, counted::camera());
  for (int i = 4; i < argc; ++i) {
    const auto row = row_of(argv[i]);
    if (!row) return misused();
    count(studio, triangles, kind->motion, frames, *row);
  }
  return 0;
}
