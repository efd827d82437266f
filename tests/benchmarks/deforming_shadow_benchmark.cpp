// Shadows of objects that change their shape: layers of carried kernels and of fields, compared
// with ray casting (docs/shadows.md#kernels-of-animated-models). Also measures the time of an
// update.
//
//   deforming_shadow_benchmark [FOLDER]      writes images of the shadows into the folder
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "core/image/image_file.hpp"
#include "support/moving_shadow.hpp"

namespace penumbra {
namespace {

constexpr int kPhases = 20;
constexpr int kPixels = 256;
using test::MovingShadow;
using test::PlaneLayers;

double cpu_now_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

// Kernels that are generated for shapes `step_s` apart.
class KeyedKernels {
 public:
  KeyedKernels(const MovingShadow& shadow, double step_s) : shadow_(shadow) {
    steps_ = std::max(1, static_cast<int>(std::lround(shadow.end_s() / step_s)));
  }
  // `carried`: each set is carried to the shape; else it stays where it was generated.
  [[nodiscard]] ShadowKernels at(double time_s, const ShadowMesh& mesh, bool carried) {
    const double at = time_s / shadow_.end_s() * steps_;
    const int before = std::min(static_cast<int>(at), steps_ - 1);
    const CarriedKernels &a = key(before), &b = key(before + 1);
    if (!carried) return blended(a.first(), b.first(), at - before);
    return blended(a.at(mesh.positions), b.at(mesh.positions), at - before);
  }

 private:
  const CarriedKernels& key(int index) {
    const auto found = keys_.find(index);
    if (found != keys_.end()) return found->second;
    const ShadowMesh mesh = shadow_.mesh_at(shadow_.end_s() * index / steps_);
    return keys_.emplace(index, CarriedKernels(mesh, shadow_.generated(mesh))).first->second;
  }

