#include "app/output/layer_file.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "app/output/output_file.hpp"
#include "core/image_file.hpp"

namespace penumbra {
namespace {

using Rgb = std::array<std::uint8_t, 3>;
constexpr Rgb kPaper = {250, 247, 241};
constexpr Rgb kFootprint = {190, 74, 36};
constexpr Rgb kKernel = {23, 104, 140};
constexpr Rgb kInk = {90, 84, 76};

Rgb color_of(const std::string& layer) {
  if (layer == "penumbra") return {222, 215, 203};
  if (layer == "middle") return {169, 159, 144};
  return {74, 67, 60};  // umbra, and the one layer of a simple shadow
}
std::string hex(const Rgb& color) {
  return fmt::format("#{:02x}{:02x}{:02x}", color[0], color[1], color[2]);
}

// Plane rectangle round everything drawn, with a margin [m].
struct Frame2 {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;

  void add(const LayerOutline& outline) {
    for (const LayerPolygon& polygon : outline.polygons) {
      for (const Eigen::Vector2d& p : polygon.outer) {
        low = low.cwiseMin(p);
        high = high.cwiseMax(p);
      }
    }
  }
  [[nodiscard]] Eigen::Vector2d size() const { return high - low; }
};

Frame2 frame_of(const OfflineShadow& shadow) {
  Frame2 frame;
  for (const NamedLayer& layer : shadow.layers) frame.add(layer.outline);
  frame.add(shadow.footprint);
  if (!(frame.size().minCoeff() >= 0.0)) {  // nothing at all
    frame.low = {-0.05, -0.05};
    frame.high = {0.05, 0.05};
  }
  const double margin = 0.08 * std::max(frame.size().maxCoeff(), 1e-4);
  frame.low.array() -= margin;
  frame.high.array() += margin;
  return frame;
}

// The largest of 1, 2, 5 x 10^n mm that is at most a third of the width.
double scale_bar_mm(double width_mm) {
  const double third = width_mm / 3.0;
  const double decade = std::pow(10.0, std::floor(std::log10(third)));
  for (const double step : {5.0, 2.0, 1.0}) {
    if (step * decade <= third) return step * decade;
  }
  return decade;
}

std::string ring_json(const std::vector<Eigen::Vector2d>& ring) {
  std::string text = "[";
  for (std::size_t i = 0; i < ring.size(); ++i) {
    text += fmt::format("{}[{:.9g}, {:.9g}]", i == 0 ? "" : ", ", ring[i].x(), ring[i].y());
  }
  return text + "]";
}

std::string number_json(double value) {
  return std::isinf(value) ? "\"inf\"" : fmt::format("{:.12g}", value);
}

std::string in_json_quotes(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    if (static_cast<unsigned char>(c) < 0x20) {
      quoted += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      quoted += c;
    }
  }
  return quoted + "\"";
}

std::string path_data(const LayerOutline& outline, const Frame2& frame) {
  std::string data;
  const auto add = [&](const std::vector<Eigen::Vector2d>& ring) {
    for (std::size_t i = 0; i < ring.size(); ++i) {
      data +=
          fmt::format("{}{:.3f} {:.3f}", i == 0 ? "M" : "L", 1e3 * (ring[i].x() - frame.low.x()),
                      1e3 * (frame.high.y() - ring[i].y()));
    }
    data += "Z";
  };
  for (const LayerPolygon& polygon : outline.polygons) {
    add(polygon.outer);
    for (const auto& hole : polygon.holes) add(hole);
  }
  return data;
}

// A picture with 3 x 3 samples per pixel.
class Canvas {
 public:
  static constexpr int kSamples = 3;
  Canvas(const Frame2& frame, int longer_side) : low_(frame.low), high_(frame.high) {
    pixel_ = frame.size().maxCoeff() / longer_side;
    width_ = std::max(1, static_cast<int>(std::ceil(frame.size().x() / pixel_)));
    height_ = std::max(1, static_cast<int>(std::ceil(frame.size().y() / pixel_)));
    samples_.assign(
        static_cast<std::size_t>(width_ * kSamples) * static_cast<std::size_t>(height_ * kSamples),
        kPaper);
  }
  void fill(const LayerPolygon& polygon, const Rgb& color) {
    std::vector<double> crossings;
    const auto rows = static_cast<double>(height_ * kSamples);
    double top = rows;
    double bottom = 0.0;
    for (const Eigen::Vector2d& p : polygon.outer) {
      top = std::min(top, at(p).y());
      bottom = std::max(bottom, at(p).y());
    }
    const int first = std::max(0, static_cast<int>(std::ceil(top - 0.5)));
    const int last = static_cast<int>(std::min(rows - 1.0, std::floor(bottom - 0.5)));
    for (int row = first; row <= last; ++row) {
      crossings.clear();
      add_crossings(polygon.outer, row + 0.5, crossings);
      for (const auto& hole : polygon.holes) add_crossings(hole, row + 0.5, crossings);
      std::sort(crossings.begin(), crossings.end());
      for (std::size_t i = 0; i + 1 < crossings.size(); i += 2) {
        for (int column = std::max(0, static_cast<int>(std::ceil(crossings[i] - 0.5)));
             column < width_ * kSamples && column + 0.5 <= crossings[i + 1]; ++column) {
          samples_[index(column, row)] = color;
        }
      }
    }
  }
  void dot(const Eigen::Vector2d& p, double radius, const Rgb& color) {
    const Eigen::Vector2d c = at(p);
    const double r = radius * kSamples;
    for (int row = static_cast<int>(c.y() - r); row <= static_cast<int>(c.y() + r); ++row) {
      for (int column = static_cast<int>(c.x() - r); column <= static_cast<int>(c.x() + r);
           ++column) {
        if (row < 0 || column < 0 || row >= height_ * kSamples || column >= width_ * kSamples) {
          continue;
        }
        if (std::hypot(column + 0.5 - c.x(), row + 0.5 - c.y()) <= r) {
          samples_[index(column, row)] = color;
        }
      }
    }
  }
  void line(const std::vector<Eigen::Vector2d>& ring, double width, const Rgb& color) {
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Eigen::Vector2d& a = ring[i];
      const Eigen::Vector2d& b = ring[(i + 1) % ring.size()];
      const int steps = 1 + static_cast<int>((at(b) - at(a)).norm());
      for (int step = 0; step <= steps; ++step) {
        dot(a + (b - a) * (static_cast<double>(step) / steps), 0.5 * width, color);
      }
    }
  }
  [[nodiscard]] RgbaImage image() const {
    RgbaImage picture{width_, height_, {}};
    picture.pixels.reserve(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) *
                           4);
    for (int row = 0; row < height_; ++row) {
      for (int column = 0; column < width_; ++column) {
        for (std::size_t channel = 0; channel < 3; ++channel) {
          int sum = 0;
          for (int sy = 0; sy < kSamples; ++sy) {
            for (int sx = 0; sx < kSamples; ++sx) {
              sum += samples_[index(column * kSamples + sx, row * kSamples + sy)][channel];
            }
          }
          picture.pixels.push_back(
              static_cast<std::uint8_t>((sum + kSamples * kSamples / 2) / (kSamples * kSamples)));
        }
        picture.pixels.push_back(255);
      }
    }
    return picture;
  }

 private:
  // In samples, rows downwards.
  [[nodiscard]] Eigen::Vector2d at(const Eigen::Vector2d& p) const {
    return Eigen::Vector2d(p.x() - low_.x(), high_.y() - p.y()) * (kSamples / pixel_);
  }
  [[nodiscard]] std::size_t index(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(width_ * kSamples) +
           static_cast<std::size_t>(column);
  }
  void add_crossings(const std::vector<Eigen::Vector2d>& ring, double y,
                     std::vector<double>& crossings) const {
    for (std::size_t i = 0; i < ring.size(); ++i) {
      const Eigen::Vector2d a = at(ring[i]);
      const Eigen::Vector2d b = at(ring[(i + 1) % ring.size()]);
      if ((a.y() <= y) == (b.y() <= y)) continue;
      crossings.push_back(a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
    }
  }

  Eigen::Vector2d low_, high_;
  double pixel_ = 1.0;  // [m]
  int width_ = 0, height_ = 0;
  std::vector<Rgb> samples_;
};

