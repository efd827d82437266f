// Draws frames for callgrind to count: 1280 x 720, YUYV video.
//
//   count_frames FRAMES TRIANGLES:MOTION:TECHNIQUE:TRANSLUCENCY[:EDGES]...
//
// EDGES: hard (default) | smooth, as the program draws them without a GPU.
// MOTION: still | moving | cut (moves through the umbra height) | over-box | over-ball (moves over
// a phantom that receives the shadow). The caster is a torus of TRIANGLES triangles, or a box
// for 12. Counting starts at the fourth frame, when programs are compiled and caches are filled.
// Each argument after FRAMES is a row of the table. Its count is dumped under the argument's text.
// Prints the number of draw calls in the final frame of each row. scripts/count-instructions runs
// this program.
#include <valgrind/callgrind.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include "core/text/text.hpp"
#include "counted_scene.hpp"

namespace penumbra {
namespace {

using counted::kWarmFrames;

struct Body {
  int triangles = 0;
  counted::Motion motion = counted::Motion::still;
  counted::Receiver receiver = counted::Receiver::none;
};
struct Row {
  std::string name;
  Body body;
  counted::TechniqueChoice choice;
  Translucency translucency = Translucency::blend;
  bool smooth = false;
};

std::optional<Body> body_of(std::string_view triangles, std::string_view motion) {
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
  const auto count = static_cast<int>(parse_integer(triangles).value_or(0));
  const auto kind = std::ranges::find(kKinds, motion, &Kind::name);
  if ((count != 12 && count < 32) || kind == kKinds.end()) return std::nullopt;
  return Body{count, kind->motion, kind->receiver};
}

std::optional<Row> row_of(const std::string& name) {
  std::vector<std::string> parts;
  std::istringstream fields(name);
  for (std::string part; std::getline(fields, part, ':');) parts.push_back(part);
  if (parts.size() == 4) parts.emplace_back("hard");
  if (parts.size() != 5 || (parts[4] != "hard" && parts[4] != "smooth")) return std::nullopt;
  const auto body = body_of(parts[0], parts[1]);
  const auto choice = counted::technique_of(parts[2]);
  const auto translucency = value_named(kTranslucencyNames, parts[3]);
  if (!body || !choice || !translucency) return std::nullopt;
  return Row{name, *body, *choice, *translucency, parts[4] == "smooth"};
}

// Draws a row's warm-up frames and then `frames` counted frames. Returns the number of draw calls
// in the last frame.
std::int64_t draw_row(test::Studio& studio, const Row& row, int frames) {
  const auto [triangles, motion, receiver] = row.body;
  studio.context().make_current();
  const Scene& scene = studio.scene();
  const PoseEstimate pose = counted::pose();
  PlanOptions options;
  options.technique = row.choice.technique;
  options.layers = row.choice.layers;
  options.translucency = row.translucency;
  SceneState state = evaluate_scene(scene, 0.0);
  const auto video = triangles == 12 ? counted::Video::checkerboard : counted::Video::gradients;
  // Two frames alternate, so that each is uploaded.
  const std::array<Frame, 2> frames_of_video = {counted::video(video), counted::video(video)};
  std::int64_t calls = 0;
  for (int i = 0; i < kWarmFrames + frames; ++i) {
    if (i == kWarmFrames) CALLGRIND_ZERO_STATS;
    if (motion != counted::Motion::still)
      counted::move_on(state, i, motion, scene.shadows[0].layered.umbra_height);
    const Frame& frame = frames_of_video[static_cast<std::size_t>(i % 2)];
    const FramePlan plan = plan_frame(scene, state, pose, studio.camera(), options);
    calls = studio.compositor().draw(frame, plan).value()[Counter::draw_calls];
  }
  if (frames > 0) CALLGRIND_DUMP_STATS_AT(row.name.c_str());
  return calls;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  const auto misused = [] {
    std::fprintf(stderr,
                 "count_frames FRAMES TRIANGLES:MOTION:TECHNIQUE:TRANSLUCENCY[:EDGES]...\n");
    return 2;
  };
  const auto frames = argc < 3 ? 0 : static_cast<int>(parse_integer(argv[1]).value_or(0));
  if (frames < 1) return misused();
  counted::use_one_thread_of_software_gl();
  std::vector<Row> rows;
  // Triangles, receiver, smooth edges, light: motions share a studio.
  using Drawn = std::tuple<int, counted::Receiver, bool, bool>;
  const auto is_lit = [](const Row& row) {
    return row.choice.technique == ShadowTechnique::hard ||
           row.choice.technique == ShadowTechnique::volume;
  };
  const auto drawn_by = [&is_lit](const Row& row) {
    return Drawn(row.body.triangles, row.body.receiver, row.smooth, is_lit(row));
  };
  std::map<Drawn, test::Studio> studios;
  for (int i = 2; i < argc; ++i) {
    const auto row = row_of(argv[i]);
    if (!row) return misused();
    rows.push_back(*row);
    const Drawn drawn = drawn_by(*row);
    if (studios.contains(drawn)) continue;
    CompositorOptions options;
    if (!row->smooth) options.msaa = 0;
    Scene scene =
        counted::scene_of(counted::body(row->body.triangles),
                          make_layered_constants(0.7, 2.5, 0.0).value(), row->body.receiver);
    if (is_lit(*row)) {
      SceneLight lamp;
      lamp.position = {-0.25, -0.1, 0.7};
      lamp.intensity = 0.85;
      scene.lights.push_back(lamp);
    }
    studios.try_emplace(drawn, std::make_shared<const Scene>(std::move(scene)), counted::camera(),
                        GlApi::gl33, options);
  }
  // Compiles all shaders before instrumentation starts. Instrumentation starts only once, because
  // callgrind translates all code again at each start.
  const auto studio_of = [&](const Row& row) -> test::Studio& { return studios.at(drawn_by(row)); };
  for (const Row& row : rows) draw_row(studio_of(row), row, 0);
  CALLGRIND_START_INSTRUMENTATION;
  for (const Row& row : rows) {
    std::printf("%s %lld\n", row.name.c_str(),
                static_cast<long long>(draw_row(studio_of(row), row, frames)));
  }
  CALLGRIND_STOP_INSTRUMENTATION;
  return 0;
}
