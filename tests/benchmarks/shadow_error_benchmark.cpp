// Run time and error of every shadow technique: shadows of eight meshes are compared with those of
// a ray-cast area light. Also compares the time of kernels with that of reading a model.
//
//   shadow_error_benchmark [RESULTS.json]
//
// The light is at the zenith (H = infinity). Each connected component has a disc light as wide as
// the component is thick, because layers model this light (docs/shadows.md#kernels). Without Embree
// there is no reference, so only times are measured.
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <ctime>
#include <fstream>
#include <functional>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "models/glb_writer.hpp"
#include "render/model/model.hpp"
#include "render/shadow/casters/caster.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/fields/fixed_light.hpp"
#include "render/shadow/fields/power_distance.hpp"
#include "support/paths.hpp"
#include "support/shadow_cases.hpp"
#include "support/shapes.hpp"

#ifdef PENUMBRA_EMBREE
#include <embree3/rtcore.h>
#endif

namespace penumbra {
namespace {

constexpr int kPixels = 256;
constexpr double kHeightShare = 0.45;  // height of the body's centre relative to h_u

double cpu_now_ms() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

// Returns the median CPU time of one run [ms], from at least 3 runs; from more if they are short.
double cpu_ms(const std::function<void()>& work) {
  std::vector<double> times;
  double total = 0.0;
  while (times.size() < 3 || (total < 60.0 && times.size() < 1000)) {
    const double start = cpu_now_ms();
    work();
    times.push_back(cpu_now_ms() - start);
    total += times.back();
  }
  std::nth_element(times.begin(), times.begin() + static_cast<std::ptrdiff_t>(times.size() / 2),
                   times.end());
  return times[times.size() / 2];
}

struct Layers {
  std::array<std::vector<std::uint8_t>, 3> bits;  // umbra, middle, penumbra
};

// A mesh over the plane, and the grid on which shadows are compared.
struct Scene {
  std::string name;
  ShadowMesh mesh;
  LayeredConstants constants;
  Placement placement;
  PlaneFrame plane;
  std::vector<PartDisc> discs;
  test::Mask grid{{0, 0}, 1.0, 0};

