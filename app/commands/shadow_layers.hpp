// The shadow of one model on one plane, computed for penumbra shadow.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "app/commands/shadow_job.hpp"
#include "app/output/shadow_picture.hpp"
#include "core/error.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/kernels/twist.hpp"

namespace penumbra {

inline constexpr std::array<std::pair<ShadowLayer, const char*>, 3> kLayerNames = {
    {{ShadowLayer::umbra, "umbra"},
     {ShadowLayer::middle, "middle"},
     {ShadowLayer::penumbra, "penumbra"}}};

// How a proxy compares with the mesh.
struct ProxyResult {
  std::size_t faces = 0;  // 0: none was made
  bool used = false;
  ProxyAgreement agreement;
};

struct ShadowResult {
  std::vector<ShadowPicture::Layer> layers;  // umbra, middle, penumbra; or shadow
  LayerOutline object;
  std::vector<Eigen::Vector2d> kernels;
  std::string kernel_source = "none";
  double kernel_ms = 0.0;
  std::size_t twisted_faces = 0;
  std::optional<TwistReport> twists;
  std::optional<double> spill;  // of lights in proportion
  std::size_t faces = 0;
  std::size_t vertices = 0;
  std::size_t parts = 0;
  ProxyResult proxy;
  std::vector<std::string> warnings;  // each once, in the order in which they were logged
};

[[nodiscard]] Result<ShadowResult> compute_shadow(const ShadowJob& job);

}  // namespace penumbra
