#include "tracking/alignment/simd/alignment_loops.hpp"

#include <array>

#include "core/camera/camera_model.hpp"

namespace penumbra::simd {

namespace generic {
extern const Loops kLoops;
}
#if defined(__x86_64__)
namespace avx2 {
extern const Loops kLoops;
}
namespace avx512 {
extern const Loops kLoops;
}
#endif

namespace {

// Returns a null-terminated list. Checks the CPU features that CMakeLists.txt compiles for.
std::array<const Loops*, 4> find_loops() {
  std::array<const Loops*, 4> loops = {&generic::kLoops};
#if defined(__x86_64__)
  __builtin_cpu_init();
  const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                  __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
  const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                  __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                  __builtin_cpu_supports("avx512vl");
  if (v3) loops[1] = &avx2::kLoops;
  if (v4) loops[2] = &avx512::kLoops;
#endif
  return loops;
}

}  // namespace

Lens lens_of(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  Lens lens;
  lens.fx = static_cast<float>(p.fx);
  lens.fy = static_cast<float>(p.fy);
  lens.cx = static_cast<float>(p.cx);
  lens.cy = static_cast<float>(p.cy);
  for (std::size_t k = 0; k < 8; ++k) lens.k[k] = static_cast<float>(p.distortion[k]);
  switch (p.model) {
    case DistortionModel::plumb_bob:
      lens.kind = Lens::Kind::polynomial;
      break;
    case DistortionModel::rational:
      lens.kind = Lens::Kind::rational;
      break;
    case DistortionModel::fisheye:
      lens.kind = Lens::Kind::fisheye;
      break;
  }
  if (!camera.has_distortion()) lens.kind = Lens::Kind::none;
  lens.max_radius2 = static_cast<float>(camera.max_radius() * camera.max_radius());
  return lens;
}

const Loops* const* available_loops() {
  static const std::array<const Loops*, 4> loops = find_loops();
  return loops.data();
}

const Loops& widest_loops() {
  const Loops* const* loops = available_loops();
  while (loops[1] != nullptr) ++loops;
  return **loops;
}

}  // namespace penumbra::simd
