#include "app/report/residual_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <functional>
#include <vector>

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

std::string size_text(ErrorCause cause, const CauseSizes& sizes) {
  switch (cause) {
    case ErrorCause::paper:
      return fmt::format("tags {:.2f} mm RMS off the map's plane, {:.2f} mm within it",
                         1e3 * sizes.off_flat_m, 1e3 * sizes.in_plane_m);
    case ErrorCause::lens:
      return fmt::format(
          "focal length {:+.2f} +- {:.2f} %, centre ({:+.1f}, {:+.1f}) px, radial {:+.1f} px at "
          "the "
          "side",
          100.0 * sizes.focal_fraction, 100.0 * sizes.focal_sigma, sizes.centre_px.x(),
          sizes.centre_px.y(), sizes.radial_px);
    case ErrorCause::shutter:
      return fmt::format("row time {:+.1f} +- {:.1f} us", 1e6 * sizes.row_time_s,
                         1e6 * sizes.row_time_sigma_s);
  }
  return {};
}

// Names of the causes that explain the same part of the residuals, the best one first: "lens or
// paper".
std::string possible_causes(const ResidualCauses& causes) {
  std::vector<ErrorCause> possible;
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    if (causes.evidence[i].possible) possible.push_back(static_cast<ErrorCause>(i));
  }
  std::ranges::sort(possible, std::greater(),
                    [&](ErrorCause cause) { return causes.of(cause).alone; });
  std::string names;
  for (const ErrorCause cause : possible)
    names += fmt::format("{}{}", names.empty() ? "" : " or ", to_string(cause));
  return names;
}

}  // namespace

nlohmann::ordered_json causes_json(const ResidualCauses& causes) {
  if (causes.frames == 0) return {};
  Json json = {{"frames", causes.frames},     {"corners", causes.corners},
               {"outliers", causes.outliers}, {"rms_px", causes.rms_px},
               {"noise_px", causes.noise_px}, {"explained", causes.explained}};
  json["overlay_px"] = causes.overlay_px;
  json["overlay_sigma_px"] = causes.overlay_sigma_px;
  // Sizes are unknown where a cause explains nothing.
  const auto known = [&](ErrorCause cause, const Json& value) {
    const CauseEvidence& evidence = causes.of(cause);
    return evidence.significant || evidence.possible ? value : Json();
  };
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    const CauseEvidence& evidence = causes.evidence[i];
    const auto cause = static_cast<ErrorCause>(i);
    json[std::string(to_string(cause))] = {
        {"alone", evidence.alone},
        {"unique", evidence.unique},
        {"alone_px", evidence.alone_px},
        {"unique_px", evidence.unique_px},
        {"significant", evidence.significant},
        {"possible", evidence.possible},
        {"overlay_px", known(cause, evidence.overlay_px)},
        {"overlay_sigma_px", known(cause, evidence.overlay_sigma_px)}};
  }
  const CauseSizes& sizes = causes.sizes;
  json["paper"]["off_flat_mm"] = known(ErrorCause::paper, 1e3 * sizes.off_flat_m);
  json["paper"]["in_plane_mm"] = known(ErrorCause::paper, 1e3 * sizes.in_plane_m);
  json["lens"]["focal_percent"] = known(ErrorCause::lens, 100.0 * sizes.focal_fraction);
  json["lens"]["focal_sigma_percent"] = known(ErrorCause::lens, 100.0 * sizes.focal_sigma);
  json["lens"]["centre_px"] =
      known(ErrorCause::lens, Json{sizes.centre_px.x(), sizes.centre_px.y()});
  json["lens"]["radial_px"] = known(ErrorCause::lens, sizes.radial_px);
  json["shutter"]["row_time_us"] = known(ErrorCause::shutter, 1e6 * sizes.row_time_s);
  json["shutter"]["row_time_sigma_us"] = known(ErrorCause::shutter, 1e6 * sizes.row_time_sigma_s);
  return json;
}

std::string causes_table(const ResidualCauses& causes, double given_row_s) {
  if (causes.frames == 0) {
    return fmt::format(
        "residuals: not tested; that needs {} frames with 3 tags whose cells are "
        "3 px wide or more\n",
        kMinResidualFrames);
  }
  std::string text = fmt::format(
      "residuals of the corners: {:.3f} px RMS in {} frames ({} corners, {} views of a tag "
      "rejected)\n",
      causes.rms_px, causes.frames, causes.corners, causes.outliers);
  text += fmt::format("{:<10}{:>16}{:>20}{:>18}   {}\n", "cause", "by it alone", "only by it",
                      "overlay error", "true minus given value");
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    const CauseEvidence& e = causes.evidence[i];
    const auto cause = static_cast<ErrorCause>(i);
    const bool has_size = e.significant || e.possible;
    text += fmt::format(
        "{:<10}{:>5.1f} % {:>5.3f} px{:>9.1f} % {:>5.3f} px{:>18}   {}\n", to_string(cause),
        100.0 * std::max(e.alone, 0.0), e.alone_px, 100.0 * std::max(e.unique, 0.0), e.unique_px,
        has_size ? fmt::format("{:.2f} +- {:.2f} px", e.overlay_px, e.overlay_sigma_px) : "-",
        has_size ? size_text(cause, causes.sizes) : "-");
  }
  text += fmt::format("{:<10}{:>5.1f} % {:>5.3f} px\n", "noise",
                      100.0 * std::min(1.0 - causes.explained, 1.0), causes.noise_px);
  text +=
      "  by it alone: share of the squared residuals, and their RMS, that this cause explains by "
      "itself\n"
      "  only by it: share that no other cause explains\n"
      "  paper: tags are not where the map has them; lens: it differs from the camera file;\n"
      "  shutter: rows are exposed one after another; noise: what no cause explains\n";
  bool any = false;
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    if (!causes.evidence[i].significant) continue;
    const auto cause = static_cast<ErrorCause>(i);
    text += fmt::format("{}: {}\n", to_string(cause), advice(cause, causes.sizes, given_row_s));
    any = true;
  }
  if (const std::string names = possible_causes(causes); !names.empty()) {
    text += fmt::format(
        "{}: this recording can't tell which; record with more motion and tilt of the camera\n",
        names);
    any = true;
  }
  if (causes.overlay_px > 0.0) {
    text += fmt::format(
        "these causes displace the overlay by about {:.2f} +- {:.2f} px RMS; both halves may share "
        "it\n",
        causes.overlay_px, causes.overlay_sigma_px);
  }
  if (!any)
    text +=
        "no cause is significant: what is left looks like noise; the scale of the sheet as a whole "
        "can't be "
        "tested\n";
  return text;
}

}  // namespace penumbra