  [[nodiscard]] std::vector<CasterVertex> place(const ShadowKernels& kernels) const {
    return place_caster(mesh, kernels, placement, plane);
  }
  [[nodiscard]] double slope(std::size_t part) const {  // light's radius over its height
    return static_cast<double>(discs[part].radius) / constants.umbra_height;
  }
};

Scene make_scene(const std::string& name, const Model& model) {
  Scene scene;
  scene.name = name;
  scene.mesh = make_shadow_mesh(model);
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
  for (const glm::vec3& p : scene.mesh.positions) {
    const Eigen::Vector3d q(static_cast<double>(p.x), static_cast<double>(p.y),
                            static_cast<double>(p.z));
    low = low.cwiseMin(q);
    high = high.cwiseMax(q);
  }
  // Places the whole body between the plane and h_u.
  const double h_u = std::max(0.3, 1.4 * (high.z() - low.z()));
  scene.constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, h_u).value();
  scene.placement.position = {-0.5 * (low.x() + high.x()), -0.5 * (low.y() + high.y()),
                              kHeightShare * h_u - 0.5 * (low.z() + high.z())};
  scene.discs = part_discs(scene.mesh, Eigen::Vector3d::UnitZ());
  float radius = 0.0F;
  for (const PartDisc& disc : scene.discs) radius = std::max(radius, disc.radius);
  const double half = 0.5 * (high - low).head<2>().maxCoeff() + 1.1 * static_cast<double>(radius);
  scene.grid = test::Mask({-half, -half}, 2.0 * half / kPixels, kPixels);
  return scene;
}

Scene bundled_scene(const std::string& name) {
  const auto model = load_model(test::source_dir() / "scenes" / "models" / (name + ".glb"));
  if (!model) throw std::runtime_error(model.error().message);
  return make_scene(name, *model);
}

std::vector<std::uint8_t> covered(const Scene& scene, const std::vector<PlanePoint>& triangles) {
  test::Mask mask = scene.grid;
  mask.cover(triangles);
  return mask.bits;
}

// Returns `count` evenly spread points of the unit disc (a sunflower; the centre comes first) and
// then `on_rim` points of its rim.
std::vector<Eigen::Vector2f> light_samples(int count, int on_rim) {
  std::vector<Eigen::Vector2f> samples;
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  for (int i = 0; i < count; ++i) {
    const double r = std::sqrt(static_cast<double>(i) / std::max(1, count - 1));
    samples.emplace_back(static_cast<float>(r * std::cos(golden * i)),
                         static_cast<float>(r * std::sin(golden * i)));
  }
  for (int i = 0; i < on_rim; ++i) {
    const double turn = 2.0 * std::numbers::pi * i / on_rim;
    samples.emplace_back(static_cast<float>(std::cos(turn)), static_cast<float>(std::sin(turn)));
  }
  return samples;
}

struct Window {
  int left, right, bottom, top;  // pixels; right and top are exclusive
};

// Pixels that a part of the body may shadow, for a light of this `slope`.
Window window_of(const Scene& scene, std::span<const Eigen::Vector3f> points, double slope) {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  for (const Eigen::Vector3f& p : points) {
    const Eigen::Vector2d q = p.head<2>().cast<double>();
    const Eigen::Vector2d radius = Eigen::Vector2d::Constant(slope * static_cast<double>(p.z()));
    low = low.cwiseMin(q - radius);
    high = high.cwiseMax(q + radius);
  }
  const auto pixel = [&](double x, double origin) {
    return std::clamp(static_cast<int>(std::floor((x - origin) / scene.grid.pixel)), 0, kPixels);
  };
  return {pixel(low.x(), scene.grid.origin.x()),
          std::min(kPixels, pixel(high.x(), scene.grid.origin.x()) + 1),
          pixel(low.y(), scene.grid.origin.y()),
          std::min(kPixels, pixel(high.y(), scene.grid.origin.y()) + 1)};
}

Layers empty_layers() {
  Layers layers;
  for (auto& bits : layers.bits)
    bits.assign(static_cast<std::size_t>(kPixels) * static_cast<std::size_t>(kPixels), 0);
  return layers;
}

#ifdef PENUMBRA_EMBREE
// Casts rays from every pixel to the lights of all parts.
class RayCaster {
 public:
  explicit RayCaster(const Scene& scene) : scene_(scene), device_(rtcNewDevice("threads=1")) {
    parts_.resize(scene.mesh.part_count);
    std::vector<std::uint32_t> corner(scene.mesh.positions.size());
    for (std::size_t i = 0; i < corner.size(); ++i) {
      Part& part = parts_[scene.mesh.part[i]];
      corner[i] = static_cast<std::uint32_t>(part.points.size());
      const glm::vec3& p = scene.mesh.positions[i];
      part.points.push_back(
          (scene.placement * Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                                             static_cast<double>(p.z)))
              .cast<float>());
    }
    for (std::size_t i = 0; i + 2 < scene.mesh.indices.size(); i += 3) {
      Part& part = parts_[scene.mesh.part[scene.mesh.indices[i]]];
      for (std::size_t c = 0; c < 3; ++c) part.indices.push_back(corner[scene.mesh.indices[i + c]]);
    }
    build_ms_ = cpu_ms([this] {
      for (Part& part : parts_) build(part);
    });
  }
  ~RayCaster() {
    for (Part& part : parts_)
      if (part.scene != nullptr) rtcReleaseScene(part.scene);
    rtcReleaseDevice(device_);
  }
  RayCaster(const RayCaster&) = delete;
  RayCaster& operator=(const RayCaster&) = delete;

  // Time to build the trees over the faces, which must be rebuilt for each new tilt [ms].
  [[nodiscard]] double build_ms() const { return build_ms_; }

  [[nodiscard]] Layers cast(const std::vector<Eigen::Vector2f>& samples) const {
    Layers layers = empty_layers();
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    for (std::size_t which = 0; which < parts_.size(); ++which) {
      const Part& part = parts_[which];
      if (part.indices.empty()) continue;
      const double slope = scene_.slope(which);
      const Window window = window_of(scene_, part.points, slope);
      for (int row = window.bottom; row < window.top; ++row) {
        for (int column = window.left; column < window.right; ++column) {
          const Eigen::Vector2d p =
              scene_.grid.origin + scene_.grid.pixel * Eigen::Vector2d(column + 0.5, row + 0.5);
          bool centre = false;
          const std::size_t blocked =
              blocked_rays(part, p, static_cast<float>(slope), samples, context, centre);
          const std::size_t i = scene_.grid.index(column, row);
          if (blocked == samples.size()) layers.bits[0][i] = 1;
          if (centre) layers.bits[1][i] = 1;
          if (blocked > 0) layers.bits[2][i] = 1;
        }
      }
    }
    return layers;
  }

