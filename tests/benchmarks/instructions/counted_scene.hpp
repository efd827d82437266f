// Scene of the counting programs: one object over the table, 1280 x 720, YUYV video.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <string_view>

#include "support/shapes.hpp"
#include "support/studio.hpp"
#include "support/studio_models.hpp"

namespace penumbra::counted {

inline constexpr int kWidth = 1280;
inline constexpr int kHeight = 720;
inline constexpr int kWarmFrames = 3;  // enough to compile programs and fill caches
inline constexpr double kObjectHeight =
    0.1;  // height of the object's centre in the first frame [m]
inline constexpr double kRisePerFrame = 0.0007;  // [m]

inline void use_one_thread_of_software_gl() {
  setenv("LP_NUM_THREADS", "0", 1);  // rasterise on this thread
  setenv("LIBGL_ALWAYS_SOFTWARE", "1", 1);
}

// A torus with twice as many segments along its ring as around its tube.
inline std::shared_ptr<const Model> torus(int triangles) {
  int around = 4;
  while (2 * around * around * 2 < triangles) ++around;
  test::ShapeBuilder shape;
  shape.torus(0.05, 0.018, around, triangles / (2 * around));
  return test::finished(shape.build(), {0.7F, 0.3F, 0.15F, 1.0F});
}
inline std::shared_ptr<const Model> sphere(int triangles) {
  int rings = 4;
  while (2 * rings * 2 * rings < triangles) ++rings;
  test::ShapeBuilder shape;
  shape.sphere(0.045, rings, triangles / (2 * rings));
  return test::finished(shape.build(), {0.7F, 0.3F, 0.15F, 1.0F});
}

// Returns a box for 12 triangles, otherwise a torus.
inline std::shared_ptr<const Model> body(int triangles) {
  if (triangles > 12) return torus(triangles);
  return test::finished(test::box_model(0.08), {0.7F, 0.3F, 0.15F, 1.0F});
}

enum class Video { plain, checkerboard, gradients };
inline Frame video(Video kind) {
  FrameBuffer buffer = allocate_frame(PixelFormat::yuyv, kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    std::uint8_t* row = buffer.plane_data[0] + y * buffer.frame.planes[0].stride;
    for (int x = 0; x < 2 * kWidth; x += 2) {
      const bool white = (x / 160 + y / 80) % 2 == 0;
      const int luma = kind == Video::plain          ? 200
                       : kind == Video::checkerboard ? (white ? 220 : 30)
                                                     : 100 + (x / 7 + y / 5) % 120;
      const int chroma = kind == Video::gradients ? 118 + (x / 40 + y / 60) % 20 : 128;
      row[x] = static_cast<std::uint8_t>(luma);
      row[x + 1] = static_cast<std::uint8_t>(chroma);
    }
  }
  return buffer.frame;
}

// Phantom that receives the object's shadow.
enum class Receiver { none, box, ball };
inline Scene scene_of(std::shared_ptr<const Model> model, const LayeredConstants& constants,
                      Receiver receiver = Receiver::none) {
  test::SceneBuilder builder;
  builder.add(std::move(model), test::at(0.0, 0.0, kObjectHeight, {1, 0.2, 0}, 0.4));
  if (receiver == Receiver::box)
    builder.add(test::box(0.07, 0.06, 0.03), test::at(0.03, 0.0, 0.015), false, true);
  if (receiver == Receiver::ball) {
    test::ShapeBuilder shape;
    shape.sphere(0.03, 24, 48);
    builder.add(test::finished(shape.build(), glm::vec4(1.0F)), test::at(0.03, 0.0, 0.02), false,
                true);
  }
  builder.scene().shadows[0].layered = constants;
  return builder.scene();
}

enum class Motion { still, moving, cut };
// Lifts and slides the object, so that its shadow changes in each frame. `cut` moves it through the
// umbra height, so that only a part of it has an umbra.
inline void move_on(SceneState& state, int frame, Motion motion = Motion::moving,
                    double umbra_height = 0.0) {
  const double start = motion == Motion::cut ? umbra_height : kObjectHeight;
  state.objects[0].position.z() = start + kRisePerFrame * frame;
  state.objects[0].position.x() = 0.0005 * frame;
}

inline CameraModel camera() {
  return test::camera_of(kWidth, kHeight, 1000.0);
}
inline PoseEstimate pose() {
  return test::tracked(test::look_at({0.1, -0.45, 0.4}, {0.0, 0.0, 0.03}));
}

// "layered-direct" and "layered-mask" select the drawing mode of the layers.
struct TechniqueChoice {
  ShadowTechnique technique = ShadowTechnique::none;
  LayerDrawing layers = LayerDrawing::automatic;
};
[[nodiscard]] inline std::optional<TechniqueChoice> technique_of(std::string_view name) {
  TechniqueChoice choice;
  for (const auto& [suffix, mode] : {std::pair{std::string_view("-direct"), LayerDrawing::direct},
                                     std::pair{std::string_view("-mask"), LayerDrawing::mask}}) {
    if (!name.ends_with(suffix)) continue;
    choice.layers = mode;
    name.remove_suffix(suffix.size());
  }
  const auto technique = value_named(kShadowTechniqueNames, name);
  if (!technique) return std::nullopt;
  choice.technique = *technique;
  return choice;
}

}  // namespace penumbra::counted
