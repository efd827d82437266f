// penumbra shadow: the options, the job they describe, and the result as text and image.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/output/shadow_drawing.hpp"
#include "core/error.hpp"
#include "core/text/enum_names.hpp"
#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/technique.hpp"
#include "render/shadow/casters/shadow_proxy.hpp"
#include "render/shadow/kernels/twist.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// The options as given on the command line.
struct ShadowOptions {
  std::filesystem::path model;
  std::filesystem::path output;
  std::string technique = "layered";
  std::string kernels = "auto";
  std::string light_mode;
  std::vector<std::string> groups;
  std::string proxy = "none";
  std::string up;
  double unit_m = 1.0;
  std::string light_height;
  std::optional<double> light_ratio;
  std::optional<double> umbra_height;
  std::optional<double> workspace_height;
  std::optional<double> magnification;
  std::string pose;
  std::string plane;
  std::string light;
  bool show_kernels = false;
};

// The checked and converted options.
struct ShadowJob {
  enum class Technique { layered, field, simple, hard };
  enum class Format { table, json, svg, png };
  enum class Proxy { none, simplified, from_file };  // mesh that casts instead of the model
  std::filesystem::path model;
  std::filesystem::path output;
  Format format = Format::table;
  Technique technique = Technique::layered;
  KernelSource source = KernelSource::automatic;
  std::filesystem::path kernel_file;  // used instead of `source`
  bool fixed_light = false;
  std::vector<std::string> groups;  // names of groups whose parts are treated as one part
  Proxy proxy = Proxy::none;
  std::filesystem::path proxy_file;
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;  // unit of the model's coordinates [m]
  LayeredConstants constants;
  std::optional<double> workspace_height;  // height that determined the constants [m]
  Placement placement;
  Eigen::Vector3d model_origin = Eigen::Vector3d::Zero();  // set when the model is loaded
  PlaneFrame plane;
  Eigen::Vector4d light = Eigen::Vector4d::Zero();
  bool show_kernels = false;
  std::vector<std::string> warnings;  // options that the technique does not use

  // Returns true if the technique has umbra, middle layer and penumbra instead of one shadow.
  [[nodiscard]] bool has_layers() const {
    return technique == Technique::layered || technique == Technique::field;
  }
};

// Throws CLI::ValidationError for wrong options.
[[nodiscard]] ShadowJob job_from(const ShadowOptions& options);

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

struct ShadowResult {
  std::vector<ShadowDrawing::Layer> layers;  // umbra, middle and penumbra, or one shadow
  LayerOutline object;                       // orthogonal projection of the model onto the plane
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
  std::vector<std::string> warnings;  // without duplicates, in the order they were logged
};

[[nodiscard]] Result<ShadowResult> compute_shadow(const ShadowJob& job);

[[nodiscard]] std::string shadow_json(const ShadowJob& job, const ShadowResult& result);
[[nodiscard]] std::string shadow_table(const ShadowJob& job, const ShadowResult& result);
[[nodiscard]] ShadowDrawing drawing_of(const ShadowJob& job, const ShadowResult& result);

}  // namespace penumbra