 private:
  struct Part {
    std::vector<Eigen::Vector3f> points;
    std::vector<std::uint32_t> indices;
    RTCScene scene = nullptr;
  };

  void build(Part& part) const {
    if (part.scene != nullptr) rtcReleaseScene(part.scene);
    part.scene = rtcNewScene(device_);
    RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
    std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                        3 * sizeof(float), part.points.size()),
                part.points.data(), part.points.size() * 3 * sizeof(float));
    std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                        3 * sizeof(std::uint32_t), part.indices.size() / 3),
                part.indices.data(), part.indices.size() * sizeof(std::uint32_t));
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(part.scene, geometry);
    rtcReleaseGeometry(geometry);
    rtcSetSceneFlags(part.scene, RTC_SCENE_FLAG_ROBUST);
    rtcCommitScene(part.scene);
  }

  static std::size_t blocked_rays(const Part& part, const Eigen::Vector2d& p, float slope,
                                  const std::vector<Eigen::Vector2f>& samples,
                                  RTCIntersectContext& context, bool& centre) {
    constexpr std::size_t kPacket = 16;
    std::size_t blocked = 0;
    alignas(64) int valid[kPacket];
    alignas(64) RTCRay16 rays;
    for (std::size_t first = 0; first < samples.size(); first += kPacket) {
      const std::size_t count = std::min(kPacket, samples.size() - first);
      for (std::size_t i = 0; i < kPacket; ++i) {
        valid[i] = i < count ? -1 : 0;
        const Eigen::Vector2f& s = samples[std::min(first + i, samples.size() - 1)];
        rays.org_x[i] = static_cast<float>(p.x());
        rays.org_y[i] = static_cast<float>(p.y());
        rays.org_z[i] = 0.0F;
        rays.dir_x[i] = slope * s.x();
        rays.dir_y[i] = slope * s.y();
        rays.dir_z[i] = 1.0F;
        rays.tnear[i] = 0.0F;
        rays.tfar[i] = std::numeric_limits<float>::infinity();
        rays.time[i] = 0.0F;
        rays.mask[i] = 0xffffffffU;
        rays.flags[i] = 0;
      }
      rtcOccluded16(valid, part.scene, &context, &rays);
      for (std::size_t i = 0; i < count; ++i) blocked += rays.tfar[i] < 0.0F ? 1U : 0U;
      if (first == 0) centre = rays.tfar[0] < 0.0F;
    }
    return blocked;
  }

  const Scene& scene_;
  RTCDevice device_;
  std::vector<Part> parts_;
  double build_ms_ = 0.0;
};
#endif

// Percentage-closer soft shadows (Fernando 2005): a height map seen from the light's centre, a
// blocker search, and a filter as wide as the light's image at the mean height of the blockers. All
// parts share the light of the thickest part.
class SoftShadow {
 public:
  explicit SoftShadow(const Scene& scene) : scene_(scene) {
    for (std::size_t part = 0; part < scene.discs.size(); ++part)
      slope_ = std::max(slope_, static_cast<float>(scene.slope(part) / scene.grid.pixel));
  }

  [[nodiscard]] Layers cast(const std::vector<CasterVertex>& vertices) {
    draw(vertices);
    Layers layers = empty_layers();
    static const std::vector<Eigen::Vector2f> search = light_samples(16, 8);
    static const std::vector<Eigen::Vector2f> filter = light_samples(32, 16);
    const float widest = slope_ * top_;
    for (int row = 0; row < kPixels; ++row) {
      for (int column = 0; column < kPixels; ++column) {
        float sum = 0.0F;
        int found = 0;
        for (const Eigen::Vector2f& s : search) {
          const float h = height_at(column, row, widest * s);
          if (h <= 0.0F) continue;
          sum += h;
          ++found;
        }
        const std::size_t i = scene_.grid.index(column, row);
        layers.bits[1][i] = heights_[i] > 0.0F ? 1 : 0;
        if (found == 0) continue;
        const float width = slope_ * sum / static_cast<float>(found);
        std::size_t blocked = 0;
        for (const Eigen::Vector2f& s : filter)
          blocked += height_at(column, row, width * s) > 0.0F ? 1U : 0U;
        layers.bits[0][i] = blocked == filter.size() ? 1 : 0;
        layers.bits[2][i] = blocked > 0 ? 1 : 0;
      }
    }
    return layers;
  }

