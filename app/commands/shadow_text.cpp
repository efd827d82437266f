#include "app/commands/shadow_job.hpp"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

Json number_or_inf(double value) {
  return std::isinf(value) ? Json("inf") : Json(value);
}

std::string technique_words(const ShadowJob& job) {
  if (job.technique == ShadowJob::Technique::field) return "field shadow";
  if (job.technique == ShadowJob::Technique::simple) return "simple shadow";
  if (job.technique == ShadowJob::Technique::hard) return "hard shadow";
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

}  // namespace

std::string shadow_json(const ShadowJob& job, const ModelShadow& result) {
  Json json;
  json["H"] = number_or_inf(job.constants.light_height);
  json["a"] = number_or_inf(job.constants.light_ratio);
  // If the light is no larger than the object (ratio <= 1), the umbra never vanishes.
  json["umbra_height"] =
      job.constants.light_ratio > 1.0 ? Json(job.constants.umbra_height) : Json("inf");
  const auto ring_json = [](const std::vector<Eigen::Vector2d>& ring) {
    auto list = Json::array();
    for (const Eigen::Vector2d& p : ring) list.push_back({p.x(), p.y()});
    return list;
  };
  for (const ShadowDrawing::Layer& layer : result.layers) {
    auto& layer_json = json["layers"][layer.name];
    layer_json["area"] = layer.outline.area;
    auto polygons = Json::array();
    for (const LayerPolygon& polygon : layer.outline.polygons) {
      Json polygon_json;
      polygon_json["outer"] = ring_json(polygon.outer);
      polygon_json["holes"] = Json::array();
      for (const auto& hole : polygon.holes) polygon_json["holes"].push_back(ring_json(hole));
      polygons.push_back(std::move(polygon_json));
    }
    layer_json["polygons"] = std::move(polygons);
  }
  json["kernels"] = {{"source", as_utf8(result.kernel_source)}, {"time_ms", result.kernel_ms}};
  json["twisted_faces"] = result.twisted_faces;
  if (result.twists) {
    json["twists"] = {{"faces_tested", result.twists->faces_tested},
                      {"area_share", result.twists->area_share}};
    if (result.overshoot_fraction) json["twists"]["spill"] = *result.overshoot_fraction;
  }
  if (job.proxy != ShadowJob::Proxy::none) {
    auto& proxy = json["proxy"];
    proxy["used"] = result.proxy.used;
    proxy["faces"] = result.proxy.faces;
    proxy["of_faces"] = result.faces;
    proxy["least_iou"] = kMinProxyAgreement;
    auto& heights = proxy["heights"] = Json::array();
    for (std::size_t i = 0; result.proxy.faces > 0 && i < kProxyHeights.size(); ++i) {
      auto& height = heights.emplace_back();
      height["umbra_heights"] = kProxyHeights[i];
      for (std::size_t layer = 0; layer < kLayerNames.size(); ++layer) {
        height["iou"][kLayerNames[layer].name] = result.proxy.agreement.iou[i][layer];
      }
    }
  }
  json["warnings"] = Json::array();
  for (const std::string& warning : result.warnings) json["warnings"].push_back(as_utf8(warning));
  return json.dump() + "\n";
}

std::string shadow_table(const ShadowJob& job, const ModelShadow& result) {
  std::string table = fmt::format("{}: {} vertices, {} faces\n", job.model.filename().string(),
                                  result.vertices, result.faces);
  if (job.has_layers()) {
    table +=
        fmt::format("light: height H = {:g} m, radius a = {:g} times the object's; the umbra {}\n",
                    job.constants.light_height, job.constants.light_ratio,
                    job.constants.light_ratio <= 1.0
                        ? "never vanishes"
                        : fmt::format("vanishes at {:g} m", job.constants.umbra_height));
  }
  if (!job.groups.empty()) table += fmt::format("parts: {}\n", result.parts);
  table += "layer      area [cm2]  pieces  holes\n";
  for (const ShadowDrawing::Layer& layer : result.layers) {
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
      if (result.overshoot_fraction) {
        table += fmt::format("; overshoot beyond the outline: {:.2f} % of the penumbra",
                             100.0 * *result.overshoot_fraction);
      }
      table += "\n";
    }
  }
  if (job.proxy != ShadowJob::Proxy::none) {
    table += result.proxy.faces == 0
                 ? fmt::format("proxy: none, {} faces are not worth reducing\n", result.faces)
                 : fmt::format("proxy: {} faces, its layers agree to {:.4f}: {}\n",
                               result.proxy.faces, result.proxy.agreement.min_iou(),
                               result.proxy.used ? "used" : "not used");
  }
  return table;
}

ShadowDrawing drawing_of(const ShadowJob& job, const ModelShadow& result) {
  ShadowDrawing drawing;
  drawing.title = as_utf8(fmt::format("{}, {}", job.model.stem().string(), technique_words(job)));
  if (job.has_layers()) {
    drawing.subtitle =
        std::isinf(job.constants.light_height)
            ? fmt::format("light at the zenith, umbra to {:g} m", job.constants.umbra_height)
            : fmt::format("H = {:g} m, a = {:.3g}", job.constants.light_height,
                          job.constants.light_ratio);
  }
  drawing.layers.assign(result.layers.rbegin(), result.layers.rend());
  drawing.object = result.object;
  drawing.kernels = result.kernels;
  return drawing;
}

}  // namespace penumbra
