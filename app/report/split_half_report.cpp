#include "app/report/split_half_report.hpp"

#include <nlohmann/json.hpp>

#include "app/report/residual_report.hpp"
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
    if (e.frames_compared == 0) {
      text += fmt::format("{:<12}{:>10}{:>10}{:>10}{:>12}{:>8}{:>8}\n", name, "-", "-", "-", "-",
                          "-", 0);
      return;
    }
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
  if (report.pooled.frames_compared > 0) {
    text += fmt::format("ratio of a frame: median {:.2f}, above 3 in {:.1f} % of the frames\n",
                        report.pooled.frame_ratio.median, 100.0 * report.pooled.share_above_3);
  }
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