 private:
  [[nodiscard]] float height_at(int column, int row, const Eigen::Vector2f& offset) const {
    const int c = column + static_cast<int>(std::lround(offset.x()));
    const int r = row + static_cast<int>(std::lround(offset.y()));
    if (c < 0 || r < 0 || c >= kPixels || r >= kPixels) return 0.0F;
    return heights_[scene_.grid.index(c, r)];
  }
  void draw(const std::vector<CasterVertex>& vertices) {
    heights_.assign(static_cast<std::size_t>(kPixels) * static_cast<std::size_t>(kPixels), 0.0F);
    top_ = 0.0F;
    const auto& indices = scene_.mesh.indices;
    const auto pixel = static_cast<float>(scene_.grid.pixel);
    const Eigen::Vector2f origin = scene_.grid.origin.cast<float>();
    for (std::size_t i = 0; i + 2 < indices.size(); i += 3) {
      std::array<Eigen::Vector3f, 3> p;
      for (std::size_t c = 0; c < 3; ++c) {
        const CasterVertex& vertex = vertices[indices[i + c]];
        p[c] = {(vertex.u - origin.x()) / pixel - 0.5F, (vertex.v - origin.y()) / pixel - 0.5F,
                vertex.h};
        top_ = std::max(top_, vertex.h);
      }
      const Eigen::Vector2f ab = (p[1] - p[0]).head<2>();
      const Eigen::Vector2f ac = (p[2] - p[0]).head<2>();
      const float area = ab.x() * ac.y() - ab.y() * ac.x();
      if (area == 0.0F) continue;
      const auto [left, right] = std::minmax({p[0].x(), p[1].x(), p[2].x()});
      const auto [low, high] = std::minmax({p[0].y(), p[1].y(), p[2].y()});
      for (int row = std::max(0, static_cast<int>(std::ceil(low)));
           row <= std::min(kPixels - 1, static_cast<int>(std::floor(high))); ++row) {
        for (int column = std::max(0, static_cast<int>(std::ceil(left)));
             column <= std::min(kPixels - 1, static_cast<int>(std::floor(right))); ++column) {
          const Eigen::Vector2f d(static_cast<float>(column) - p[0].x(),
                                  static_cast<float>(row) - p[0].y());
          const float b = (d.x() * ac.y() - d.y() * ac.x()) / area;
          const float c = (ab.x() * d.y() - ab.y() * d.x()) / area;
          if (b < 0.0F || c < 0.0F || b + c > 1.0F) continue;
          float& h = heights_[scene_.grid.index(column, row)];
          h = std::max(h, p[0].z() + b * (p[1].z() - p[0].z()) + c * (p[2].z() - p[0].z()));
        }
      }
    }
  }

  const Scene& scene_;
  float slope_ = 0.0F;  // pixels per metre of height
  float top_ = 0.0F;
  std::vector<float> heights_;
};

struct Measured {
  double height_ms = 0.0;  // CPU time of the layers after the body rises
  double tilt_ms = 0.0;    // CPU time after a tilt; includes kernels, part lights or trees of faces
  Layers layers;
};

Measured measure_kernels(const Scene& scene, KernelSource source, bool fixed_light) {
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const ShadowKernels kernels = generate_kernels(scene.mesh, up, source);
  const auto layer = [&](std::span<const CasterVertex> vertices, ShadowLayer which) {
    return fixed_light ? fixed_light_triangles(vertices,
                                               vertex_discs(scene.mesh, kernels, scene.discs, 1.0),
                                               scene.mesh.indices, scene.constants, which)
                       : layer_triangles(vertices, scene.mesh.indices, scene.constants, which);
  };
  // std::abort() is never reached. It keeps the compiler from removing the measured work.
  Measured measured;
  measured.height_ms = cpu_ms([&] {
    const auto vertices = scene.place(kernels);
    for (const ShadowLayer which : kShadowLayers)
      if (layer(vertices, which).size() == 1) std::abort();
  });
  measured.tilt_ms = measured.height_ms + cpu_ms([&] {
                       if (generate_kernels(scene.mesh, up, source).kernels.size() == 1)
                         std::abort();
                     });
  if (fixed_light)
    measured.tilt_ms += cpu_ms([&] {
      if (part_discs(scene.mesh, up).size() != scene.discs.size()) std::abort();
    });
  const auto vertices = scene.place(kernels);
  for (std::size_t i = 0; i < 3; ++i)
    measured.layers.bits[i] = covered(scene, layer(vertices, kShadowLayers[i]));
  return measured;
}

