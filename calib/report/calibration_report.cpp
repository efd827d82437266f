#include "calib/report/calibration_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>

#include "core/evaluation/evaluation.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr double kPlotWidth = 480.0;

std::string base64(const std::vector<std::uint8_t>& bytes) {
  constexpr std::string_view kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t three = 0;
    for (std::size_t k = 0; k < 3; ++k)
      three = (three << 8U) | (i + k < bytes.size() ? bytes[i + k] : 0U);
    for (std::size_t k = 0; k < 4; ++k) {
      out += i + k <= bytes.size() ? kDigits[(three >> (18U - 6U * k)) & 63U] : '=';
    }
  }
  return out;
}

// Returns a reduced image as an 8-bit grey BMP, which needs no encoder.
std::string thumbnail(const CalibrationImage& image, int width) {
  if (image.luma.empty()) return {};
  width = std::min(width, image.width);
  const int height = std::max(1, image.height * width / image.width);
  const int stride = (width + 3) / 4 * 4;
  const std::uint32_t offset = 14 + 40 + 1024;
  const ImageView luma = image.image();
  std::vector<std::uint8_t> bmp = {'B', 'M'};
  const auto put = [&](std::uint32_t value, int count) {
    for (int i = 0; i < count; ++i) bmp.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
  };
  // File size, reserved, pixel offset, header size, width, height.
  for (const std::uint32_t field :
       {offset + static_cast<std::uint32_t>(stride * height), 0U, offset, 40U,
        static_cast<std::uint32_t>(width), static_cast<std::uint32_t>(height)}) {
    put(field, 4);
  }
  put(1, 2);                                                                   // planes
  put(8, 2);                                                                   // bits
  for (const std::uint32_t field : {0U, 0U, 0U, 0U, 256U, 0U}) put(field, 4);  // 256 colours
  for (std::uint32_t i = 0; i < 256; ++i) put(i | (i << 8U) | (i << 16U), 4);
  for (int y = height - 1; y >= 0; --y) {  // rows from the bottom
    for (int x = 0; x < stride; ++x) {
      if (x >= width) {
        bmp.push_back(0);
        continue;
      }
      const int x0 = x * image.width / width;
      const int x1 = std::max(x0 + 1, (x + 1) * image.width / width);
      const int y0 = y * image.height / height;
      const int y1 = std::max(y0 + 1, (y + 1) * image.height / height);
      int sum = 0;
      for (int v = y0; v < y1; ++v) {
        for (int u = x0; u < x1; ++u) sum += luma.row(v)[u];
      }
      bmp.push_back(static_cast<std::uint8_t>(sum / ((x1 - x0) * (y1 - y0))));
    }
  }
  return fmt::format("<img alt=\"\" width=\"{}\" height=\"{}\" src=\"data:image/bmp;base64,{}\">",
                     width, height, base64(bmp));
}

// Returns the colour of a fraction: 0 is blue, 0.5 is yellow, 1 is red.
std::string colour(double share) {
  share = std::clamp(share, 0.0, 1.0);
  const auto mix = [&](double a, double b, double c) {
    return share < 0.5 ? a + (b - a) * 2.0 * share : b + (c - b) * (2.0 * share - 1.0);
  };
  return fmt::format("rgb({:.0f},{:.0f},{:.0f})", mix(49, 250, 200), mix(104, 220, 40),
                     mix(170, 100, 40));
}

std::string svg_line(const Eigen::Vector2d& from, const Eigen::Vector2d& to,
                     std::string_view style) {
  return fmt::format("<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" {}/>", from.x(),
                     from.y(), to.x(), to.y(), style);
}

std::string plot_begin(double width, double height) {
  return fmt::format(
      "<svg viewBox=\"0 0 {:.0f} {:.0f}\" width=\"{:.0f}\" height=\"{:.0f}\" "
      "font-size=\"11\" font-family=\"sans-serif\">",
      width, height, width, height);
}