  const MovingShadow& shadow_;
  int steps_ = 1;
  std::map<int, CarriedKernels> keys_;
};

struct Subject {
  std::string name;
  models::MovingModel model;
  double tilt_rad = 0.0;
};

struct Method {
  std::string name;
  std::function<PlaneLayers(double time_s)> layers;
};

void compare_methods(const Subject& subject) {
  MovingShadow shadow(test::loaded(subject.model), kPixels, subject.tilt_rad);
  std::vector<KeyedKernels> keyed;
  constexpr std::array kSteps = {0.05, 0.1, 0.2, 0.5};
  for (const double step_s : kSteps) keyed.emplace_back(shadow, step_s);
  const ShadowMesh first_mesh = shadow.mesh_at(0.0);
  const CarriedKernels first(first_mesh, shadow.generated(first_mesh));
  std::vector<Method> methods = {
      {"field", [&](double t) { return shadow.by_field(t); }},
      {"kernels generated for each frame",
       [&](double t) {
         const ShadowMesh mesh = shadow.mesh_at(t);
         return shadow.layers_of(mesh, shadow.generated(mesh));
       }},
      {"carried, as the program does", [&](double t) { return shadow.by_kernels(t); }}};
  for (std::size_t i = 0; i < kSteps.size(); ++i) {
    for (const bool carried : {true, false}) {
      methods.push_back(
          {fmt::format("{}, keys every {} s", carried ? "carried" : "not carried", kSteps[i]),
           [&shadow, &keys = keyed[i], carried](double t) {
             const ShadowMesh mesh = shadow.mesh_at(t);
             return shadow.layers_of(mesh, keys.at(t, mesh, carried));
           }});
    }
  }
  methods.push_back({"carried from the first shape alone", [&](double t) {
                       const ShadowMesh mesh = shadow.mesh_at(t);
                       return shadow.layers_of(mesh, first.at(mesh.positions));
                     }});
  const AnimatedCaster::Agreement agreement = shadow.agreement();
  fmt::print("\n{}: {} faces in {} parts; agreement with the field {:.3f} / {:.3f}, {}\n",
             subject.name, first_mesh.indices.size() / 3, first_mesh.part_count, agreement.umbra,
             agreement.penumbra,
             agreement.is_sufficient() ? "drawn with kernels" : "drawn as a field");
  fmt::print("{:<36} {:>7} {:>7} {:>7} {:>9} {:>9}\n", "mean IoU with ray casting", "umbra",
             "middle", "penum.", "min umbra", "min pen.");
  std::vector<PlaneLayers> rays;
  const auto time_of = [&](int phase) { return shadow.end_s() * (phase + 0.37) / kPhases; };
  for (int i = 0; i < kPhases; ++i) rays.push_back(shadow.by_rays(time_of(i)));
  for (const Method& method : methods) {
    double umbra = 0.0, middle = 0.0, penumbra = 0.0, min_umbra = 1.0, min_penumbra = 1.0;
    for (int i = 0; i < kPhases; ++i) {
      const PlaneLayers layers = method.layers(time_of(i));
      const PlaneLayers& exact = rays[static_cast<std::size_t>(i)];
      const double u = layers.umbra.iou(exact.umbra), p = layers.penumbra.iou(exact.penumbra);
      umbra += u / kPhases;
      middle += layers.middle.iou(exact.middle) / kPhases;
      penumbra += p / kPhases;
      min_umbra = std::min(min_umbra, u);
      min_penumbra = std::min(min_penumbra, p);
    }
    fmt::print("{:<36} {:7.3f} {:7.3f} {:7.3f} {:9.3f} {:9.3f}\n", method.name, umbra, middle,
               penumbra, min_umbra, min_penumbra);
  }
}

// Greatest change of each layer's area between frames, relative to that of ray casting.
void compare_changes(const Subject& subject) {
  MovingShadow shadow(test::loaded(subject.model), kPixels, subject.tilt_rad);
  const test::AreaChanges changes =
      test::area_changes(shadow, static_cast<int>(std::lround(60.0 * shadow.end_s())));
  fmt::print("{:<12} greatest change of area between frames / that of ray casting: kernels",
             subject.name);
  for (std::size_t i = 0; i < 3; ++i)
    fmt::print(" {:.2f}", changes.by_kernels[i] / changes.by_rays[i]);
  fmt::print(", field");
  for (std::size_t i = 0; i < 3; ++i)
    fmt::print(" {:.2f}", changes.by_field[i] / changes.by_rays[i]);
  fmt::print("\n");
}

void measure_times(const Subject& subject) {
  const auto model = test::loaded(subject.model);
  AnimatedCaster caster(model, {});
  const AnimatedCaster::Kernels by{KernelDirection::nearest(Eigen::Vector3d::UnitZ()),
                                   KernelSource::automatic};
  int generated = 0;
  double key_ms = 0.0, mesh_ms = 0.0, kernels_ms = 0.0, place_ms = 0.0, shape_ms = 0.0,
         lights_ms = 0.0, field_ms = 0.0;
  constexpr int kFrames = 240;
  std::size_t faces = 0;
  for (int run = 0; run < 2; ++run) {  // the first run makes the keys
    for (int i = 0; i < kFrames; ++i) {
      const double time_s = model->end_s() * (i + 0.5) / kFrames;
      const double start = cpu_now_ms();
      const auto shape = model->at(time_s).value();
      const double shaped = cpu_now_ms();
      const ShadowMesh mesh = caster.mesh_of(*shape).value();
      const double moved = cpu_now_ms();
      const ShadowKernels kernels = caster.kernels_at(by, time_s, mesh.positions, generated);
      const double carried = cpu_now_ms();
      const auto vertices = place_caster(mesh, kernels, Placement(), PlaneFrame());
      const double placed = cpu_now_ms();
      int lights_generated = 0;
      const auto lights =
          part_lights(caster.field_parts_at(by.direction, time_s, mesh, lights_generated).value(),
                      Placement(), PlaneFrame());
      const double lit = cpu_now_ms();
      if (run == 0) {
        key_ms += carried - moved;
        continue;
      }
      shape_ms += (shaped - start) / kFrames;
      mesh_ms += (moved - shaped) / kFrames;
      kernels_ms += (carried - moved) / kFrames;
      place_ms += (placed - carried) / kFrames;
      faces = mesh.indices.size() / 3;
      lights_ms += (lit - placed) / kFrames;
      const auto constants = make_layered_constants(0.9, 3.0, 0.0).value();
      const double before = cpu_now_ms();
      const ShadowField field =
          power_distance_layers(vertices, mesh.indices, mesh.part, lights, constants);
      field_ms += (cpu_now_ms() - before) / kFrames;
    }
  }
  fmt::print(
      "{:<12} {} faces, CPU time [ms]: mesh {:.3f} + carried kernels {:.3f} + vertices {:.3f} = "
      "{:.3f} per frame; {:.2f} per key ({} keys); field: mesh + vertices + lights {:.3f} + raster "
      "{:.3f} = {:.3f} per frame; shape {:.2f}\n",
      subject.name, faces, mesh_ms, kernels_ms, place_ms, mesh_ms + kernels_ms + place_ms,
      key_ms / generated - kernels_ms, generated, lights_ms, field_ms,
      mesh_ms + place_ms + lights_ms + field_ms, shape_ms);
}

// Writes shadows as columns of phases; rows: ray casting, carried kernels, field.
void write_image(const Subject& subject, const std::filesystem::path& folder) {
  constexpr int kColumns = 5, kRows = 3, kGap = 4;
  MovingShadow shadow(test::loaded(subject.model), kPixels, subject.tilt_rad);
  const int width = kColumns * (kPixels + kGap) - kGap, height = kRows * (kPixels + kGap) - kGap;
  std::vector<std::uint8_t> rgba(static_cast<std::size_t>(width * height) * 4, 255);
  for (int column = 0; column < kColumns; ++column) {
    const double time_s = shadow.end_s() * (column + 0.37) / kColumns;
    const std::array rows = {shadow.by_rays(time_s), shadow.by_kernels(time_s),
                             shadow.by_field(time_s)};
    for (int row = 0; row < kRows; ++row) {
      const PlaneLayers& layers = rows[static_cast<std::size_t>(row)];
      for (int y = 0; y < kPixels; ++y) {
        for (int x = 0; x < kPixels; ++x) {
          const int up = kPixels - 1 - y;
          const int grey = layers.umbra.at(x, up)      ? 40
                           : layers.middle.at(x, up)   ? 105
                           : layers.penumbra.at(x, up) ? 190
                                                       : 240;
          const auto at = 4 * static_cast<std::size_t>((row * (kPixels + kGap) + y) * width +
                                                       column * (kPixels + kGap) + x);
          for (std::size_t c = 0; c < 3; ++c) rgba[at + c] = static_cast<std::uint8_t>(grey);
        }
      }
    }
  }
  const auto file = folder / ("deforming-" + subject.model.model.name + ".png");
  const auto written = save_png(file, width, height, rgba);
  if (!written) fmt::print(stderr, "{}\n", written.error().message);
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  try {
    const std::vector<Subject> suitable = {{"figure", models::make_figure()},
                                           {"blob", models::make_blob()}};
    const std::vector<Subject> others = {{"figure on its side", models::make_figure(), 1.5708},
                                         {"blob with deep lobes", models::make_blob(2.0)}};
    for (const auto* subjects : {&suitable, &others})
      for (const Subject& subject : *subjects) compare_methods(subject);
    fmt::print("\n");
    for (const Subject& subject : suitable) compare_changes(subject);
    fmt::print("\n");
    for (const Subject& subject : suitable) measure_times(subject);
    for (const Subject& subject : suitable)
      if (argc > 1) write_image(subject, argv[1]);
  } catch (const std::exception& error) {
    fmt::print(stderr, "deforming_shadow_benchmark: {}\n", error.what());
    return 1;
  }
  return 0;
}