RgbaImage layers_picture(const OfflineShadow& shadow, const DrawingOptions& options) {
  Canvas canvas(frame_of(shadow), 1024);
  for (auto layer = shadow.layers.rbegin(); layer != shadow.layers.rend(); ++layer) {
    for (const LayerPolygon& polygon : layer->outline.polygons) {
      canvas.fill(polygon, color_of(layer->name));
    }
  }
  for (const LayerPolygon& polygon : shadow.footprint.polygons) {
    canvas.line(polygon.outer, 1.5, kFootprint);
    for (const auto& hole : polygon.holes) canvas.line(hole, 1.5, kFootprint);
  }
  if (options.kernels) {
    for (const Eigen::Vector2d& k : shadow.kernels) canvas.dot(k, 2.0, kKernel);
  }
  return canvas.image();
}

std::string caption(const OfflineShadow& shadow) {
  if (shadow.layers.size() == 1) return "orthogonal shadow";
  std::string text = std::isinf(shadow.constants.light_height)
                         ? fmt::format("light at the zenith, umbra vanishes at {:.4g} m",
                                       shadow.constants.umbra_height)
                         : fmt::format("H {:.4g} m, a {:.4g}, umbra vanishes at {:.4g} m",
                                       shadow.constants.light_height, shadow.constants.light_ratio,
                                       shadow.constants.umbra_height);
  for (const NamedLayer& layer : shadow.layers) {
    text += fmt::format(", {} {:.1f} cm\u00b2", layer.name, 1e4 * layer.outline.area);
  }
  return text;
}

}  // namespace