// Begins a plot in image coordinates.
std::string image_plot_begin(const CameraModel& camera) {
  const double height = camera.height() * (kPlotWidth / camera.width());
  return plot_begin(kPlotWidth, height) +
         fmt::format("<rect width=\"{:.0f}\" height=\"{:.1f}\" fill=\"#fafafa\" stroke=\"#888\"/>",
                     kPlotWidth, height);
}

// Plots all corners; if `scale` is positive, plots their residuals enlarged by `scale`.
std::string corners_plot(const CameraCalibration& c, double scale) {
  const double zoom = kPlotWidth / c.solution.camera.width();
  std::string svg = image_plot_begin(c.solution.camera);
  for (const CalibrationImage& image : c.images) {
    if (image.solved < 0) continue;
    const SolvedView& view = c.solution.views[static_cast<std::size_t>(image.solved)];
    for (std::size_t i = 0; i < image.view.corners.size() && i < view.residuals_px.size(); ++i) {
      const Eigen::Vector2d at = zoom * (image.view.corners[i].pixel + Eigen::Vector2d(0.5, 0.5));
      const char* const paint = view.outlier[i] ? "#c33" : "#3169aa";
      svg += scale <= 0.0
                 ? fmt::format("<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"1.6\" fill=\"{}\"/>",
                               at.x(), at.y(), paint)
                 : svg_line(at, at + scale * view.residuals_px[i],
                            fmt::format("stroke=\"{}\" stroke-width=\"0.8\"", paint));
    }
  }
  return svg + "</svg>";
}

std::string heat_map(const CameraModel& camera, int columns, int rows,
                     const std::function<double(int, int)>& value, double largest,
                     const std::string& unit) {
  const double height = kPlotWidth * camera.height() / camera.width();
  std::string svg = plot_begin(kPlotWidth + 70.0, height);
  const double w = kPlotWidth / columns;
  const double h = height / rows;
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const double v = value(i, j);
      svg += fmt::format(
          "<rect x=\"{:.2f}\" y=\"{:.2f}\" width=\"{:.2f}\" height=\"{:.2f}\" fill=\"{}\">"
          "<title>{}</title></rect>",
          i * w, j * h, w + 0.3, h + 0.3, std::isfinite(v) ? colour(v / largest) : "#ccc",
          std::isfinite(v) ? fmt::format("{:.3f} {}", v, unit) : "not known");
    }
  }
  for (int k = 0; k <= 10; ++k) {
    const double y = height * (1.0 - k / 10.0);
    if (k < 10) {
      svg += fmt::format(
          "<rect x=\"{:.0f}\" y=\"{:.1f}\" width=\"14\" height=\"{:.1f}\" fill=\"{}\"/>",
          kPlotWidth + 8.0, height * (1.0 - (k + 1) / 10.0), height / 10.0 + 0.3,
          colour((k + 0.5) / 10.0));
    }
    if (k % 2 == 0) {
      svg += fmt::format("<text x=\"{:.0f}\" y=\"{:.1f}\">{:.2f}</text>", kPlotWidth + 26.0,
                         std::clamp(y + 4.0, 10.0, height - 2.0), largest * k / 10.0);
    }
  }
  return svg + "</svg>";
}

