#include "app/commands/shadow_job.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <sstream>

#include "app/commands/options.hpp"
#include "app/output/output_file.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

template <int kCount>
Eigen::Matrix<double, kCount, 1> numbers_from(const char* option, const std::string& text) {
  Eigen::Matrix<double, kCount, 1> numbers;
  std::istringstream words(text);
  std::string word;
  int count = 0;
  while (words >> word) {
    const auto number = parse_number(word);
    if (!number || !std::isfinite(*number)) {
      usage_error(option, "{}: is not a finite number", word);
    }
    if (count < kCount) numbers[count] = *number;
    ++count;
  }
  if (count != kCount) {
    usage_error(option, "has {} numbers, {} are needed, in one pair of quotes", count, kCount);
  }
  return numbers;
}

LayeredConstants constants_from(const ShadowOptions& options) {
  if (options.workspace_height || options.magnification) {
    if (!options.workspace_height || !options.magnification) {
      usage_error("--workspace-height", "goes together with --magnification; give both");
    }
    if (!options.light_height.empty() || options.light_ratio || options.umbra_height) {
      usage_error("--workspace-height", "chooses the light; leave out the options that name it");
    }
    const auto constants =
        layered_constants_for_workspace(*options.workspace_height, *options.magnification);
    if (!constants) usage_error("--workspace-height", "{}", constants.error().message);
    return *constants;
  }
  if (options.light_ratio && options.umbra_height) {
    usage_error("--umbra-height", "replaces --light-ratio; give one of the two");
  }
  const LayeredConstants defaults;
  double ratio = options.light_ratio.value_or(0.0);
  if (options.light_ratio && !(ratio > 0.0)) {
    usage_error("--light-ratio", "is {}; give a number above 0", ratio);
  }
  const double umbra = options.umbra_height.value_or(0.0);
  if (options.umbra_height && !(umbra > 0.0)) {
    usage_error("--umbra-height", "is {}; give metres above 0", umbra);
  }
  double height = defaults.light_height;
  if (!options.light_height.empty()) {
    const auto number = parse_number(options.light_height);
    if (!number || std::isnan(*number)) {
      usage_error("--light-height", "{}: is not a number of metres", options.light_height);
    }
    height = *number;
  }
  if (!options.light_ratio && !options.umbra_height && !std::isinf(height)) {
    ratio = defaults.light_ratio;
  }
  const auto constants = make_layered_constants(height, ratio, umbra);
  if (!constants) {
    const std::string& message = constants.error().message;
    const bool ratio_is_wrong = options.light_ratio && message.starts_with("light ratio");
    const bool umbra_is_wrong = options.umbra_height && message.starts_with("umbra height");
    usage_error(ratio_is_wrong   ? "--light-ratio"
                : umbra_is_wrong ? "--umbra-height"
                                 : "--light-height",
                "{}", message);
  }
  return *constants;
}

ShadowJob::Format format_of(const std::filesystem::path& output) {
  if (output.empty()) return ShadowJob::Format::table;
  const std::string extension = lower_extension(output);
  if (extension == ".svg") return ShadowJob::Format::svg;
  if (extension == ".png") return ShadowJob::Format::png;
  if (extension == ".json" || is_stream(output)) return ShadowJob::Format::json;
  usage_error("--output", "{}: is not .json, .svg or .png; choose one of them", output.string());
}

// Sets the technique and returns the kernel source as text.
std::string apply_technique(const ShadowOptions& options, ShadowJob& job) {
  std::string kernels = options.kernels;
  if (options.technique == "simple") {
    job.technique = ShadowJob::Technique::simple;
  } else if (options.technique == "hard") {
    job.technique = ShadowJob::Technique::hard;
    if (options.light.empty()) usage_error("--technique", "hard needs --light \"x y z w\"");
    job.light = numbers_from<4>("--light", options.light);
    if (job.light.w() < 0.0 || (job.light.head<3>().isZero(0.0) && job.light.w() == 0.0)) {
      usage_error("--light", "give a place (w = 1), or a direction towards the light (w = 0)");
    }
  } else if (options.technique == "cocl") {
    if (kernels != "auto" && kernels != "cocl") {
      usage_error("--technique", "cocl uses its own centroid kernels; leave out --kernels");
    }
    kernels = "cocl";
  } else if (options.technique == "field") {
    job.technique = ShadowJob::Technique::field;
    if (kernels != "auto")
      usage_error("--technique", "field needs no kernels; leave out --kernels");
  } else if (options.technique != "layered") {
    usage_error("--technique", "{}: no such technique; known: layered, cocl, field, simple, hard",
                options.technique);
  }
  if (!options.light.empty() && job.technique != ShadowJob::Technique::hard) {
    usage_error("--light", "is for --technique hard; layers take --light-height");
  }
  return kernels;
}

