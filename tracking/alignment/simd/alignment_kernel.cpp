#include "tracking/alignment/simd/alignment_kernel.hpp"

#include <array>
#include <cstddef>

#include "core/camera/camera_model.hpp"

namespace penumbra::kernel {

namespace generic {
extern const Variant kVariant;
}
#if defined(__x86_64__)
namespace avx2 {
extern const Variant kVariant;
}
namespace avx512 {
extern const Variant kVariant;
}
#endif

namespace {

struct VariantList {
  std::array<const Variant*, 4> variants{};
  std::size_t count = 0;
};

// What is asked for is what the variants are compiled for, see CMakeLists.txt.
VariantList find_variants() {
  VariantList list;
  list.variants[list.count++] = &generic::kVariant;
#if defined(__x86_64__)
  __builtin_cpu_init();
  const bool v3 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") &&
                  __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2");
  const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                  __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") &&
                  __builtin_cpu_supports("avx512vl");
  if (v3) list.variants[list.count++] = &avx2::kVariant;
  if (v4) list.variants[list.count++] = &avx512::kVariant;
#endif
  return list;
}

const VariantList& variants() {
  static const VariantList list = find_variants();
  return list;
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
  lens.kind = !camera.has_distortion()               ? Lens::Kind::none
              : p.model == DistortionModel::fisheye  ? Lens::Kind::fisheye
              : p.model == DistortionModel::rational ? Lens::Kind::rational
                                                     : Lens::Kind::polynomial;
  lens.max_radius2 = static_cast<float>(camera.max_radius() * camera.max_radius());
  return lens;
}

const Variant& best_variant() {
  return *variants().variants[variants().count - 1];
}

const Variant* const* available_variants() {
  return variants().variants.data();
}

}  // namespace penumbra::kernel