// Uses the proxy if its layers agree to 0.98, otherwise the model. The time of a tilt includes the
// comparison.
Measured measure_proxy(const Scene& scene) {
  const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
  const ShadowKernels kernels = generate_kernels(scene.mesh, up, KernelSource::automatic);
  const auto proxy = simplified_caster(scene.mesh);
  const ProxyUse use{scene.constants, LightMode::proportional, 1.0};
  if (!proxy || !compare_with_proxy(scene.mesh, kernels, {}, *proxy, use, false).is_sufficient()) {
    return measure_kernels(scene, KernelSource::automatic, false);
  }
  const ShadowKernels carried = carried_kernels(*proxy, kernels);
  const auto place = [&] {
    return place_caster(proxy->mesh, carried, scene.placement, scene.plane);
  };
  Measured measured;
  measured.height_ms = cpu_ms([&] {
    const auto vertices = place();
    for (const ShadowLayer which : kShadowLayers)
      if (layer_triangles(vertices, proxy->mesh.indices, scene.constants, which).size() == 1)
        std::abort();
  });
  measured.tilt_ms =
      measured.height_ms + cpu_ms([&] {
        const ShadowKernels made = generate_kernels(scene.mesh, up, KernelSource::automatic);
        if (carried_kernels(*proxy, made).kernels.size() == 1) std::abort();
        if (!compare_with_proxy(scene.mesh, made, {}, *proxy, use, false).is_sufficient())
          std::abort();
      });
  const auto vertices = place();
  for (std::size_t i = 0; i < 3; ++i) {
    measured.layers.bits[i] = covered(
        scene, layer_triangles(vertices, proxy->mesh.indices, scene.constants, kShadowLayers[i]));
  }
  return measured;
}

Measured measure_simple(const Scene& scene) {
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), scene.mesh.positions, {}};
  Measured measured;
  measured.height_ms = cpu_ms([&] {
    if (orthogonal_triangles(scene.place(none), scene.mesh.indices).size() == 1) std::abort();
  });
  measured.tilt_ms = measured.height_ms;
  const auto bits = covered(scene, orthogonal_triangles(scene.place(none), scene.mesh.indices));
  measured.layers.bits = {bits, bits, bits};
  return measured;
}

Measured measure_field(const Scene& scene) {
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), scene.mesh.positions, {}};
  const auto lights = part_lights(scene.discs, scene.placement, scene.plane);
  ShadowField field;
  Measured measured;
  measured.height_ms = cpu_ms([&] {
    field = power_distance_layers(scene.place(none), scene.mesh.indices, scene.mesh.part, lights,
                                  scene.constants);
  });
  measured.tilt_ms =
      measured.height_ms + cpu_ms([&] {
        if (part_discs(scene.mesh, Eigen::Vector3d::UnitZ()).size() != scene.discs.size())
          std::abort();
      });
  for (std::size_t i = 0; i < 3; ++i)
    measured.layers.bits[i] = covered(scene, field_triangles(field, kShadowLayers[i]));
  return measured;
}

Measured measure_soft(const Scene& scene) {
  const ShadowKernels none{Eigen::Vector3d::UnitZ(), scene.mesh.positions, {}};
  SoftShadow soft(scene);
  Measured measured;
  measured.height_ms = cpu_ms([&] { measured.layers = soft.cast(scene.place(none)); });
  measured.tilt_ms = measured.height_ms;
  return measured;
}

struct Errors {
  std::array<double, 3> area{}, iou{};  // umbra, middle, penumbra
};
Errors errors_of(const Layers& layers, const Layers& reference) {
  Errors errors;
  for (std::size_t i = 0; i < 3; ++i) {
    double area = 0.0;
    double reference_area = 0.0;
    for (std::size_t b = 0; b < reference.bits[i].size(); ++b) {
      area += layers.bits[i][b];
      reference_area += reference.bits[i][b];
    }
    errors.area[i] = reference_area > 0.0 ? (area - reference_area) / reference_area : area;
    errors.iou[i] = test::iou(layers.bits[i], reference.bits[i]);
  }
  return errors;
}