void note_unused_options(const ShadowOptions& options, ShadowJob& job) {
  const bool layered = job.technique == ShadowJob::Technique::layered;
  const auto no_use = [&](bool given, std::string_view option) {
    if (!given) return false;
    job.warnings.push_back(
        fmt::format("{}: has no effect with {} shadows", option, options.technique));
    return true;
  };
  if (!job.has_layers()) {
    no_use(options.kernels != "auto", "--kernels");
    no_use(!options.light_mode.empty(), "--light-mode");
    // Warns only of the first option that selects the light.
    (void)(no_use(!options.light_height.empty(), "--light-height") ||
           no_use(options.light_ratio.has_value(), "--light-ratio") ||
           no_use(options.umbra_height.has_value(), "--umbra-height") ||
           no_use(options.workspace_height.has_value(), "--workspace-height") ||
           no_use(options.magnification.has_value(), "--magnification"));
  } else if (!layered && !options.light_mode.empty() && !job.fixed_light) {
    job.warnings.emplace_back(
        "--light-mode: the light of field shadows has one size; proportional changes nothing");
  }
  no_use(options.show_kernels && !layered, "--show-kernels");
  if (options.show_kernels && layered && job.format != ShadowJob::Format::svg &&
      job.format != ShadowJob::Format::png) {
    job.warnings.emplace_back("--show-kernels: is for an image; give --output FILE.svg or .png");
  }
}

void apply_proxy(const ShadowOptions& options, ShadowJob& job) {
  if (options.proxy == "none") return;
  if (job.technique != ShadowJob::Technique::layered) {
    usage_error("--proxy", "is for layered shadows; leave it out");
  }
  job.proxy = options.proxy == "auto" ? ShadowJob::Proxy::simplified : ShadowJob::Proxy::from_file;
  if (job.proxy == ShadowJob::Proxy::from_file) job.proxy_file = options.proxy;
}

void apply_placement(const ShadowOptions& options, ShadowJob& job) {
  if (!options.pose.empty()) {
    const auto pose = numbers_from<7>("--pose", options.pose);
    const Eigen::Quaterniond rotation(pose[6], pose[3], pose[4], pose[5]);
    if (!(std::abs(rotation.norm() - 1.0) < 0.01)) {
      usage_error("--pose", "its last four numbers are no unit quaternion (qx qy qz qw)");
    }
    job.placement = {pose.head<3>(), rotation.normalized(), 1.0};
  }
  if (!options.plane.empty()) {
    const auto plane = numbers_from<6>("--plane", options.plane);
    if (!(plane.head<3>().stableNorm() > 0.0)) usage_error("--plane", "its normal is zero");
    job.plane = PlaneFrame::make(plane.head<3>().stableNormalized(), plane.tail<3>());
  }
}

}  // namespace

ShadowJob job_from(const ShadowOptions& options) {
  ShadowJob job;
  job.model = options.model;
  job.output = options.output;
  job.show_kernels = options.show_kernels;
  job.format = format_of(options.output);
  const std::string kernels = apply_technique(options, job);
  const KernelChoice chosen = kernel_choice_from(kernels);
  job.source = chosen.source;
  if (chosen.file) job.kernel_file = *chosen.file;
  if (!options.light_mode.empty()) {
    const auto mode = value_named(kLightModeNames, options.light_mode);
    if (!mode) {
      usage_error("--light-mode", "{}: no such mode; known: proportional, fixed",
                  options.light_mode);
    }
    job.fixed_light = mode == LightMode::fixed;
  }
  note_unused_options(options, job);
  if (job.fixed_light && job.technique == ShadowJob::Technique::layered &&
      job.source == KernelSource::centroid) {
    usage_error("--light-mode", "fixed needs kernels with a thickness; cocl has none");
  }
  job.groups = options.groups;
  job.unit_m = options.unit_m;
  job.pose = options.model_pose;
  apply_proxy(options, job);
  if (options.up == "y") job.up = UpAxis::y;
  if (options.up == "z") job.up = UpAxis::z;
  if (!options.up.empty() && options.up != "y" && options.up != "z") {
    usage_error("--up", "{}: is neither y nor z", options.up);
  }
  if (job.has_layers()) {
    job.constants = constants_from(options);
    job.workspace_height = options.workspace_height;
  }
  apply_placement(options, job);
  return job;
}

}  // namespace penumbra
