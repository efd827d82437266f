// The options of penumbra shadow and the job that they describe.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "render/model/model.hpp"
#include "render/scene/plane_frame.hpp"
#include "render/scene/scene.hpp"
#include "render/scene/technique.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {

// The options as they are typed.
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

  [[nodiscard]] bool names_light() const {
    return !light_height.empty() || light_ratio || umbra_height || workspace_height ||
           magnification;
  }
};

// The options once they make sense.
struct ShadowJob {
  enum class Technique { layered, field, simple, hard };
  enum class Format { table, json, svg, png };
  enum class Proxy { none, simplified, from_file };  // mesh that casts in place of the model
  std::filesystem::path model;
  std::filesystem::path output;
  Format format = Format::table;
  Technique technique = Technique::layered;
  KernelSource source = KernelSource::automatic;
  std::filesystem::path kernel_file;  // in place of the source
  bool fixed_light = false;
  std::vector<std::string> groups;  // of parts that are one
  Proxy proxy = Proxy::none;
  std::filesystem::path proxy_file;
  UpAxis up = UpAxis::by_format;
  double unit_m = 1.0;  // of the model's coordinates
  LayeredConstants constants;
  std::optional<double> workspace_height;  // [m] that the constants were chosen for
  Placement placement;
  Eigen::Vector3d model_origin = Eigen::Vector3d::Zero();  // once it is read; in the placement too
  PlaneFrame plane;
  Eigen::Vector4d light = Eigen::Vector4d::Zero();
  bool show_kernels = false;
  std::vector<std::string> warnings;  // options that this technique has no use for
};

// Throws CLI::ValidationError where the options make no sense.
[[nodiscard]] ShadowJob job_from(const ShadowOptions& options);

}  // namespace penumbra
