#include "app/output/split_half_plot.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr double kPlotWidth = 900.0, kPlotHeight = 560.0;
constexpr double kPlotLeft = 70.0, kPlotRight = 20.0;
constexpr double kPlotTop = 60.0, kPlotBottom = 330.0;  // vertical range of the frames' plot
constexpr const char* kPlotPaper = "#ffffff";
constexpr const char* kPlotInk = "#2a2622";
constexpr const char* kGridLines = "#d8d3ca";
constexpr const char* kDifference = "#c8552b";
constexpr const char* kPrediction = "#1f6f8b";

class SvgPlot {
 public:
  void line(double x0, double y0, double x1, double y1, const char* color, double width = 1.0) {
    text_ += fmt::format(
        "<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"{}\" "
        "stroke-width=\"{:g}\"/>\n",
        x0, y0, x1, y1, color, width);
  }
  void dot(double x, double y, const char* color, double opacity) {
    text_ += fmt::format(
        "<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2\" fill=\"{}\" fill-opacity=\"{:g}\"/>\n", x, y,
        color, opacity);
  }
  void box(double x, double y, double w, double h, const char* color, double opacity = 1.0) {
    text_ += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"{}\" "
        "fill-opacity=\"{:g}\"/>\n",
        x, y, std::max(w, 0.0), h, color, opacity);
  }
  void words(double x, double y, const std::string& text, double size = 13.0,
             const char* anchor = "start", const char* color = kPlotInk) {
    text_ += fmt::format(
        "<text x=\"{:.1f}\" y=\"{:.1f}\" font-size=\"{:g}\" font-family=\"sans-serif\" "
        "text-anchor=\"{}\" fill=\"{}\">{}</text>\n",
        x, y, size, anchor, color, in_markup(text));
  }
  void begin_group(const char* name) { text_ += fmt::format("<g id=\"{}\">\n", name); }
  void end_group() { text_ += "</g>\n"; }
  [[nodiscard]] std::string finish() const {
    return fmt::format(
               "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:g}\" height=\"{1:g}\" "
               "viewBox=\"0 0 {0:g} {1:g}\">\n",
               kPlotWidth, kPlotHeight) +
           text_ + "</svg>\n";
  }

 private:
  std::string text_;
};

// Returns the smallest of 1, 2, 5 x 10^n that is not below `value`.
double rounded_up(double value) {
  if (!(value > 0.0)) return 1.0;
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  for (const double step : {1.0, 2.0, 5.0}) {
    if (value <= step * power * (1.0 + 1e-9)) return step * power;
  }
  return 10.0 * power;
}

// Axis whose top shows nearly all differences; larger ones are drawn at the top.
double top_of(const SplitHalfReport& report) {
  return rounded_up(1.1 *
                    std::max(report.pooled.difference_px.p95, report.pooled.predicted_px.p95));
}

void draw_frames(SvgPlot& drawing, const SplitHalfReport& report) {
  const double top_px = top_of(report);
  const double per_frame = (kPlotWidth - kPlotLeft - kPlotRight) / std::max(report.frames, 1);
  const auto y_of = [&](double px) {
    return kPlotBottom - (kPlotBottom - kPlotTop) * std::min(px / top_px, 1.0);
  };
  drawing.begin_group("axes");
  constexpr int kLines = 4;
  for (int i = 0; i <= kLines; ++i) {
    const double px = top_px * i / kLines;
    drawing.line(kPlotLeft, y_of(px), kPlotWidth - kPlotRight, y_of(px), kGridLines);
    drawing.words(kPlotLeft - 8.0, y_of(px) + 4.0, fmt::format("{:.3g} px", px), 12.0, "end");
  }
  drawing.words(kPlotLeft, kPlotBottom + 18.0, "frame 0", 12.0);
  drawing.words(kPlotWidth - kPlotRight, kPlotBottom + 18.0,
                fmt::format("frame {}", report.frames - 1), 12.0, "end");
  drawing.end_group();
  const auto series = [&](const char* name, const char* color,
                          const std::function<double(const HalfDifference&)>& value) {
    drawing.begin_group(name);
    for (const SplitReport& split : report.splits) {
      for (std::size_t i = 0; i < split.frames.size(); ++i) {
        if (split.frames[i].rejection) continue;
        drawing.dot(kPlotLeft + per_frame * (static_cast<double>(i) + 0.5),
                    y_of(value(split.frames[i])), color, 0.6);
      }
    }
    drawing.end_group();
  };
  series("prediction", kPrediction, [](const HalfDifference& f) { return f.predicted_px; });
  series("difference", kDifference, [](const HalfDifference& f) { return f.difference_px; });
}

void draw_causes(SvgPlot& drawing, const ResidualCauses& causes) {
  constexpr double kFirstBar = 400.0, kBar = 20.0, kBetween = 34.0, kBarLeft = 140.0;
  constexpr double kFull = kPlotWidth - kBarLeft - 190.0;
  drawing.begin_group("residuals");
  if (causes.frames == 0) {
    drawing.words(kPlotLeft, kFirstBar, "residuals: too few tags or frames to test");
    drawing.end_group();
    return;
  }
  drawing.words(kPlotLeft, kFirstBar - 14.0,
                fmt::format("squared residuals of the corners ({:.3f} px RMS): explained alone "
                            "(light), by no other cause (dark)",
                            causes.rms_px));
  double y = kFirstBar;
  const auto bar = [&](std::string_view name, double light, double dark, double px) {
    drawing.box(kBarLeft, y, kFull, kBar, kGridLines, 0.5);
    drawing.box(kBarLeft, y, kFull * std::clamp(light, 0.0, 1.0), kBar, kPrediction, 0.4);
    drawing.box(kBarLeft, y, kFull * std::clamp(dark, 0.0, 1.0), kBar, kPrediction);
    drawing.words(kBarLeft - 10.0, y + 15.0, std::string(name), 13.0, "end");
    drawing.words(kBarLeft + kFull + 10.0, y + 15.0,
                  fmt::format("{:.0f} %, {:.3f} px", 100.0 * std::max(light, 0.0), px));
    y += kBetween;
  };
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    const CauseEvidence& evidence = causes.evidence[i];
    bar(to_string(static_cast<ErrorCause>(i)), evidence.alone, evidence.unique, evidence.alone_px);
  }
  bar("noise", 1.0 - causes.explained, 0.0, causes.noise_px);
  drawing.end_group();
}

}  // namespace

std::string split_half_svg(const SplitHalfReport& report) {
  SvgPlot drawing;
  drawing.box(0.0, 0.0, kPlotWidth, kPlotHeight, kPlotPaper);
  drawing.words(
      kPlotLeft, 24.0,
      fmt::format("{}: split halves, {} splits", report.recording.string(), report.splits.size()),
      16.0);
  drawing.words(kPlotLeft, 46.0,
                fmt::format("difference / √2: median {:.3f}, RMS {:.3f} px",
                            report.pooled.difference_px.median, report.pooled.difference_px.rmse),
                13.0, "start", kDifference);
  drawing.words(kPlotLeft + 330.0, 46.0,
                fmt::format("predicted: RMS {:.3f} px; ratio {:.2f}",
                            report.pooled.predicted_px.rmse, report.pooled.ratio),
                13.0, "start", kPrediction);
  draw_frames(drawing, report);
  draw_causes(drawing, report.causes);
  return drawing.finish();
}

}  // namespace penumbra
