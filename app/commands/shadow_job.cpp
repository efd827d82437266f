#include "app/commands/shadow_job.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>

#include <CLI/Error.hpp>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <sstream>

#include "app/commands/options.hpp"
#include "app/output/output_file.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kPoseOption = "--pose";
constexpr std::string_view kPlaneOption = "--plane";
constexpr std::string_view kLightOption = "--light";

[[noreturn]] void wrong(std::string_view option, const std::string& why) {
  throw CLI::ValidationError(std::string(option), why);
}

template <int kCount>
Eigen::Matrix<double, kCount, 1> numbers_from(std::string_view option, const std::string& text) {
  Eigen::Matrix<double, kCount, 1> numbers;
  std::istringstream words(text);
  std::string word;
  int count = 0;
  while (words >> word) {
    const auto number = parse_number(word);
    if (!number || !std::isfinite(*number)) {
      wrong(option, fmt::format("{}: is not a finite number", word));
    }
    if (count < kCount) numbers[count] = *number;
    ++count;
  }
  if (count != kCount) {
    wrong(option,
          fmt::format("has {} numbers, {} are needed, in one pair of quotes", count, kCount));
  }
  return numbers;
}

LayeredConstants constants_from(const ShadowOptions& options) {
  const bool workspace = options.workspace_height || options.magnification;
  if (workspace) {
    if (!options.workspace_height || !options.magnification) {
      wrong("--workspace-height", "goes together with --magnification; give both");
    }
    if (!options.light_height.empty() || options.light_ratio || options.umbra_height) {
      wrong("--workspace-height", "chooses the light; leave out the options that name it");
    }
    const auto constants =
        layered_constants_for_workspace(*options.workspace_height, *options.magnification);
    if (!constants) wrong("--workspace-height", constants.error().message);
    return *constants;
  }
  if (options.light_ratio && options.umbra_height) {
    wrong("--umbra-height", "stands in place of --light-ratio; give one of the two");
  }
  const LayeredConstants usual;
  double ratio = options.light_ratio.value_or(0.0);
  if (options.light_ratio && !(ratio > 0.0)) {
    wrong("--light-ratio", fmt::format("is {}; give a number above 0", ratio));
  }
  const double umbra = options.umbra_height.value_or(0.0);
  if (options.umbra_height && !(umbra > 0.0)) {
    wrong("--umbra-height", fmt::format("is {}; give metres above 0", umbra));
  }
  double height = usual.light_height;
  if (!options.light_height.empty()) {
    const auto number = parse_number(options.light_height);
    if (!number) {
      wrong("--light-height", fmt::format("{}: is not a number of metres", options.light_height));
    }
    height = *number;
  }
  if (!options.light_ratio && !options.umbra_height && !std::isinf(height)) {
    ratio = usual.light_ratio;
  }
  const auto constants = make_layered_constants(height, ratio, umbra);
  if (!constants) {
    const std::string& message = constants.error().message;
    wrong(options.light_ratio && message.starts_with("light ratio")     ? "--light-ratio"
          : options.umbra_height && message.starts_with("umbra height") ? "--umbra-height"
                                                                        : "--light-height",
          message);
  }
  return *constants;
}

ShadowJob::Format format_of(const std::filesystem::path& output) {
  std::string extension = output.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (extension == ".svg") return ShadowJob::Format::svg;
  if (extension == ".png") return ShadowJob::Format::png;
  // Pipes have any name.
  if (extension == ".json" || is_stream(output)) return ShadowJob::Format::json;
  wrong("--output", fmt::format("{}: is no .json, .svg or .png", output.string()));
}

// Sets the technique and returns where its kernels come from.
std::string take_technique(const ShadowOptions& options, ShadowJob& job) {
  std::string kernels = options.kernels;
  if (options.technique == "simple") {
    job.technique = ShadowJob::Technique::simple;
  } else if (options.technique == "hard") {
    job.technique = ShadowJob::Technique::hard;
    if (options.light.empty()) wrong("--technique", "hard needs --light \"x y z w\"");
    job.light = numbers_from<4>(kLightOption, options.light);
    if (job.light.w() < 0.0 || (job.light.head<3>().isZero(0.0) && job.light.w() == 0.0)) {
      wrong(kLightOption, "give a place (w = 1), or a direction towards the light (w = 0)");
    }
  } else if (options.technique == "cocl") {
    if (kernels != "auto" && kernels != "cocl") {
      wrong("--technique", "cocl uses its own centroid kernels; leave out --kernels");
    }
    kernels = "cocl";
  } else if (options.technique == "field") {
    job.technique = ShadowJob::Technique::field;
    if (kernels != "auto") wrong("--technique", "field needs no kernels; leave out --kernels");
  } else if (options.technique != "layered") {
    wrong("--technique",
          fmt::format("{}: no such technique; known: layered, cocl, field, simple, hard",
                      options.technique));
  }
  if (!options.light.empty() && job.technique != ShadowJob::Technique::hard) {
    wrong(kLightOption, "is for --technique hard; layers take --light-height");
  }
  return kernels;
}