std::string histogram(const CameraCalibration& c) {
  constexpr int kBins = 40;
  const double range = 4.0 * std::max(c.solution.noise_px, 1e-3);  // half width [px]
  std::array<int, kBins> bins{};
  int count = 0;
  for (const SolvedView& view : c.solution.views) {
    for (const Eigen::Vector2d& r : view.residuals_px) {
      for (const double e : {r.x(), r.y()}) {
        const int bin = std::clamp(
            static_cast<int>(std::floor((e + range) / (2.0 * range) * kBins)), 0, kBins - 1);
        ++bins[static_cast<std::size_t>(bin)];
        ++count;
      }
    }
  }
  const double expected =
      count * 2.0 * range / kBins / (c.solution.noise_px * std::sqrt(2.0 * M_PI));
  const double top = std::max<double>(*std::max_element(bins.begin(), bins.end()), expected) * 1.05;
  constexpr double kHeight = 200.0;
  std::string svg = plot_begin(kPlotWidth, kHeight + 20.0);
  for (int i = 0; i < kBins; ++i) {
    const double h = kHeight * bins[static_cast<std::size_t>(i)] / top;
    svg += fmt::format(
        "<rect x=\"{:.1f}\" y=\"{:.1f}\" width=\"{:.1f}\" height=\"{:.1f}\" fill=\"#3169aa\"/>",
        i * kPlotWidth / kBins, kHeight - h, kPlotWidth / kBins - 1.0, h);
  }
  svg += "<polyline fill=\"none\" stroke=\"#c33\" stroke-width=\"1.5\" points=\"";
  for (int i = 0; i <= 80; ++i) {
    const double e = range * (i / 40.0 - 1.0) / std::max(c.solution.noise_px, 1e-9);
    svg += fmt::format("{:.1f},{:.1f} ", i * kPlotWidth / 80.0,
                       kHeight * (1.0 - expected * std::exp(-0.5 * e * e) / top));
  }
  svg += fmt::format(
      "\"/><line x1=\"0\" y1=\"{0}\" x2=\"{1}\" y2=\"{0}\" stroke=\"#888\"/>"
      "<text x=\"0\" y=\"{2}\">{3:.2f} px</text>"
      "<text x=\"{4}\" y=\"{2}\">0</text><text x=\"{1}\" y=\"{2}\" text-anchor=\"end\">{5:.2f} "
      "px</text>",
      kHeight, kPlotWidth, kHeight + 15.0, -range, 0.5 * kPlotWidth, range);
  return svg + "</svg>";
}

// Plots the radial distortion [px] from the principal point to the furthest image corner.
std::string distortion_plot(const CameraModel& camera, const std::optional<CameraModel>& earlier) {
  constexpr double kHeight = 220.0;
  const CameraParameters& p = camera.parameters();
  const Eigen::Vector2d centre(p.cx, p.cy);
  const Eigen::Vector2d corner(p.cx < 0.5 * p.width ? p.width - 1.0 : 0.0,
                               p.cy < 0.5 * p.height ? p.height - 1.0 : 0.0);
  const auto curve = [&](const CameraModel& lens) {
    std::vector<std::pair<double, double>> points;  // radius [px], outward displacement [px]
    for (int i = 0; i <= 60; ++i) {
      const Eigen::Vector2d pixel = centre + (corner - centre) * (i / 60.0);
      const auto direction = camera.unproject(pixel);
      if (!direction) break;
      const CameraParameters& q = lens.parameters();
      const auto seen = lens.project_extended(*direction);
      if (!seen) break;
      const double plain = std::hypot(q.fx * direction->x(), q.fy * direction->y());
      points.emplace_back((pixel - centre).norm(),
                          (*seen - Eigen::Vector2d(q.cx, q.cy)).norm() - plain);
    }
    return points;
  };
  const auto mine = curve(camera);
  const auto other = earlier ? curve(*earlier) : decltype(mine)();
  double low = -0.1;
  double high = 0.1;
  for (const auto* points : {&mine, &other}) {
    for (const auto& [r, d] : *points) {
      low = std::min(low, d);
      high = std::max(high, d);
    }
  }
  const double far = (corner - centre).norm();
  const auto y_of = [&](double d) { return kHeight * (high - d) / (high - low) + 5.0; };
  std::string svg = plot_begin(kPlotWidth, kHeight + 28.0);
  svg += fmt::format("<line x1=\"0\" y1=\"{0:.1f}\" x2=\"{1}\" y2=\"{0:.1f}\" stroke=\"#888\"/>",
                     y_of(0.0), kPlotWidth);
  const auto draw = [&](const auto& points, const char* stroke) {
    svg +=
        fmt::format("<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"2\" points=\"", stroke);
    for (const auto& [r, d] : points)
      svg += fmt::format("{:.1f},{:.1f} ", r / far * kPlotWidth, y_of(d));
    svg += "\"/>";
  };
  if (!other.empty()) draw(other, "#e0a030");
  draw(mine, "#3169aa");
  svg += fmt::format(
      "<text x=\"2\" y=\"14\">{:.1f} px</text><text x=\"2\" y=\"{:.1f}\">{:.1f} px</text>"
      "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{:.0f} px from the principal point</text>",
      high, kHeight + 4.0, low, kPlotWidth, kHeight + 22.0, far);
  return svg + "</svg>";
}