struct Technique {
  std::string name;
  std::function<Measured(const Scene&)> measure;
};

std::vector<Technique> techniques() {
  return {
      {"simple", measure_simple},
      {"cocl", [](const Scene& s) { return measure_kernels(s, KernelSource::centroid, false); }},
      {"layered",
       [](const Scene& s) { return measure_kernels(s, KernelSource::automatic, false); }},
      {"layered with proxies", measure_proxy},
      {"layered smooth",
       [](const Scene& s) { return measure_kernels(s, KernelSource::smooth, false); }},
      {"layered, one light",
       [](const Scene& s) { return measure_kernels(s, KernelSource::automatic, true); }},
      {"field", measure_field},
      {"soft (PCSS)", measure_soft},
#ifdef PENUMBRA_EMBREE
      {"rays 16", {}},
      {"rays 64", {}},
      {"rays 256", {}},
      {"rays 1024", {}},
#endif
  };
}

#ifdef PENUMBRA_EMBREE
Measured measure_rays(const RayCaster& rays, int count) {
  const auto samples = light_samples(count, 0);
  Measured measured;
  const double start = cpu_now_ms();
  measured.layers = rays.cast(samples);
  measured.height_ms = cpu_now_ms() - start;
  measured.tilt_ms = measured.height_ms + rays.build_ms();
  return measured;
}
#endif

void compare_techniques(nlohmann::ordered_json& results) {
  const auto list = techniques();
  std::vector<Scene> scenes;
  for (const char* name :
       {"sphere", "cube", "bar", "ring", "l_shape", "tube", "helicopter", "hand"})
    scenes.push_back(bundled_scene(name));

  struct Row {
    double height_ms = 0.0, tilt_ms = 0.0;
    Errors errors, worst;
  };
  std::vector<Row> rows(list.size());
  std::vector<std::vector<Errors>> each(list.size());
  for (const Scene& scene : scenes) {
#ifdef PENUMBRA_EMBREE
    const RayCaster rays(scene);
    const Layers reference = rays.cast(light_samples(1024, 512));
#endif
    for (std::size_t i = 0; i < list.size(); ++i) {
      Measured measured;
#ifdef PENUMBRA_EMBREE
      if (!list[i].measure) {
        measured = measure_rays(rays, std::stoi(list[i].name.substr(5)));
      } else {
        measured = list[i].measure(scene);
      }
      each[i].push_back(errors_of(measured.layers, reference));
#else
      measured = list[i].measure(scene);
      each[i].emplace_back();
#endif
      rows[i].height_ms += measured.height_ms / static_cast<double>(scenes.size());
      rows[i].tilt_ms += measured.tilt_ms / static_cast<double>(scenes.size());
    }
  }

#ifndef PENUMBRA_EMBREE
  fmt::print("libembree-dev is not installed: there is no reference, and so no errors\n\n");
#endif
  fmt::print("mean of 8 meshes      rises [ms]  tilts [ms]   area error [%]             IoU\n");
  fmt::print(
      "                                              umbra middle penumbra   umbra middle "
      "penumbra\n");
  for (std::size_t i = 0; i < list.size(); ++i) {
    std::array<double, 3> area{};
    std::array<double, 3> iou{};
    for (const Errors& errors : each[i]) {
      for (std::size_t layer = 0; layer < 3; ++layer) {
        area[layer] += std::abs(errors.area[layer]) / static_cast<double>(each[i].size());
        iou[layer] += errors.iou[layer] / static_cast<double>(each[i].size());
      }
    }
    fmt::print("{:<20} {:>11.4f} {:>11.4f} {:>8.1f} {:>6.1f} {:>8.1f} {:>7.3f} {:>6.3f} {:>8.3f}\n",
               list[i].name, rows[i].height_ms, rows[i].tilt_ms, 100.0 * area[0], 100.0 * area[1],
               100.0 * area[2], iou[0], iou[1], iou[2]);
    results["techniques"].push_back({{"name", list[i].name},
                                     {"rises_ms", rows[i].height_ms},
                                     {"tilts_ms", rows[i].tilt_ms},
                                     {"area_error", {area[0], area[1], area[2]}},
                                     {"iou", {iou[0], iou[1], iou[2]}}});
  }
  fmt::print("\nIoU umbra / penumbra  ");
  for (const Scene& scene : scenes) fmt::print("{:>12}", scene.name);
  fmt::print("\nfaces                 ");
  for (const Scene& scene : scenes) fmt::print("{:>12}", scene.mesh.indices.size() / 3);
  fmt::print("\n");
  for (std::size_t i = 0; i < list.size(); ++i) {
    fmt::print("{:<20}  ", list[i].name);
    for (const Errors& errors : each[i])
      fmt::print("{:>12}", fmt::format("{:.2f} / {:.2f}", errors.iou[0], errors.iou[2]));
    fmt::print("\n");
  }
  results["reference"] =
#ifdef PENUMBRA_EMBREE
      true;
#else
      false;
#endif
}