bool has_one_layer(const ShadowJob& job) {
  return job.technique == ShadowJob::Technique::simple ||
         job.technique == ShadowJob::Technique::hard;
}

// Names the options that the technique does not use.
void note_unused_options(const ShadowOptions& options, ShadowJob& job) {
  const bool layered = job.technique == ShadowJob::Technique::layered;
  const bool one_layer = has_one_layer(job);
  const auto no_use = [&](std::string_view option) {
    job.warnings.push_back(
        fmt::format("{}: {} shadows have no use for it", option, options.technique));
  };
  if (one_layer && options.kernels != "auto") no_use("--kernels");
  if (one_layer && !options.light_mode.empty()) no_use("--light-mode");
  if (job.technique == ShadowJob::Technique::field && !options.light_mode.empty() &&
      !job.fixed_light) {
    job.warnings.emplace_back(
        "--light-mode: the light of field shadows has one size; proportional changes nothing");
  }
  if (one_layer && options.names_light()) {
    no_use(!options.light_height.empty() ? "--light-height"
           : options.light_ratio         ? "--light-ratio"
           : options.umbra_height        ? "--umbra-height"
           : options.workspace_height    ? "--workspace-height"
                                         : "--magnification");
  }
  if (options.show_kernels && !layered) no_use("--show-kernels");
  if (options.show_kernels && layered && job.format != ShadowJob::Format::svg &&
      job.format != ShadowJob::Format::png) {
    job.warnings.emplace_back("--show-kernels: is for a picture; give --output FILE.svg or .png");
  }
}

void take_proxy(const ShadowOptions& options, ShadowJob& job) {
  if (options.proxy == "none") return;
  if (job.technique != ShadowJob::Technique::layered) {
    wrong("--proxy", "is for layered shadows; leave it out");
  }
  job.proxy = options.proxy == "auto" ? ShadowJob::Proxy::simplified : ShadowJob::Proxy::from_file;
  if (job.proxy == ShadowJob::Proxy::from_file) job.proxy_file = options.proxy;
}

void take_placement(const ShadowOptions& options, ShadowJob& job) {
  if (!options.pose.empty()) {
    const auto pose = numbers_from<7>(kPoseOption, options.pose);
    const Eigen::Quaterniond rotation(pose[6], pose[3], pose[4], pose[5]);
    if (!(std::abs(rotation.norm() - 1.0) < 0.01)) {
      wrong(kPoseOption, "its last four numbers are no unit quaternion (qx qy qz qw)");
    }
    job.placement = {pose.head<3>(), rotation.normalized(), 1.0};
  }
  if (!options.plane.empty()) {
    const auto plane = numbers_from<6>(kPlaneOption, options.plane);
    if (!(plane.head<3>().stableNorm() > 0.0)) wrong(kPlaneOption, "its normal is zero");
    job.plane = PlaneFrame::make(plane.head<3>().stableNormalized(), plane.tail<3>());
  }
}

}  // namespace

ShadowJob job_from(const ShadowOptions& options) {
  ShadowJob job;
  job.model = options.model;
  job.output = options.output;
  job.show_kernels = options.show_kernels;
  if (!options.output.empty()) job.format = format_of(options.output);
  const std::string kernels = take_technique(options, job);
  const KernelChoice chosen = kernel_choice_from(kernels);
  job.source = chosen.source;
  if (chosen.file) job.kernel_file = *chosen.file;
  if (!options.light_mode.empty()) {
    job.fixed_light = light_mode_choice_from(options.light_mode) == LightMode::fixed;
  }
  note_unused_options(options, job);
  if (job.fixed_light && job.technique == ShadowJob::Technique::layered &&
      job.source == KernelSource::centroid) {
    wrong("--light-mode", "fixed needs kernels with a thickness; cocl has none");
  }
  job.groups = options.groups;
  job.unit_m = options.unit_m;
  take_proxy(options, job);
  if (options.up == "y") job.up = UpAxis::y;
  if (options.up == "z") job.up = UpAxis::z;
  if (!options.up.empty() && options.up != "y" && options.up != "z") {
    wrong("--up", fmt::format("{}: is neither y nor z", options.up));
  }
  if (!has_one_layer(job)) {
    job.constants = constants_from(options);
    job.workspace_height = options.workspace_height;
  }
  take_placement(options, job);
  return job;
}

}  // namespace penumbra
