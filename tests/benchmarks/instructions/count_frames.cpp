// Draws frames for callgrind to count: count_frames TRIANGLES TECHNIQUE TRANSLUCENCY still|moving
// FRAMES, 1280 x 720, video as YUYV, a torus of so many triangles over the table. Counted from the
// fourth frame on, when programs are compiled and what stays as it is has been made. Prints how
// many passes the last frame had. scripts/count-instructions runs it.
#include <valgrind/callgrind.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "core/text.hpp"
#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

constexpr int kWidth = 1280;
constexpr int kHeight = 720;
constexpr int kWarmFrames = 3;

// By twos along the tube and around it.
std::shared_ptr<const Model> torus(int triangles) {
  int around = 4;
  while (2 * around * around * 2 < triangles) ++around;
  test::ShapeBuilder shape;
  shape.torus(0.05, 0.018, around, triangles / (2 * around));
  return test::finished(shape.build(), {0.7F, 0.3F, 0.15F, 1.0F});
}

Frame video() {
  FrameBuffer buffer = allocate_frame(PixelFormat::yuyv, kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    std::uint8_t* row = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    for (int x = 0; x < 2 * kWidth; x += 2) {
      row[x] = static_cast<std::uint8_t>(100 + (x / 7 + y / 5) % 120);
      row[x + 1] = static_cast<std::uint8_t>(118 + (x / 40 + y / 60) % 20);
    }
  }
  return buffer.frame;
}

int count(int triangles, ShadowTechnique technique, LayerDrawing layers, Translucency translucency,
          bool moving, int frames) {
  setenv("LP_NUM_THREADS", "0", 1);  // all work on this thread
  setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
  test::SceneBuilder builder;
  builder.add(torus(triangles), test::at(0.0, 0.0, 0.1, {1, 0.2, 0}, 0.4));
  builder.scene().shadows[0].layered = make_layered_constants(0.7, 2.5, 0.0).value();
  Scene scene = builder.scene();
  scene.objects[0].proxy = ProxyMode::none;
  const auto shared = std::make_shared<const Scene>(scene);
  test::Studio studio(shared, test::camera_of(kWidth, kHeight, 1000.0));
  const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.45, 0.4}, {0.0, 0.0, 0.03}));
  PlanOptions options;
  options.technique = technique;
  options.layers = layers;
  options.translucency = translucency;
  SceneState state = evaluate_scene(*shared, 0.0);
  // In turn, so that each is uploaded.
  const std::array<Frame, 2> frames_of_video = {video(), video()};
  std::int64_t passes = 0;
  for (int i = 0; i < kWarmFrames + frames; ++i) {
    if (i == kWarmFrames) {
      CALLGRIND_START_INSTRUMENTATION;
    }
    // Turned about the vertical and lifted: its shadow has another shape in each frame.
    if (moving) {
      state.objects[0].position.z() = 0.1 + 0.0007 * i;
      state.objects[0].position.x() = 0.0005 * i;
    }
    const Frame& frame = frames_of_video[static_cast<std::size_t>(i % 2)];
    const FramePlan plan = plan_frame(*shared, state, pose, studio.camera(), options);
    passes = studio.compositor().draw(frame, plan).value().passes_drawn;
  }
  CALLGRIND_STOP_INSTRUMENTATION;
  std::printf("%lld\n", static_cast<long long>(passes));
  return 0;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  const auto misused = [] {
    std::fprintf(stderr, "count_frames TRIANGLES TECHNIQUE TRANSLUCENCY still|moving FRAMES\n");
    return 2;
  };
  if (argc != 6) return misused();
  // layered-direct and layered-mask are layers drawn in this way, whatever pays.
  std::string name = argv[2];
  LayerDrawing layers = LayerDrawing::automatic;
  for (const auto& [suffix, way] : {std::pair{std::string("-direct"), LayerDrawing::direct},
                                    {std::string("-mask"), LayerDrawing::mask}}) {
    if (!name.ends_with(suffix)) continue;
    layers = way;
    name.resize(name.size() - suffix.size());
  }
  const auto technique = shadow_technique_from_string(name);
  const auto translucency = translucency_from_string(argv[3]);
  const std::string motion = argv[4];
  // No value is none of the numbers asked for.
  const auto triangles = static_cast<int>(parse_integer(argv[1]).value_or(0));
  const auto frames = static_cast<int>(parse_integer(argv[5]).value_or(0));
  if (triangles < 32 || !technique || !translucency || frames < 1 ||
      (motion != "still" && motion != "moving")) {
    return misused();
  }
  return count(triangles, *technique, layers, *translucency, motion == "moving", frames);
}