// Time saved and error added by proxies, for meshes with many faces.
void compare_proxies(nlohmann::ordered_json& results) {
  fmt::print(
      "\n{:<22} {:>7} {:>6}  {:<9} {:>10} {:>10}   {:^25} {:^20}\n{:62}{:>10}   {:>7} {:>8} {:>8} "
      "{:>6} {:>6} {:>6}\n",
      "proxies", "faces", "casts", "agreement", "rises [ms]", "tilts [ms]", "area error [%]", "IoU",
      "", "", "umbra", "middle", "penumbra", "umbra", "middle", "penumbra");
  std::vector<Scene> scenes;
  scenes.push_back(bundled_scene("helicopter"));
  scenes.push_back(bundled_scene("tree"));
  scenes.push_back(make_scene("torus", test::torus_model(160, 325)));
  for (const Scene& scene : scenes) {
#ifdef PENUMBRA_EMBREE
    const Layers reference = RayCaster(scene).cast(light_samples(256, 128));
#endif
    const ProxyUse use{scene.constants, LightMode::proportional, 1.0};
    const ShadowKernels kernels =
        generate_kernels(scene.mesh, Eigen::Vector3d::UnitZ(), KernelSource::automatic);
    const auto proxy = simplified_caster(scene.mesh);
    std::optional<double> agreement;
    if (proxy) agreement = compare_with_proxy(scene.mesh, kernels, {}, *proxy, use, true).min_iou();
    for (const bool reduced : {false, true}) {
      const Measured measured =
          reduced ? measure_proxy(scene) : measure_kernels(scene, KernelSource::automatic, false);
      Errors errors;
#ifdef PENUMBRA_EMBREE
      errors = errors_of(measured.layers, reference);
#endif
      const std::size_t faces = scene.mesh.indices.size() / 3;
      const bool is_sufficient = agreement && *agreement >= kMinProxyAgreement;
      const std::size_t casts = reduced && is_sufficient ? proxy->mesh.indices.size() / 3 : faces;
      fmt::print(
          "{:<22} {:>7} {:>6}  {:<9} {:>10.4f} {:>10.4f}   {:>7.1f} {:>8.1f} {:>8.1f} {:>6.3f} "
          "{:>6.3f} {:>6.3f}\n",
          scene.name, faces, casts,
          !reduced    ? "-"
          : agreement ? fmt::format("{:.4f}", *agreement)
                      : "none",
          measured.height_ms, measured.tilt_ms, 100.0 * errors.area[0], 100.0 * errors.area[1],
          100.0 * errors.area[2], errors.iou[0], errors.iou[1], errors.iou[2]);
      results["proxies"].push_back({{"name", scene.name},
                                    {"faces", faces},
                                    {"casts", casts},
                                    {"rises_ms", measured.height_ms},
                                    {"tilts_ms", measured.tilt_ms},
                                    {"iou", {errors.iou[0], errors.iou[1], errors.iou[2]}}});
    }
  }
}