std::string camera_table(const CameraCalibration& c) {
  const CameraParameters& p = c.solution.camera.parameters();
  const int count = coefficient_count(p.model);
  std::string rows;
  const std::array<double, 4> lens = {p.fx, p.fy, p.cx, p.cy};
  constexpr std::array<const char*, 4> kLens = {"fx [px]", "fy [px]", "cx [px]", "cy [px]"};
  for (int i = 0; i < 4 + count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const std::string name = i < 4 ? kLens[k] : coefficient_name(p.model, k - 4);
    const double value = i < 4 ? lens[k] : p.distortion[k - 4];
    const int digits = i < 4 ? 3 : 6;
    const double variance = c.solution.covariance(i, i);
    const bool held = variance == 0.0 && value == 0.0;
    rows += fmt::format(
        "<tr><td>{}</td><td>{:.{}f}</td><td>{}</td></tr>", name, value, held ? 0 : digits,
        held ? "held" : fmt::format("± {:.{}f}", std::sqrt(std::max(variance, 0.0)), digits));
  }
  if (c.tone) {
    rows += fmt::format("<tr><td>tone curve [exponent]</td><td>{:.2f}</td><td>± {:.2f}</td></tr>",
                        c.tone->exponent, c.tone->sigma);
  }
  return fmt::format("<table><tr><th colspan=\"3\">{} {} x {}</th></tr>{}</table>",
                     to_string(p.model), p.width, p.height, rows);
}

// Draws the overlay cube with the uncertainty of its corners.
std::string table_volume_section(const CameraCalibration& c) {
  if (!c.table) return {};
  const CameraModel& camera = c.solution.camera;
  const double zoom = kPlotWidth / camera.width();
  std::string svg = image_plot_begin(camera);
  const auto cube = overlay_cube();
  std::array<Eigen::Vector2d, 8> at;
  for (std::size_t i = 0; i < 8; ++i)
    at[i] = zoom * (c.table->corners_px[i] + Eigen::Vector2d(0.5, 0.5));
  for (std::size_t i = 0; i < 8; ++i) {
    for (std::size_t j = i + 1; j < 8; ++j) {
      // An edge joins corners that differ in one coordinate.
      if (((cube[i] - cube[j]).cwiseAbs().array() > 1e-9).count() != 1) continue;
      svg += svg_line(at[i], at[j], "stroke=\"#888\"");
    }
  }
  std::string rows;
  for (std::size_t i = 0; i < 8; ++i) {
    svg += fmt::format(
        "<circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"3\" fill=\"#3169aa\"/><text x=\"{:.1f}\" "
        "y=\"{:.1f}\">{:.2f}</text>",
        at[i].x(), at[i].y(), std::clamp(at[i].x() + 6.0, 0.0, kPlotWidth - 30.0),
        std::clamp(at[i].y() - 6.0, 12.0, camera.height() * zoom - 4.0), c.table->tracked_px[i]);
    rows += fmt::format(
        "<tr><td>{:+.0f}, {:+.0f}, {:.0f} mm</td><td>{:.3f} px</td><td>{:.3f} px</td></tr>",
        cube[i].x() * 1e3, cube[i].y() * 1e3, cube[i].z() * 1e3, c.table->tracked_px[i],
        c.table->known_pose_px[i]);
  }
  return fmt::format(
      "<div class=\"row\"><div><h2>Over the table</h2><p class=\"note\">Corners of a 0.2 m cube on "
      "the table, seen from {:.2f} m: one sigma of their projections [px], with the pose found "
      "by this lens from the tags under it.</p>{}</svg></div>"
      "<div><h2>Corners</h2><table><tr><th>on the table</th><th>pose found</th>"
      "<th>pose known</th></tr>{}</table></div></div>\n",
      c.table->distance_m, svg, rows);
}

}  // namespace

