// The shadow of one model on one plane as outlines, computed without OpenGL. Used by the command
// `shadow` and by the library.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "core/text/enum_names.hpp"
#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/technique.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/kernels/kernel_file.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/layer_polygons.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// The model, its placement, the plane, the light and the technique.
struct ModelShadowRequest {
  enum class Technique { layered, field, simple, hard };
  enum class Proxy { none, simplified, from_file };  // mesh that casts instead of the model
  std::filesystem::path model;                       // also the model's name in messages
  Technique technique = Technique::layered;
  KernelSource source = KernelSource::automatic;
  std::filesystem::path kernel_file;  // used instead of `source`
  // Contents of kernel_file, which is then not read and only a name in messages.
  std::optional<KernelFile> kernels_read;
  bool fixed_light = false;
  std::vector<std::string> groups;  // names of groups whose parts are treated as one part
  Proxy proxy = Proxy::none;
  std::filesystem::path proxy_file;
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;            // unit of the model's coordinates [m]
  std::optional<ModelPose> pose;  // nullopt: the rest pose
  LayeredConstants constants;
  std::optional<double> workspace_height;  // height that determined the constants [m]
  Placement placement;                     // T_world_object
  PlaneFrame plane;
  Eigen::Vector4d light = Eigen::Vector4d::Zero();  // hard: a position (w = 1) or direction (w = 0)
  bool show_kernels = false;                        // fills ModelShadow::kernels
  // Called once for each different warning, before the calculation ends. May be empty.
  std::function<void(const std::string&)> on_warning;

  // Returns true if the technique has umbra, middle layer and penumbra instead of one shadow.
  [[nodiscard]] bool has_layers() const {
    return technique == Technique::layered || technique == Technique::field;
  }
};

inline constexpr auto kLayerNames =
    std::to_array<EnumName<ShadowLayer>>({{ShadowLayer::umbra, "umbra"},
                                          {ShadowLayer::middle, "middle"},
                                          {ShadowLayer::penumbra, "penumbra"}});

// Comparison of the proxy with the mesh.
struct ProxyResult {
  std::size_t faces = 0;  // 0 without a proxy
  bool used = false;
  ProxyAgreement agreement;
};

struct ModelShadow {
  std::vector<NamedOutline> layers;  // umbra, middle and penumbra, or one shadow
  LayerOutline object;               // orthogonal projection of the model onto the plane
  std::vector<Eigen::Vector2d> kernels;
  std::string kernel_source = "none";
  double kernel_ms = 0.0;
  std::size_t twisted_faces = 0;
  std::optional<TwistReport> twists;
  std::optional<double>
      overshoot_fraction;  // fraction of the penumbra; proportional light mode only
  std::size_t faces = 0;
  std::size_t vertices = 0;
  std::size_t parts = 0;
  ProxyResult proxy;
  std::vector<std::string> warnings;         // without duplicates, in the order they were reported
  std::vector<std::filesystem::path> files;  // of the model and its proxy
};

// Loads the model, and the kernels if the request names a file, and computes the shadow.
[[nodiscard]] Result<ModelShadow> compute_shadow(const ModelShadowRequest& request);
// Computes the shadow of a model that is in memory.
[[nodiscard]] Result<ModelShadow> compute_shadow(const ModelShadowRequest& request, Model model);

}  // namespace penumbra
