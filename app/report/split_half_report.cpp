#include "app/report/split_half_report.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <vector>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

using Json = nlohmann::ordered_json;

Json statistics_json(const Statistics& s) {
  return {{"median", s.median}, {"rmse", s.rmse}, {"p95", s.p95}, {"max", s.max}};
}

// Adds the errors of one split, or of all.
void add_errors(Json& json, const SplitHalfErrors& errors) {
  const auto known = [&](const Json& value) { return errors.frames_compared > 0 ? value : Json(); };
  json["frames_compared"] = errors.frames_compared;
  json["frames_rejected"] = Json::object();
  for (std::size_t i = 0; i < kHalfRejections; ++i) {
    if (errors.frames_rejected[i] == 0) continue;
    json["frames_rejected"][std::string(to_string(static_cast<HalfRejection>(i)))] =
        errors.frames_rejected[i];
  }
  json["split_half_px"] = known(statistics_json(errors.difference_px));
  json["predicted_px"] = known(statistics_json(errors.predicted_px));
  json["ratio"] = known(errors.ratio);
  json["frame_ratio"] = known(statistics_json(errors.frame_ratio));
  json["share_above_3"] = known(errors.share_above_3);
}

Json causes_json(const ResidualCauses& causes) {
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

// Names the focal length only if its difference is significant.
std::string lens_difference(const CauseSizes& sizes) {
  constexpr double kMinFocalFraction = 5e-4;
  const double focal = std::abs(sizes.focal_fraction);
  if (focal < kMinFocalFraction || focal < 2.0 * sizes.focal_sigma)
    return "the distortion or the principal point seems to differ from";
  return fmt::format("the focal length seems {:.1f} % {} than in", 100.0 * focal,
                     sizes.focal_fraction > 0.0 ? "larger" : "smaller");
}

// `given_row_s`: row time in the camera file.
std::string remedy_of(ErrorCause cause, const CauseSizes& sizes, double given_row_s) {
  switch (cause) {
    case ErrorCause::paper:
      return fmt::format("the tags are about {:.1g} mm from where the map has them: penumbra map",
                         1e3 * std::hypot(sizes.off_flat_m, sizes.in_plane_m));
    case ErrorCause::lens:
      return lens_difference(sizes) +
             " the camera file: penumbra calibrate, or penumbra map --refine-camera";
    case ErrorCause::shutter:
      return fmt::format(
          "the rows seem to be exposed {:.1f} us after each other: rolling_shutter_row_s: {:.3g} "
          "in the camera file",
          1e6 * (given_row_s + sizes.row_time_s), given_row_s + sizes.row_time_s);
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
    text += fmt::format("{}: {}\n", to_string(cause), remedy_of(cause, causes.sizes, given_row_s));
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

}  // namespace

std::string split_half_json(const SplitHalfReport& report) {
  Json json;
  json["recording"] = report.recording.string();
  json["tags"] = {
      {"file", report.tags.file}, {"count", report.tags.count}, {"sizes_m", report.tags.sizes_m}};
  json["frames"] = report.frames;
  add_errors(json, report.pooled);
  json["splits"] = Json::array();
  for (const SplitReport& split : report.splits) {
    Json of_split;
    of_split["halves"] = split.ids;
    add_errors(of_split, split.errors);
    json["splits"].push_back(std::move(of_split));
  }
  json["residuals"] = causes_json(report.causes);
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string split_half_table(const SplitHalfReport& report) {
  std::string text = fmt::format("{:<12}{:>10}{:>10}{:>10}{:>12}{:>8}{:>8}\n", "halves [px]",
                                 "median", "rmse", "p95", "predicted", "ratio", "frames");
  const auto row = [&](const std::string& name, const SplitHalfErrors& e) {
    text += fmt::format("{:<12}{:>10.4f}{:>10.4f}{:>10.4f}{:>12.4f}{:>8.2f}{:>8}\n", name,
                        e.difference_px.median, e.difference_px.rmse, e.difference_px.p95,
                        e.predicted_px.rmse, e.ratio, e.frames_compared);
  };
  for (std::size_t i = 0; i < report.splits.size(); ++i)
    row(fmt::format("split {}", i + 1), report.splits[i].errors);
  row("all", report.pooled);
  text +=
      "  halves: difference of the overlays by two halves of the tags, over sqrt(2)\n"
      "  ratio: rmse / predicted; far above 1, the predicted error is too small for this "
      "recording\n";
  text += fmt::format("ratio of a frame: median {:.2f}, above 3 in {:.1f} % of the frames\n",
                      report.pooled.frame_ratio.median, 100.0 * report.pooled.share_above_3);
  text += fmt::format("frames compared: {} of {} in {} splits\n", report.pooled.frames_compared,
                      report.frames * static_cast<int>(report.splits.size()), report.splits.size());
  for (std::size_t i = 0; i < kHalfRejections; ++i) {
    if (report.pooled.frames_rejected[i] == 0) continue;
    text += fmt::format("rejected: {} ({})\n", report.pooled.frames_rejected[i],
                        text_of(static_cast<HalfRejection>(i)));
  }
  return text + "\n" + causes_table(report.causes, report.given_row_s);
}

}  // namespace penumbra