std::string calibration_report(const CameraCalibration& c, const ReportInput& input) {
  const CameraModel& camera = c.solution.camera;
  std::string html = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Calibration: "
      "{0}</title><style>body{{font:15px/1.45 sans-serif;max-width:1080px;margin:24px "
      "auto;padding:0 16px;"
      "color:#222}}h1{{font-size:22px}}h2{{font-size:17px;margin:28px 0 6px}}"
      ".verdict{{padding:14px 18px;border-left:8px solid;background:#f6f6f6;font-size:17px}}"
      ".good{{border-color:#3a9a4a}}.usable{{border-color:#e0a030}}.poor{{border-color:#c33}}"
      "table{{border-collapse:collapse}}td,th{{padding:3px 10px;border-bottom:1px solid #ddd;"
      "text-align:left;vertical-align:middle}}.row{{display:flex;flex-wrap:wrap;gap:28px}}"
      ".out td{{color:#888}}p.note{{color:#555;margin:2px 0 8px;max-width:480px}}"
      "@media(prefers-color-scheme:dark){{}}</style></head><body>\n"
      "<h1>Calibration: {0}</h1>\n<p class=\"verdict {1}\">{2}</p>\n",
      in_markup(input.title), to_string(c.grade), in_markup(c.verdict));
  if (!c.advice.empty()) {
    html += "<ul>";
    for (const std::string& line : c.advice) html += fmt::format("<li>{}</li>", in_markup(line));
    html += "</ul>\n";
  }
  html += fmt::format(
      "<div class=\"row\"><div>{}</div><div><table>"
      "<tr><td>date</td><td>{}</td></tr><tr><td>target</td><td>{}</td></tr>"
      "<tr><td>views</td><td>{} of {} images</td></tr>"
      "<tr><td>corners</td><td>{}, {} rejected as outliers</td></tr>"
      "<tr><td>residual</td><td>{:.3f} px RMS ({:.3f} px per axis)</td></tr>"
      "<tr><td>held-out views</td><td>{}</td></tr>"
      "<tr><td>projection, 1 sigma</td><td>{:.3f} px mean, {:.3f} px at worst</td></tr>"
      "<tr><td>tilt between views</td><td>up to {:.0f}°</td></tr>"
      "<tr><td>blur of edges</td><td>{:.2f} px (sigma)</td></tr></table></div></div>\n",
      camera_table(c), in_markup(input.date), in_markup(input.target), c.solution.views.size(),
      c.images.size(), c.solution.corners, c.solution.outliers, c.solution.rms_px,
      c.solution.noise_px, c.held_out_px ? fmt::format("{:.3f} px RMS", *c.held_out_px) : "-",
      c.uncertainty.mean_px, c.uncertainty.largest_px, c.tilt_spread_deg, c.blur_px);

  // Limits the colour scale from below, so that a good lens does not look red.
  const double largest = std::isfinite(c.uncertainty.largest_px)
                             ? std::max(c.uncertainty.largest_px, kGoodProjection_px)
                             : kGoodProjection_px;
  const double arrow = 12.0 / std::max(3.0 * c.solution.noise_px, 1e-6);
  html += fmt::format(
      "<div class=\"row\"><div><h2>Projection uncertainty</h2><p class=\"note\">Standard deviation "
      "of projected points [px], from the covariance of the lens and the differences to other "
      "lenses that explain the views as well; up to {} is good.</p>{}</div>"
      "<div><h2>Coverage</h2><p class=\"note\">All corners used; red: outliers. Areas without "
      "corners are extrapolated.</p>{}</div></div>\n"
      "<div class=\"row\"><div><h2>Residuals, {:.0f} times enlarged</h2><p class=\"note\">A "
      "pattern that neighbours share means that another lens model is needed.</p>{}</div>"
      "<div><h2>Histogram of residuals</h2><p class=\"note\">Both axes; red: a normal distribution "
      "of the same spread.</p>{}<h2>Distortion</h2><p class=\"note\">Radial displacement of "
      "a point by the lens{}.</p>{}</div></div>\n",
      kGoodProjection_px,
      heat_map(
          camera, c.uncertainty.columns, c.uncertainty.rows,
          [&](int i, int j) {
            return c.uncertainty.sigma_px[static_cast<std::size_t>(j * c.uncertainty.columns + i)];
          },
          largest, "px"),
      corners_plot(c, 0.0), arrow * camera.width() / kPlotWidth, corners_plot(c, arrow),
      histogram(c), input.earlier ? "; orange: the earlier calibration" : "",
      distortion_plot(camera, input.earlier));

  html += table_volume_section(c);

  if (input.earlier) {
    const ProjectionDifference difference = projection_difference(camera, *input.earlier);
    html += fmt::format(
        "<h2>Compared with {}</h2><p class=\"note\">{:.3f} px apart on average, {:.3f} px at most; "
        "no rotation is fitted.</p>{}\n",
        in_markup(input.earlier_name), difference.mean_px, difference.largest_px,
        heat_map(
            camera, 32, 24,
            [&](int i, int j) {
              const Eigen::Vector2d pixel((i + 0.5) * camera.width() / 32.0 - 0.5,
                                          (j + 0.5) * camera.height() / 24.0 - 0.5);
              const auto direction = camera.unproject(pixel);
              const auto other =
                  direction ? input.earlier->project_extended(*direction) : std::nullopt;
              return other ? (*other - pixel).norm() : std::nan("");
            },
            std::max(difference.largest_px, 1e-6), "px"));
  }

  if (!c.trials.empty()) {
    html +=
        "<h2>Models tried</h2><table><tr><th>lens</th><th>board</th><th>residual</th>"
        "<th>held-out views</th><th></th></tr>";
    for (const ModelTrial& trial : c.trials) {
      html += fmt::format("<tr><td>{}</td><td>{}</td><td>{:.3f} px</td><td>{}</td><td>{}</td></tr>",
                          lens_name(trial), to_string(trial.shape), trial.rms_px,
                          trial.held_out_px ? fmt::format("{:.3f} px", *trial.held_out_px) : "-",
                          trial.chosen             ? "chosen"
                          : trial.non_monotonic_px ? "non-monotonic in the image"
                                                   : "");
    }
    html += "</table>\n";
  }

  html +=
      "<h2>Views</h2><table><tr><th></th><th>image</th><th>corners</th><th>residual</th>"
      "<th>blur</th><th>distance</th><th></th></tr>\n";
  constexpr int kMaxPerReason = 30;
  const auto reported = images_to_report(c.images, kMaxPerReason);
  for (std::size_t i = 0; i < c.images.size(); ++i) {
    const CalibrationImage& image = c.images[i];
    if (image.reason != ImageRejection::no && !reported[i]) continue;
    const std::string more =
        reported[i].value_or(0) > 0 ? fmt::format(" and {} more", *reported[i]) : "";
    const SolvedView* view =
        image.solved < 0 ? nullptr : &c.solution.views[static_cast<std::size_t>(image.solved)];
    html += fmt::format(
        "<tr{}><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></"
        "tr>\n",
        view == nullptr ? " class=\"out\"" : "", thumbnail(image, 120),
        in_markup(image.name) + more,
        image.view.corners.empty() ? "-" : std::to_string(image.view.corners.size()),
        view != nullptr ? fmt::format("{:.3f} px", view->rms_px) : "-",
        image.view.blur_px > 0.0 ? fmt::format("{:.2f} px", image.view.blur_px) : "-",
        view != nullptr ? fmt::format("{:.0f} mm", view->T_board_camera.translation().norm() * 1e3)
                        : "-",
        in_markup(image.left_out));
  }
  html += "</table>\n</body></html>\n";
  return html;
}

}  // namespace penumbra