std::string layers_json(const OfflineShadow& shadow) {
  std::string text = fmt::format("{{\"H\": {}, \"a\": {}, \"umbra_height\": {},\n \"layers\": {{",
                                 number_json(shadow.constants.light_height),
                                 number_json(shadow.constants.light_ratio),
                                 number_json(shadow.constants.umbra_height));
  for (std::size_t i = 0; i < shadow.layers.size(); ++i) {
    const NamedLayer& layer = shadow.layers[i];
    text += fmt::format("{}\n  \"{}\": {{\"area\": {:.12g}, \"polygons\": [", i == 0 ? "" : ",",
                        layer.name, layer.outline.area);
    for (std::size_t p = 0; p < layer.outline.polygons.size(); ++p) {
      const LayerPolygon& polygon = layer.outline.polygons[p];
      text += fmt::format("{}\n   {{\"outer\": {}, \"holes\": [", p == 0 ? "" : ",",
                          ring_json(polygon.outer));
      for (std::size_t h = 0; h < polygon.holes.size(); ++h) {
        text += (h == 0 ? "" : ", ") + ring_json(polygon.holes[h]);
      }
      text += "]}";
    }
    text += "]}";
  }
  text += fmt::format(
      "}},\n \"kernels\": {{\"source\": {}, \"time_ms\": {:.3f}}}, \"twisted_faces\": {}, "
      "\"twisted_area_share\": {:.6g}}}\n",
      in_json_quotes(shadow.kernel_source), shadow.kernel_ms, shadow.twists.faces_twisted,
      shadow.twists.area_share);
  return text;
}

std::string layers_svg(const OfflineShadow& shadow, const DrawingOptions& options) {
  const Frame2 frame = frame_of(shadow);
  const Eigen::Vector2d size = 1e3 * frame.size();
  const double line = 0.004 * size.maxCoeff();
  const double text_size = 0.022 * size.maxCoeff();
  const double total_height = size.y() + 3.2 * text_size;
  std::string svg = fmt::format(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:.3f}mm\" height=\"{1:.3f}mm\" "
      "viewBox=\"0 0 {0:.3f} {1:.3f}\">\n<rect width=\"100%\" height=\"100%\" fill=\"{2}\"/>\n",
      size.x(), total_height, hex(kPaper));
  for (auto layer = shadow.layers.rbegin(); layer != shadow.layers.rend(); ++layer) {
    svg += fmt::format("<path id=\"{}\" fill=\"{}\" fill-rule=\"evenodd\" d=\"{}\"/>\n",
                       layer->name, hex(color_of(layer->name)), path_data(layer->outline, frame));
  }
  svg += fmt::format(
      "<path id=\"object\" fill=\"none\" stroke=\"{}\" stroke-width=\"{:.3f}\" "
      "stroke-linejoin=\"round\" d=\"{}\"/>\n",
      hex(kFootprint), 0.6 * line, path_data(shadow.footprint, frame));
  if (options.kernels && !shadow.kernels.empty()) {
    svg += fmt::format("<g id=\"kernels\" fill=\"{}\">\n", hex(kKernel));
    for (const Eigen::Vector2d& k : shadow.kernels) {
      svg +=
          fmt::format("<circle cx=\"{:.3f}\" cy=\"{:.3f}\" r=\"{:.3f}\"/>\n",
                      1e3 * (k.x() - frame.low.x()), 1e3 * (frame.high.y() - k.y()), 0.55 * line);
    }
    svg += "</g>\n";
  }
  const double bar = scale_bar_mm(size.x());
  const double base = size.y() + 0.6 * text_size;
  svg += fmt::format(
      "<g font-family=\"sans-serif\" font-size=\"{0:.3f}\" fill=\"{1}\">\n"
      "<path d=\"M{2:.3f} {3:.3f}h{4:.3f}\" stroke=\"{1}\" stroke-width=\"{5:.3f}\"/>\n"
      "<text x=\"{6:.3f}\" y=\"{7:.3f}\">{8:g} mm</text>\n"
      "<text x=\"{2:.3f}\" y=\"{9:.3f}\">{10}</text>\n</g>\n</svg>\n",
      text_size, hex(kInk), text_size, base, bar, 0.7 * line, 1.6 * text_size + bar,
      base + 0.35 * text_size, bar, base + 1.8 * text_size, caption(shadow));
  return svg;
}

Result<void> write_layers(const OfflineShadow& shadow, const std::filesystem::path& file,
                          const DrawingOptions& options) {
  const std::string extension = file.extension().string();
  if (extension != ".json" && extension != ".svg" && extension != ".png") {
    return fail("{}: is neither *.json, *.svg nor *.png", file.string());
  }
  auto output = OutputFile::create(file);
  if (!output) return tl::unexpected(output.error());
  if (extension != ".png") {
    return write_text(*output,
                      extension == ".svg" ? layers_svg(shadow, options) : layers_json(shadow));
  }
  const RgbaImage picture = layers_picture(shadow, options);
  if (auto saved = save_png(output->partial(), picture.width, picture.height, picture.pixels);
      !saved) {
    return saved;
  }
  return output->commit();
}

}  // namespace penumbra
