// penumbra shadow: the shadow layers of one model on one plane, as numbers or as a picture.

#include <fmt/format.h>

#include <Eigen/Geometry>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <array>
#include <cctype>
#include <chrono>
#include <cmath>
#include <future>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <sstream>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/interrupt.hpp"
#include "app/logging.hpp"
#include "app/output/interruptible.hpp"
#include "app/output/output_file.hpp"
#include "app/output/shadow_picture.hpp"
#include "core/stopwatch.hpp"
#include "core/text.hpp"
#include "render/shadow/caster.hpp"
#include "render/shadow/fixed_light.hpp"
#include "render/shadow/kernel_file.hpp"
#include "render/shadow/kernel_stamp.hpp"
#include "render/shadow/layer_polygons.hpp"
#include "render/shadow/part_groups.hpp"
#include "render/shadow/power_distance.hpp"
#include "render/shadow/projected_shadow.hpp"
#include "render/shadow/shadow_proxy.hpp"
#include "render/shadow/twist.hpp"

namespace penumbra {
namespace {

constexpr std::array<std::pair<ShadowLayer, const char*>, 3> kLayerNames = {
    {{ShadowLayer::umbra, "umbra"},
     {ShadowLayer::middle, "middle"},
     {ShadowLayer::penumbra, "penumbra"}}};
constexpr std::string_view kPoseOption = "--pose";
constexpr std::string_view kPlaneOption = "--plane";
constexpr std::string_view kLightOption = "--light";

struct ShadowOptions {
  std::filesystem::path model;
  std::filesystem::path output;
  std::string technique = "layered";
  std::string kernels = "auto";
  std::string light_mode;
  std::vector<std::string> groups;
  std::string proxy = "none";
  std::string up;
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
  std::filesystem::path model;
  std::filesystem::path output;
  Format format = Format::table;
  Technique technique = Technique::layered;
  KernelSource source = KernelSource::automatic;
  std::filesystem::path kernel_file;  // in place of the source
  bool fixed_light = false;
  std::vector<std::string> groups;  // of parts that are one
  ProxyMode proxy = ProxyMode::none;
  std::filesystem::path proxy_file;
  UpAxis up = UpAxis::by_format;
  LayeredConstants constants;
  std::optional<double> workspace_height;  // [m] that the constants were chosen for
  Placement placement;
  PlaneFrame plane;
  Eigen::Vector4d light = Eigen::Vector4d::Zero();
  bool show_kernels = false;
  std::vector<std::string> warnings;  // options that this technique has no use for
};

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

ShadowJob job_from(const ShadowOptions& options) {
  ShadowJob job;
  job.model = options.model;
  job.output = options.output;
  job.show_kernels = options.show_kernels;
  if (!options.output.empty()) {
    std::string extension = options.output.extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    if (extension == ".json") {
      job.format = ShadowJob::Format::json;
    } else if (extension == ".svg") {
      job.format = ShadowJob::Format::svg;
    } else if (extension == ".png") {
      job.format = ShadowJob::Format::png;
    } else {
      wrong("--output", fmt::format("{}: is no .json, .svg or .png", options.output.string()));
    }
  }
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
      wrong("--technique", "cocl has kernels of its own; leave out --kernels");
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
  const KernelChoice chosen = kernel_choice_from(kernels);
  job.source = chosen.source;
  if (chosen.file) job.kernel_file = *chosen.file;
  if (!options.light_mode.empty()) {
    job.fixed_light = light_mode_choice_from(options.light_mode) == LightMode::fixed;
  }
  const bool layered = job.technique == ShadowJob::Technique::layered;
  const bool one_layer =
      job.technique == ShadowJob::Technique::simple || job.technique == ShadowJob::Technique::hard;
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
  if (job.fixed_light && job.technique == ShadowJob::Technique::layered &&
      job.source == KernelSource::centroid) {
    wrong("--light-mode", "fixed needs kernels with a thickness; cocl has none");
  }
  job.groups = options.groups;
  if (options.proxy != "none") {
    if (job.technique != ShadowJob::Technique::layered) {
      wrong("--proxy", "is for layered shadows; leave it out");
    }
    job.proxy = options.proxy == "auto" ? ProxyMode::automatic : ProxyMode::model;
    if (job.proxy == ProxyMode::model) job.proxy_file = options.proxy;
  }
  if (options.up == "y") job.up = UpAxis::y;
  if (options.up == "z") job.up = UpAxis::z;
  if (!options.up.empty() && options.up != "y" && options.up != "z") {
    wrong("--up", fmt::format("{}: is neither y nor z", options.up));
  }
  if (!one_layer) {
    job.constants = constants_from(options);
    job.workspace_height = options.workspace_height;
  }
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
  return job;
}

// What the proxy does, told in JSON and in the table.
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
};

struct KernelSet {
  ShadowKernels kernels;
  std::string source;
  double time_ms = 0.0;
};

// `stored_source`: of those that came with the mesh, where they may serve.
KernelSet choose_kernels(const ShadowJob& job, const ShadowMesh& mesh, bool from_file,
                         std::optional<KernelSource> stored_source) {
  const Eigen::Vector3d up = up_in_object(job.placement, job.plane);
  KernelSet choice;
  const Stopwatch watch;
  if (from_file) {
    choice.kernels = stored_kernels_of(mesh);
    choice.source = job.kernel_file.string();
    if (!has_stored_kernels_for(mesh, up)) {
      log_warning(
          "{}: its kernels are for up {:.3g},{:.3g},{:.3g} and used as they are; the plane's "
          "normal "
          "is {:.3g},{:.3g},{:.3g} for the object; a .glb with kernels gets new ones",
          job.kernel_file.string(), choice.kernels.up.x(), choice.kernels.up.y(),
          choice.kernels.up.z(), up.x(), up.y(), up.z());
    }
  } else {
    const bool as_stored = stored_source && job.source == KernelSource::automatic;
    const bool stored = as_stored && has_stored_kernels_for(mesh, up);
    const KernelSource source = as_stored ? *stored_source : job.source;
    choice.kernels = stored ? stored_kernels_of(mesh) : generate_kernels(mesh, up, source);
    choice.source = stored ? "stored" : std::string(to_string(source));
  }
  choice.time_ms = watch.elapsed().wall_ms;
  return choice;
}

Result<void> add_layer(ShadowResult& result, const std::string& name,
                       const std::vector<PlanePoint>& triangles) {
  auto outline = union_of_triangles(triangles);
  if (!outline) return fail_in(name, outline.error());
  result.layers.push_back({name, std::move(*outline)});
  return {};
}

// The least and the greatest factor between the plane and the caster's top.
std::pair<double, double> factors_of(std::span<const CasterVertex> vertices,
                                     const LayeredConstants& constants) {
  double top = 0.0;
  for (const CasterVertex& vertex : vertices) top = std::max(top, static_cast<double>(vertex.h));
  double least = 1.0;
  double greatest = 1.0;
  for (const ShadowLayer layer : kShadowLayers) {
    const double s = layer_factor(constants, layer, top);
    least = std::min(least, s);
    greatest = std::max(greatest, s);
  }
  return {least, greatest};
}

// Nothing where the mesh is not worth reducing.
Result<std::optional<ShadowProxy>> make_proxy(const ShadowJob& job, const ShadowMesh& mesh) {
  if (job.proxy == ProxyMode::automatic) return simplified_caster(mesh);
  if (job.proxy == ProxyMode::none) return std::optional<ShadowProxy>();
  const auto model = load_model(job.proxy_file, job.up);
  if (!model) return tl::unexpected(model.error());
  return std::optional<ShadowProxy>(proxy_from_model(mesh, *model));
}

// The plane with its origin under the middle of the caster: near it floats are fine, wherever in
// the world that is.
PlaneFrame plane_under(const ShadowMesh& mesh, const Placement& placement,
                       const PlaneFrame& plane) {
  Eigen::AlignedBox3d box;
  for (const glm::vec3& p : mesh.positions) {
    box.extend(Eigen::Vector3d(static_cast<double>(p.x), static_cast<double>(p.y),
                               static_cast<double>(p.z)));
  }
  if (box.isEmpty()) return plane;
  const Eigen::Vector3d middle = plane.to_plane(placement * box.center());
  PlaneFrame under = plane;
  under.q += middle.x() * plane.e1 + middle.y() * plane.e2;
  return under;
}

// A shadow without an area, and one that lacks what is above the light, are told with their cause.
void warn_of_heights(const ShadowJob& job, std::span<const CasterVertex> vertices,
                     std::span<const std::uint32_t> indices, const ShadowResult& result) {
  double bottom = std::numeric_limits<double>::infinity();
  double top = -bottom;
  for (const std::uint32_t index : indices) {
    const auto h = static_cast<double>(vertices[index].h);
    bottom = std::min(bottom, h);
    top = std::max(top, h);
  }
  const std::string name = job.model.string();
  if (indices.empty()) {
    log_warning("{}: has no face that casts a shadow", name);
    return;
  }
  if (top < 0.0) {  // in contact it still casts
    log_warning("{}: is under the plane (its top at {:.3g} m), so there is no shadow", name, top);
    return;
  }
  const bool layers = job.technique == ShadowJob::Technique::layered ||
                      job.technique == ShadowJob::Technique::field;
  const double reach = layer_height_range(job.constants, ShadowLayer::penumbra).high;
  if (layers && bottom >= reach) {
    log_warning(
        "{}: is {:.3g} m above the plane, too high for a light of H = {:.3g} m, so there is no "
        "shadow; raise --light-height",
        name, bottom, job.constants.light_height);
    return;
  }
  if (layers && top > reach) {
    log_warning(
        "{}: reaches to {:.3g} m above the plane; what is above {:.3g} m is too high for a light "
        "of H = {:.3g} m and casts nothing; raise --light-height",
        name, top, reach, job.constants.light_height);
  }
  // Float heights of vertices: a top that stands exactly at the workspace's is inside.
  if (layers && job.workspace_height && top > *job.workspace_height * (1.0 + 1e-6)) {
    log_warning(
        "{}: reaches to {:.3g} m above the plane, beyond --workspace-height {:g}, and has no umbra "
        "there; give the highest place that objects come to",
        name, top, *job.workspace_height);
  }
  if (job.technique == ShadowJob::Technique::hard && job.light.w() != 0.0) {
    const double light = light_height(job.plane, job.light);
    const double range = hard_shadow_range(job.plane, job.light).high;
    if (light > 0.0 && bottom >= range) {
      log_warning(
          "{}: is {:.3g} m above the plane and the light {:.3g} m, so there is no shadow; raise "
          "--light",
          name, bottom, light);
    } else if (light > 0.0 && top > range) {
      log_warning(
          "{}: reaches to {:.3g} m above the plane, over the light at {:.3g} m; what is above the "
          "light casts nothing; raise --light",
          name, top, light);
    }
  }
  const auto is_empty = [](const auto& layer) { return layer.outline.area <= 0.0; };
  if (job.technique != ShadowJob::Technique::hard &&
      std::all_of(result.layers.begin(), result.layers.end(), is_empty)) {
    log_warning("{}: no layer of its shadow has an area", name);
  }
}

void slide(LayerOutline& outline, const Eigen::Vector2d& by) {
  for (LayerPolygon& polygon : outline.polygons) {
    for (Eigen::Vector2d& p : polygon.outer) p += by;
    for (auto& hole : polygon.holes) {
      for (Eigen::Vector2d& p : hole) p += by;
    }
  }
}

Result<ShadowResult> compute_shadow(const ShadowJob& job) {
  auto model = load_model(job.model, job.up);
  if (!model) return tl::unexpected(model.error());
  bool from_file = false;
  if (!job.kernel_file.empty()) {
    const auto file = load_kernel_file(job.kernel_file);
    if (!file) return tl::unexpected(file.error());
    const auto taken = attach_kernels(*model, *file, job.kernel_file.string());
    if (!taken) return tl::unexpected(taken.error());
    from_file = *taken;
  }
  for (const std::string& warning : model->warnings) log_warning("{}", warning);
  if (const auto checked = check_groups(*model, job.groups); !checked) {
    return fail("{}: {}", job.model.string(), checked.error().message);
  }
  const ShadowMesh mesh = make_shadow_mesh(*model, job.groups);
  const bool layered = job.technique == ShadowJob::Technique::layered;
  if (layered && model->shadow_kernel_up && job.source == KernelSource::automatic &&
      !stored_kernels_fit(*model, mesh, job.groups)) {
    log_warning("{}: its kernels are for other parts than --group names; they are made anew",
                (from_file ? job.kernel_file : job.model).string());
    from_file = false;
  }
  std::optional<KernelSource> stored_source = stored_kernel_source(*model);
  if (layered && job.fixed_light && !mesh.stored_kernels.empty() &&
      job.source == KernelSource::automatic && !have_thickness(stored_kernel_source(*model))) {
    log_warning(
        "{}: its kernels (cocl) have no thickness, which a light of one size needs; they are made "
        "anew",
        (from_file ? job.kernel_file : job.model).string());
    from_file = false;
    stored_source.reset();
  }
  const PlaneFrame plane = plane_under(mesh, job.placement, job.plane);
  ShadowResult result;
  result.faces = mesh.indices.size() / 3;
  result.vertices = mesh.positions.size();
  result.parts = mesh.part_count;
  KernelSet choice;
  if (layered) {
    choice = choose_kernels(job, mesh, from_file, stored_source);
    result.kernel_source = choice.source;
    result.kernel_ms = choice.time_ms;
  } else {
    choice.kernels.kernels = mesh.positions;
  }
  auto vertices = place_caster(mesh, choice.kernels, job.placement, plane);
  const auto whole = vertices;  // a proxy may take their place
  auto object = union_of_triangles(orthogonal_triangles(whole, mesh.indices));
  if (!object) return tl::unexpected(object.error());
  result.object = *object;
  if (job.technique == ShadowJob::Technique::simple) {
    result.layers.push_back({"shadow", std::move(*object)});
  } else if (job.technique == ShadowJob::Technique::hard) {
    const auto triangles = projected_triangles(vertices, mesh.indices, job.light, plane);
    if (triangles.empty() && plane_covector(plane).dot(job.light) <= 0.0) {
      log_warning("the light is in or under the plane, so there is no shadow");
    }
    if (const auto added = add_layer(result, "shadow", triangles); !added) {
      return tl::unexpected(added.error());
    }
  } else if (job.technique == ShadowJob::Technique::field) {
    // With as many cells as the renderer uses: what is written is what is painted.
    const ShadowField field = power_distance_layers(
        vertices, mesh.indices, mesh.part,
        part_lights(part_discs(mesh, up_in_object(job.placement, plane), kHalfFieldCell, false),
                    job.placement, plane),
        job.constants);
    for (const auto& [layer, name] : kLayerNames) {
      if (const auto added = add_layer(result, name, field_triangles(field, layer)); !added) {
        return tl::unexpected(added.error());
      }
    }
  } else {
    const Eigen::Vector3d up = up_in_object(job.placement, plane);
    std::vector<PartDisc> parts;
    if (job.fixed_light) {
      complete_radii(choice.kernels, mesh, up);
      parts = part_discs(mesh, up);
    }
    const auto proxy = make_proxy(job, mesh);
    if (!proxy) return tl::unexpected(proxy.error());
    if (*proxy) {
      const ProxyUse use{job.constants,
                         job.fixed_light ? LightMode::fixed : LightMode::proportional,
                         job.placement.scale};
      // For the tilt of this shadow, which stored kernels are near.
      ShadowKernels at_tilt = choice.kernels;
      at_tilt.up = up;
      result.proxy.agreement = compare_with_proxy(mesh, at_tilt, parts, **proxy, use, true);
      result.proxy.faces = (*proxy)->mesh.indices.size() / 3;
      result.proxy.used = result.proxy.agreement.kept();
    }
    const bool reduced = result.proxy.used;
    const ShadowMesh& caster = reduced ? (*proxy)->mesh : mesh;
    if (reduced) choice.kernels = carried_kernels(**proxy, choice.kernels);
    if (reduced) vertices = place_caster(caster, choice.kernels, job.placement, plane);
    std::vector<VertexDisc> discs;
    if (job.fixed_light) {
      discs = vertex_discs(caster, choice.kernels, parts, job.placement.scale);
      result.twists = fixed_light_twists(vertices, discs, caster.indices, job.constants);
    } else {
      const auto [least, greatest] = factors_of(vertices, job.constants);
      result.twists = find_twists(vertices, caster.indices, least, greatest);
      ShadowKernels at_tilt = choice.kernels;
      at_tilt.up = up;
      result.spill = layer_spill(caster, at_tilt, greatest);
    }
    result.twisted_faces = result.twists->faces_twisted;
    for (const auto& [layer, name] : kLayerNames) {
      const auto triangles =
          job.fixed_light
              ? fixed_light_triangles(vertices, discs, caster.indices, job.constants, layer)
              : layer_triangles(vertices, caster.indices, job.constants, layer);
      if (const auto added = add_layer(result, name, triangles); !added) {
        return tl::unexpected(added.error());
      }
    }
    if (job.show_kernels) {
      for (const CasterVertex& vertex : vertices) {
        const Eigen::Vector2d k(static_cast<double>(vertex.ku), static_cast<double>(vertex.kv));
        if (k.allFinite()) result.kernels.push_back(k);
      }
      // Vertices that share a kernel give one dot.
      const auto by_place = [](const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
        return a.x() < b.x() || (a.x() == b.x() && a.y() < b.y());
      };
      std::sort(result.kernels.begin(), result.kernels.end(), by_place);
      result.kernels.erase(std::unique(result.kernels.begin(), result.kernels.end()),
                           result.kernels.end());
    }
  }
  warn_of_heights(job, whole, mesh.indices, result);
  const Eigen::Vector2d origin = job.plane.to_plane(plane.q).head<2>();
  slide(result.object, origin);
  for (ShadowPicture::Layer& layer : result.layers) slide(layer.outline, origin);
  for (Eigen::Vector2d& kernel : result.kernels) kernel += origin;
  return result;
}

nlohmann::ordered_json number_or_inf(double value) {
  if (std::isinf(value)) return "inf";
  return value;
}

std::string shadow_json(const ShadowJob& job, const ShadowResult& result) {
  nlohmann::ordered_json json;
  json["H"] = number_or_inf(job.constants.light_height);
  json["a"] = number_or_inf(job.constants.light_ratio);
  if (job.constants.light_ratio > 1.0) {
    json["umbra_height"] = job.constants.umbra_height;
  } else {
    json["umbra_height"] = "inf";  // it never vanishes
  }
  const auto ring_json = [](const std::vector<Eigen::Vector2d>& ring) {
    auto list = nlohmann::ordered_json::array();
    for (const Eigen::Vector2d& p : ring) list.push_back({p.x(), p.y()});
    return list;
  };
  for (const ShadowPicture::Layer& layer : result.layers) {
    auto& layer_json = json["layers"][layer.name];
    layer_json["area"] = layer.outline.area;
    auto polygons = nlohmann::ordered_json::array();
    for (const LayerPolygon& polygon : layer.outline.polygons) {
      nlohmann::ordered_json polygon_json;
      polygon_json["outer"] = ring_json(polygon.outer);
      polygon_json["holes"] = nlohmann::ordered_json::array();
      for (const auto& hole : polygon.holes) polygon_json["holes"].push_back(ring_json(hole));
      polygons.push_back(std::move(polygon_json));
    }
    layer_json["polygons"] = std::move(polygons);
  }
  json["kernels"] = {{"source", result.kernel_source}, {"time_ms", result.kernel_ms}};
  json["twisted_faces"] = result.twisted_faces;
  if (result.twists) {
    json["twists"] = {{"faces_tested", result.twists->faces_tested},
                      {"area_share", result.twists->area_share}};
    if (result.spill) json["twists"]["spill"] = *result.spill;
  }
  if (job.proxy != ProxyMode::none) {
    auto& proxy = json["proxy"];
    proxy["used"] = result.proxy.used;
    proxy["faces"] = result.proxy.faces;
    proxy["of_faces"] = result.faces;
    proxy["least_iou"] = kLeastProxyAgreement;
    auto& heights = proxy["heights"] = nlohmann::ordered_json::array();
    for (std::size_t i = 0; result.proxy.faces > 0 && i < kProxyHeights.size(); ++i) {
      auto& height = heights.emplace_back();
      height["umbra_heights"] = kProxyHeights[i];
      for (std::size_t layer = 0; layer < kLayerNames.size(); ++layer) {
        height["iou"][kLayerNames[layer].second] = result.proxy.agreement.iou[i][layer];
      }
    }
  }
  return json.dump() + "\n";
}

std::string shadow_table(const ShadowJob& job, const ShadowResult& result) {
  std::string table = fmt::format("{}: {} vertices, {} faces\n", job.model.filename().string(),
                                  result.vertices, result.faces);
  if (job.technique == ShadowJob::Technique::layered ||
      job.technique == ShadowJob::Technique::field) {
    table += fmt::format("light: H = {:g} m, a = {:g}, the umbra {}\n", job.constants.light_height,
                         job.constants.light_ratio,
                         job.constants.light_ratio <= 1.0
                             ? "never vanishes"
                             : fmt::format("vanishes at {:g} m", job.constants.umbra_height));
  }
  if (!job.groups.empty()) table += fmt::format("parts: {}\n", result.parts);
  table += "layer      area [cm2]  pieces  holes\n";
  for (const ShadowPicture::Layer& layer : result.layers) {
    std::size_t holes = 0;
    for (const LayerPolygon& polygon : layer.outline.polygons) holes += polygon.holes.size();
    table += fmt::format("{:<9} {:>11.6g} {:>7} {:>6}\n", layer.name, 1e4 * layer.outline.area,
                         layer.outline.polygons.size(), holes);
  }
  if (job.technique == ShadowJob::Technique::layered) {
    table += fmt::format("kernels: {}, {:.2f} ms; twisted faces: {} of {}\n", result.kernel_source,
                         result.kernel_ms, result.twisted_faces,
                         result.proxy.used ? result.proxy.faces : result.faces);
    if (result.twists) {
      table += fmt::format("twisted: {:.2f} % of the area", 100.0 * result.twists->area_share);
      if (result.spill) {
        table += fmt::format("; spill beyond the outline: {:.2f} % of the penumbra",
                             100.0 * *result.spill);
      }
      table += "\n";
    }
  }
  if (job.proxy != ProxyMode::none) {
    table +=
        result.proxy.faces == 0
            ? fmt::format("proxy: none, {} faces are not worth reducing\n", result.faces)
            : fmt::format("proxy: {} faces, its layers agree to {:.4f}: {}\n", result.proxy.faces,
                          result.proxy.agreement.least(), result.proxy.used ? "used" : "not used");
  }
  return table;
}

// Which shadow it is, as pictures of several lie side by side.
std::string technique_words(const ShadowJob& job) {
  switch (job.technique) {
    case ShadowJob::Technique::field:
      return "field shadow";
    case ShadowJob::Technique::simple:
      return "simple shadow";
    case ShadowJob::Technique::hard:
      return "hard shadow";
    case ShadowJob::Technique::layered:
      break;
  }
  std::string words = job.source == KernelSource::centroid ? "COCL shadow" : "layered shadow";
  if (!job.kernel_file.empty()) {
    words += fmt::format(", kernels of {}", job.kernel_file.filename().string());
  } else if (job.source == KernelSource::smooth) {
    words += ", smooth kernels";
  } else if (job.source == KernelSource::per_axis) {
    words += ", per-axis kernels";
  }
  if (job.fixed_light) words += ", one light";
  return words;
}

ShadowPicture picture_of(const ShadowJob& job, const ShadowResult& result) {
  ShadowPicture picture;
  picture.title = fmt::format("{}, {}", job.model.stem().string(), technique_words(job));
  if (job.technique == ShadowJob::Technique::layered ||
      job.technique == ShadowJob::Technique::field) {
    picture.subtitle =
        std::isinf(job.constants.light_height)
            ? fmt::format("light at the zenith, umbra to {:g} m", job.constants.umbra_height)
            : fmt::format("H = {:g} m, a = {:.3g}", job.constants.light_height,
                          job.constants.light_ratio);
  }
  picture.layers.assign(result.layers.rbegin(), result.layers.rend());
  picture.object = result.object;
  picture.kernels = result.kernels;
  return picture;
}

Result<ExitCode> run_shadow(const ShadowJob& job) {
  for (const std::string& warning : job.warnings) log_warning("{}", warning);
  if (job.constants.light_ratio <= 1.0 && (job.technique == ShadowJob::Technique::layered ||
                                           job.technique == ShadowJob::Technique::field)) {
    log_warning("a = {:g}: the umbra never vanishes; the usual light has a > 1",
                job.constants.light_ratio);
  }
  if (job.format == ShadowJob::Format::table) {
    const auto result = compute_shadow(job);
    if (!result) return tl::unexpected(result.error());
    fmt::print("{}", shadow_table(job, *result));
    return ExitCode::success;
  }
  InterruptWatch interrupt;
  interrupt.hold();
  auto output = OutputFile::create(job.output);
  if (!output) return tl::unexpected(output.error());
  auto computing = std::async(std::launch::async, [&job] { return compute_shadow(job); });
  while (!is_done_within(computing, std::chrono::milliseconds(1000), interrupt, *output)) {
  }
  const auto result = computing.get();
  if (!result) return tl::unexpected(result.error());
  if (job.format == ShadowJob::Format::png) {
    if (const auto done = write_shadow_png(output->partial(), picture_of(job, *result)); !done) {
      return output->failed(done.error());
    }
    if (const auto done = output->commit(); !done) return tl::unexpected(done.error());
  } else {
    const std::string text = job.format == ShadowJob::Format::json
                                 ? shadow_json(job, *result)
                                 : shadow_svg(picture_of(job, *result));
    if (const auto done = write_text(*output, text); !done) return tl::unexpected(done.error());
  }
  fmt::print("shadow: {}\n", job.output.string());
  return ExitCode::success;
}

}  // namespace

