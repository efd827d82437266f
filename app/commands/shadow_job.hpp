// penumbra shadow: the options, the job they describe, and the result as text and image.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/output/shadow_drawing.hpp"
#include "render/shadow/model_shadow.hpp"

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
  std::optional<ModelPose> model_pose;
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
struct ShadowJob : ModelShadowRequest {
  enum class Format { table, json, svg, png };
  std::filesystem::path output;
  Format format = Format::table;
  std::vector<std::string> warnings;  // options that the technique does not use
};

// Throws CLI::ValidationError for wrong options.
[[nodiscard]] ShadowJob job_from(const ShadowOptions& options);

[[nodiscard]] std::string shadow_json(const ShadowJob& job, const ModelShadow& result);
[[nodiscard]] std::string shadow_table(const ShadowJob& job, const ModelShadow& result);
[[nodiscard]] ShadowDrawing drawing_of(const ShadowJob& job, const ModelShadow& result);

}  // namespace penumbra
