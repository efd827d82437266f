#include "app/report/residual_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
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
          "the side",
          100.0 * sizes.focal_fraction, 100.0 * sizes.focal_sigma, sizes.centre_px.x(),
          sizes.centre_px.y(), sizes.radial_px);
    case ErrorCause::shutter:
      return fmt::format("row time {:+.1f} +- {:.1f} us", 1e6 * sizes.row_time_s,
                         1e6 * sizes.row_time_sigma_s);
  }
  return {};
}

// In the order in which they are to be corrected: a wrong row time spoils a lens, and both a map.
constexpr std::array kCorrectionOrder = {ErrorCause::shutter, ErrorCause::lens, ErrorCause::paper};

// Describes what is significant or possible, one line each, with the remedy.
std::string remedies(const ResidualCauses& causes, double given_row_s) {
  std::string text;
  int significant = 0;
  for (const ErrorCause cause : kCorrectionOrder) {
    if (!causes.of(cause).significant) continue;
    text += fmt::format("{}: {}\n", to_string(cause), advice(cause, causes.sizes, given_row_s));
    ++significant;
  }
  if (significant > 1) text += "correct one cause at a time, in this order, and evaluate again\n";
  std::vector<ErrorCause> possible;
  for (const ErrorCause cause : kCorrectionOrder) {
    if (causes.of(cause).possible) possible.push_back(cause);
  }
  if (possible.size() == 1) {
    text += fmt::format("{} (not certain): {}\n", to_string(possible.front()),
                        advice(possible.front(), causes.sizes, given_row_s));
  } else if (!possible.empty()) {
    // The best explanation first: "lens or paper".
    std::ranges::stable_sort(possible, std::greater(),
                             [&](ErrorCause cause) { return causes.of(cause).alone; });
    std::string names;
    for (const ErrorCause cause : possible)
      names += fmt::format("{}{}", names.empty() ? "" : " or ", to_string(cause));
    text += fmt::format(
        "{}: this recording cannot separate these causes; record with more motion and tilt of the "
        "camera\n",
        names);
  }
  if (text.empty()) {
    text =
        "no cause is significant: what is left looks like noise; the scale of the sheet as a whole "
        "can't be tested\n";
  }
  return text;
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
  text += fmt::format("{:<10}{:>16}{:>20}{:>18}   {}\n", "cause", "alone", "unique",
                      "overlay error", "size (true minus given)");
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
      "  alone: share of the squared residuals, and their RMS, that this cause alone explains\n"
      "  unique: share that no other cause explains; the shares of the causes do not add up\n"
      "  paper: tags are not where the map has them; lens: the lens differs from the camera file;\n"
      "  shutter: rows are exposed one after another; noise: what no cause explains\n";
  text += remedies(causes, given_row_s);
  if (causes.overlay_px > 0.0) {
    text += fmt::format(
        "these causes displace the overlay by about {:.2f} +- {:.2f} px RMS; the difference of the "
        "halves may not show it\n",
        causes.overlay_px, causes.overlay_sigma_px);
  }
  return text;
}

}  // namespace penumbra