// Compares kernel generation with reading the mesh from a file, in the same run.
void compare_kernels_with_reading(nlohmann::ordered_json& results) {
  const test::TemporaryFolder folder;
  const auto torus_file = [&](const char* name, int rings, int segments) {
    Model model = test::torus_model(rings, segments);
    model.materials.emplace_back();
    for (Mesh& mesh : model.meshes) mesh.normals.assign(mesh.positions.size(), {0, 0, 1});
    const auto bytes = models::encode_glb(model);
    if (!bytes) throw std::runtime_error(bytes.error().message);
    const auto file = folder.path() / name;
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes->data()),
               static_cast<std::streamsize>(bytes->size()));
    return file;
  };
  const auto models = test::source_dir() / "scenes" / "models";
  const std::vector<std::pair<const char*, std::filesystem::path>> files = {
      {"torus", torus_file("torus_3k.glb", 24, 64)},
      {"hand", models / "hand.glb"},
      {"tree", models / "tree.glb"},
      {"torus", torus_file("torus_104k.glb", 160, 325)}};
  fmt::print(
      "\nkernels beside reading    faces  parts  read [ms]  weld [ms]  kernels [ms]  kernels / "
      "read\n");
  for (const auto& [name, file] : files) {
    const auto model = load_model(file);
    if (!model) throw std::runtime_error(model.error().message);
    const ShadowMesh mesh = make_shadow_mesh(*model);
    const double read = cpu_ms([&path = file] {
      if (!load_model(path)) std::abort();
    });
    const double weld = cpu_ms([&] {
      if (make_shadow_mesh(*model).part_count != mesh.part_count) std::abort();
    });
    const double kernels = cpu_ms([&] {
      if (generate_kernels(mesh, {0.1, 0.2, 1.0}, KernelSource::automatic).kernels.empty())
        std::abort();
    });
    fmt::print("{:<22} {:>8} {:>6} {:>10.3f} {:>10.3f} {:>13.3f} {:>15.3f}\n", name,
               mesh.indices.size() / 3, mesh.part_count, read, weld, kernels, kernels / read);
    results["kernels"].push_back({{"name", name},
                                  {"faces", mesh.indices.size() / 3},
                                  {"read_ms", read},
                                  {"weld_ms", weld},
                                  {"kernels_ms", kernels}});
  }
}

// Times that have a goal in milliseconds on one core.
void compare_with_goals(nlohmann::ordered_json& results) {
  const ShadowMesh torus = make_shadow_mesh(test::torus_model(24, 64));
  const PlaneFrame plane;
  const Placement placement = {Eigen::Vector3d(0, 0, 0.12), Eigen::Quaterniond::Identity(), 1.0};
  const ShadowKernels none{plane.n, torus.positions, {}};
  const auto vertices = place_caster(torus, none, placement, plane);
  const auto lights = part_lights(part_discs(torus, plane.n), placement, plane);
  const auto field_ms = [&](const LayeredConstants& constants) {
    return cpu_ms([&] {
      if (power_distance_layers(vertices, torus.indices, torus.part, lights, constants).width == 0)
        std::abort();
    });
  };
  const auto kernels_ms = [](const ShadowMesh& mesh) {
    return cpu_ms([&] {
      if (generate_kernels(mesh, {0.1, 0.2, 1.0}, KernelSource::automatic).kernels.empty())
        std::abort();
    });
  };
  struct Goal {
    const char* what;
    double goal_ms, reached_ms;
  };
  const std::vector<Goal> goals = {
      {"kernels, 3,072 faces", 2.0, kernels_ms(torus)},
      {"kernels, 104,000 faces", 25.0, kernels_ms(make_shadow_mesh(test::torus_model(160, 325)))},
      {"kernels, 23,424 faces in 1,463 parts", 20.0,
       kernels_ms(make_shadow_mesh(test::bush_model(1462)))},
      {"field 256 x 256, 3,072 faces, near light", 3.0,
       field_ms(make_layered_constants(0.9, 3.0, 0.0).value())},
      {"field 256 x 256, 3,072 faces, light at the zenith", 3.0,
       field_ms(
           make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, 0.3).value())}};
  fmt::print("\n{:<52} goal [ms]  reached [ms]\n", "on one core");
  for (const Goal& goal : goals) {
    fmt::print("{:<52} {:>9.1f} {:>13.2f}\n", goal.what, goal.goal_ms, goal.reached_ms);
    results["goals"].push_back(
        {{"what", goal.what}, {"goal_ms", goal.goal_ms}, {"reached_ms", goal.reached_ms}});
  }
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  try {
    nlohmann::ordered_json results;
    penumbra::compare_techniques(results);
    penumbra::compare_proxies(results);
    penumbra::compare_kernels_with_reading(results);
    penumbra::compare_with_goals(results);
    if (argc > 1) std::ofstream(argv[1]) << results.dump(1) << "\n";
  } catch (const std::exception& error) {
    fmt::print(stderr, "shadow_error_benchmark: {}\n", error.what());
    return 1;
  }
  return 0;
}