void add_shadow_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "shadow", "Compute the shadow layers of a model: areas, outlines, a picture");
  add_common_options(*command);
  const auto options = std::make_shared<ShadowOptions>();
  command->add_option("MODEL", options->model, "The model (.glb, .gltf, .obj)")
      ->required()
      ->type_name("FILE");
  command
      ->add_option("--light-height", options->light_height,
                   "Height H of the light over the plane [m] (default: 0.9), or inf together with "
                   "--umbra-height")
      ->type_name("H|inf");
  command
      ->add_option("--light-ratio", options->light_ratio,
                   "Radius of the light over that of the object (default: 3)")
      ->type_name("A");
  command
      ->add_option("--umbra-height", options->umbra_height,
                   "Height at which the umbra vanishes [m], in place of --light-ratio: A = H / HU")
      ->type_name("HU");
  command
      ->add_option("--workspace-height", options->workspace_height,
                   "Highest point that objects take [m]: chooses H and A, with --magnification")
      ->type_name("Z");
  command
      ->add_option("--magnification", options->magnification,
                   "How much larger the middle layer may get there (above 1)")
      ->type_name("M");
  command
      ->add_option("--kernels", options->kernels,
                   "auto (from the silhouette, for each part; those stored in the model where they "
                   "fit), smooth, per-axis, cocl, or a kernel file")
      ->capture_default_str()
      ->type_name("auto|smooth|per-axis|cocl|FILE");
  command
      ->add_option("--light-mode", options->light_mode,
                   "proportional: a light for each part by its thickness; fixed: one size of light")
      ->default_str("proportional")
      ->type_name("proportional|fixed");
  command
      ->add_option("--group", options->groups,
                   "Parts that share one light: all, or a glTF node or mesh or OBJ object by its "
                   "name (* and ? stand for what varies); may be given again for other groups")
      ->allow_extra_args(false)
      ->type_name("all|NAME");
  command
      ->add_option(
          "--proxy", options->proxy,
          "A reduced mesh that casts where its layers agree with the model's to 0.98: auto "
          "(made from the model), none, or a model file")
      ->capture_default_str()
      ->type_name("auto|none|FILE");
  command
      ->add_option("--pose", options->pose,
                   "The object in the world: metres and a unit quaternion (default: as it is)")
      ->type_name("\"tx ty tz qx qy qz qw\"");
  command
      ->add_option("--plane", options->plane,
                   "The plane: its normal, and a point on it (default: 0 0 1 0 0 0)")
      ->type_name("\"nx ny nz px py pz\"");
  command->add_option("--technique", options->technique, "layered, cocl, field, simple, or hard")
      ->capture_default_str()
      ->type_name("TECHNIQUE");
  command
      ->add_option(
          "--light", options->light,
          "The light of a hard shadow: a place (w = 1), or the direction towards it (w = 0)")
      ->type_name("\"x y z w\"");
  command
      ->add_option("--up", options->up,
                   "Which axis of the file points up (default: y for glTF, z for OBJ)")
      ->type_name("y|z");
  command->add_flag("--show-kernels", options->show_kernels, "Kernels as dots in the picture");
  command
      ->add_option("--output", options->output,
                   "Outlines (.json), or a picture (.svg, .png); without it a table is printed")
      ->type_name("FILE");
  command->footer(
      "Example:\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\"\n"
      "  penumbra shadow helicopter.glb --pose \"0 0 0.1 0 0 0 1\" --workspace-height 0.3 "
      "--magnification 1.5 --show-kernels --output layers.svg");
  command->callback([options, &chosen] {
    // Wrong usage ends here.
    const auto job = std::make_shared<ShadowJob>(job_from(*options));
    chosen = [job] { return run_shadow(*job); };
  });
}

}  // namespace penumbra
