#include "app/output/shadow_drawing.hpp"

#include <cairo.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string_view>

#include "core/text/text.hpp"

namespace penumbra {

namespace {

// Colours of the drawing; layer_color() returns those of the layers.
constexpr std::uint32_t kPaper = 0xf4efe6;
constexpr std::uint32_t kInk = 0x2a2622;
constexpr std::uint32_t kObject = 0xc8552b;
constexpr std::uint32_t kKernel = 0x1f6f8b;

std::uint32_t layer_color(std::string_view name) {
  if (name == "penumbra") return 0xd3cbbf;
  if (name == "middle") return 0x9a9189;
  return 0x57504b;  // umbra, or a hard shadow's only layer
}

// Layout of the sheet: positions in [mm], y downwards.
struct Layout {
  double width = 0.0;
  double height = 0.0;
  double map_bottom = 0.0;
  Eigen::Vector2d low = Eigen::Vector2d::Zero();  // plane coordinates of the map's lower left [m]
  double mm_per_m = 1000.0;
  double unit = 1.0;  // unit of font sizes and line widths [mm]

  [[nodiscard]] Eigen::Vector2d on_sheet(const Eigen::Vector2d& p) const {
    return {margin() + mm_per_m * (p.x() - low.x()), map_bottom - mm_per_m * (p.y() - low.y())};
  }
  [[nodiscard]] double margin() const { return 6.0 * unit; }
};

template <class Visit>
void for_each_point(const LayerOutline& outline, Visit visit) {
  for (const LayerPolygon& polygon : outline.polygons) {
    for (const Eigen::Vector2d& p : polygon.outer) visit(p);
  }
}

Layout lay_out(const ShadowDrawing& drawing) {
  Eigen::Vector2d low = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d high = -low;
  const auto grow = [&](const Eigen::Vector2d& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  };
  for (const ShadowDrawing::Layer& layer : drawing.layers) for_each_point(layer.outline, grow);
  for_each_point(drawing.object, grow);
  for (const Eigen::Vector2d& k : drawing.kernels) grow(k);
  if (!low.allFinite()) {
    low.setConstant(-0.05);
    high.setConstant(0.05);
  }
  Eigen::Vector2d size = high - low;
  const double extent = std::max(size.maxCoeff(), 1e-9);
  // Widens the map of a very narrow shadow, so that the legend fits below it.
  const Eigen::Vector2d min_size = size.cwiseMax(0.45 * extent);
  low -= 0.5 * (min_size - size);
  size = min_size;
  Layout layout;
  layout.low = low;
  layout.unit = 10.0 * extent;  // 1 % of the extent, in [mm]
  layout.width = layout.mm_per_m * size.x() + 2.0 * layout.margin();
  layout.map_bottom = layout.mm_per_m * size.y() + layout.margin() + 7.0 * layout.unit;
  layout.height = layout.map_bottom + 14.0 * layout.unit;
  return layout;
}

// Returns the largest of 1, 2, 5 x 10^n that does not exceed `longest_m`.
double scale_bar_m(double longest_m) {
  const double power = std::pow(10.0, std::floor(std::log10(longest_m)));
  for (const double step : {5.0, 2.0}) {
    if (step * power <= longest_m) return step * power;
  }
  return power;
}

std::string length_text(double metres) {
  if (metres >= 0.9999) return fmt::format("{:g} m", metres);
  if (metres >= 0.00999) return fmt::format("{:g} cm", metres * 100.0);
  return fmt::format("{:g} mm", metres * 1000.0);
}

// Interface of the drawing operations of SVG and PNG.
class Canvas {
 public:
  Canvas() = default;
  Canvas(const Canvas&) = delete;
  Canvas& operator=(const Canvas&) = delete;
  virtual ~Canvas() = default;
  virtual void begin_group(const std::string& name) = 0;
  virtual void end_group() = 0;
  virtual void fill(const LayerPolygon& polygon, std::uint32_t color) = 0;
  virtual void stroke(const LayerPolygon& polygon, std::uint32_t color, double width) = 0;
  virtual void dot(const Eigen::Vector2d& at, double radius, std::uint32_t color) = 0;
  virtual void rectangle(double x, double y, double w, double h, std::uint32_t color) = 0;
  virtual void text(double x, double y, double size, const std::string& words) = 0;
};

void draw(Canvas& canvas, const ShadowDrawing& drawing, const Layout& layout) {
  const double unit = layout.unit;
  canvas.rectangle(0.0, 0.0, layout.width, layout.height, kPaper);
  canvas.text(layout.margin(), layout.margin() + 0.5 * unit, 3.0 * unit, drawing.title);
  canvas.text(layout.margin(), layout.margin() + 3.5 * unit, 2.0 * unit, drawing.subtitle);
  for (const ShadowDrawing::Layer& layer : drawing.layers) {
    canvas.begin_group(layer.name);
    for (const LayerPolygon& polygon : layer.outline.polygons) {
      canvas.fill(polygon, layer_color(layer.name));
    }
    canvas.end_group();
  }
  canvas.begin_group("object");
  for (const LayerPolygon& polygon : drawing.object.polygons) {
    canvas.stroke(polygon, kObject, 0.28 * unit);
  }
  canvas.end_group();
  if (!drawing.kernels.empty()) {
    canvas.begin_group("kernels");
    for (const Eigen::Vector2d& k : drawing.kernels) {
      canvas.dot(layout.on_sheet(k), 0.45 * unit, kKernel);
    }
    canvas.end_group();
  }
  canvas.begin_group("legend");
  const double size = 2.2 * unit;
  const double line = layout.map_bottom + 5.5 * unit;
  double x = layout.margin();
  const auto entry = [&](std::uint32_t color, const std::string& label) {
    canvas.rectangle(x, line - 1.7 * unit, 2.0 * unit, 2.0 * unit, color);
    canvas.text(x + 2.7 * unit, line, size, label);
    x += (6.0 + 1.4 * static_cast<double>(label.size())) * unit;
  };
  for (const ShadowDrawing::Layer& layer : drawing.layers) {
    entry(layer_color(layer.name), layer.name);
  }
  entry(kObject, "object");
  if (!drawing.kernels.empty()) entry(kKernel, "kernels");
  const double bar = scale_bar_m(0.3 * (layout.width - 2.0 * layout.margin()) / layout.mm_per_m);
  canvas.rectangle(layout.margin(), line + 4.0 * unit, layout.mm_per_m * bar, 0.5 * unit, kInk);
  canvas.text(layout.margin() + layout.mm_per_m * bar + 1.5 * unit, line + 4.9 * unit, size,
              length_text(bar));
  canvas.end_group();
}

class SvgCanvas final : public Canvas {
 public:
  explicit SvgCanvas(const Layout& layout) : layout_(layout) {
    text_ = fmt::format(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{0:.4g}mm\" height=\"{1:.4g}mm\" "
        "viewBox=\"0 0 {0:.6g} {1:.6g}\" stroke=\"none\">\n",
        layout.width, layout.height);
  }
  void begin_group(const std::string& name) override {
    text_ += fmt::format("<g id=\"{}\">\n", name);
  }
  void end_group() override { text_ += "</g>\n"; }
  void fill(const LayerPolygon& polygon, std::uint32_t color) override {
    text_ += fmt::format("<path fill=\"#{:06x}\" fill-rule=\"evenodd\" d=\"{}\"/>\n", color,
                         path_of(polygon));
  }
  void stroke(const LayerPolygon& polygon, std::uint32_t color, double width) override {
    text_ += fmt::format(
        "<path fill=\"none\" stroke=\"#{:06x}\" stroke-width=\"{:.4g}\" "
        "stroke-linejoin=\"round\" d=\"{}\"/>\n",
        color, width, path_of(polygon));
  }
  void dot(const Eigen::Vector2d& at, double radius, std::uint32_t color) override {
    text_ += fmt::format("<circle cx=\"{:.6g}\" cy=\"{:.6g}\" r=\"{:.4g}\" fill=\"#{:06x}\"/>\n",
                         at.x(), at.y(), radius, color);
  }
  void rectangle(double x, double y, double w, double h, std::uint32_t color) override {
    text_ += fmt::format(
        "<rect x=\"{:.6g}\" y=\"{:.6g}\" width=\"{:.6g}\" height=\"{:.6g}\" fill=\"#{:06x}\"/>\n",
        x, y, w, h, color);
  }
  void text(double x, double y, double size, const std::string& words) override {
    text_ += fmt::format(
        "<text x=\"{:.6g}\" y=\"{:.6g}\" font-size=\"{:.4g}\" font-family=\"sans-serif\" "
        "fill=\"#{:06x}\">{}</text>\n",
        x, y, size, kInk, in_markup(words));
  }
  [[nodiscard]] std::string finish() { return text_ + "</svg>\n"; }

 private:
  [[nodiscard]] std::string path_of(const LayerPolygon& polygon) const {
    std::string path;
    const auto add = [&](const std::vector<Eigen::Vector2d>& ring) {
      char command = 'M';
      for (const Eigen::Vector2d& p : ring) {
        const Eigen::Vector2d s = layout_.on_sheet(p);
        path += fmt::format("{}{:.7g} {:.7g}", command, s.x(), s.y());
        command = 'L';
      }
      path += 'Z';
    };
    add(polygon.outer);
    for (const auto& hole : polygon.holes) add(hole);
    return path;
  }
  const Layout& layout_;
  std::string text_;
};

class CairoCanvas final : public Canvas {
 public:
  CairoCanvas(const Layout& layout, double pixels_per_mm)
      : layout_(layout),
        surface_(cairo_image_surface_create(
                     CAIRO_FORMAT_RGB24, static_cast<int>(std::ceil(layout.width * pixels_per_mm)),
                     static_cast<int>(std::ceil(layout.height * pixels_per_mm))),
                 cairo_surface_destroy),
        cairo_(cairo_create(surface_.get()), cairo_destroy) {
    cairo_set_fill_rule(cairo_.get(), CAIRO_FILL_RULE_EVEN_ODD);
    cairo_set_line_join(cairo_.get(), CAIRO_LINE_JOIN_ROUND);
    cairo_select_font_face(cairo_.get(), "sans-serif", CAIRO_FONT_SLANT_NORMAL,
                           CAIRO_FONT_WEIGHT_NORMAL);
    // Fills the whole image: the sheet may cover the last row and column only in part.
    use(kPaper);
    cairo_paint(cairo_.get());
    cairo_scale(cairo_.get(), pixels_per_mm, pixels_per_mm);
  }
  void begin_group(const std::string&) override {}
  void end_group() override {}
  void fill(const LayerPolygon& polygon, std::uint32_t color) override {
    trace(polygon);
    fill_path(color);
  }
  void stroke(const LayerPolygon& polygon, std::uint32_t color, double width) override {
    trace(polygon);
    use(color);
    cairo_set_line_width(cairo_.get(), width);
    cairo_stroke(cairo_.get());
  }
  void dot(const Eigen::Vector2d& at, double radius, std::uint32_t color) override {
    constexpr double kFullTurn = 6.283185307179586;
    cairo_new_path(cairo_.get());
    cairo_arc(cairo_.get(), at.x(), at.y(), radius, 0.0, kFullTurn);
    fill_path(color);
  }
  void rectangle(double x, double y, double w, double h, std::uint32_t color) override {
    cairo_rectangle(cairo_.get(), x, y, w, h);
    fill_path(color);
  }
  void text(double x, double y, double size, const std::string& words) override {
    cairo_set_font_size(cairo_.get(), size);
    cairo_move_to(cairo_.get(), x, y);
    use(kInk);
    cairo_show_text(cairo_.get(), words.c_str());
  }
  [[nodiscard]] cairo_status_t write(const std::filesystem::path& file) {
    const cairo_status_t drawn = cairo_status(cairo_.get());
    if (drawn != CAIRO_STATUS_SUCCESS) return drawn;
    return cairo_surface_write_to_png(surface_.get(), file.c_str());
  }

 private:
  void fill_path(std::uint32_t color) {
    use(color);
    cairo_fill(cairo_.get());
  }
  void use(std::uint32_t color) {
    const auto channel = [color](unsigned shift) {
      return static_cast<double>((color >> shift) & 0xffU) / 255.0;
    };
    cairo_set_source_rgb(cairo_.get(), channel(16), channel(8), channel(0));
  }
  void trace(const LayerPolygon& polygon) {
    cairo_new_path(cairo_.get());
    const auto add = [&](const std::vector<Eigen::Vector2d>& ring) {
      for (std::size_t i = 0; i < ring.size(); ++i) {
        const Eigen::Vector2d p = layout_.on_sheet(ring[i]);
        (i == 0 ? cairo_move_to : cairo_line_to)(cairo_.get(), p.x(), p.y());
      }
      cairo_close_path(cairo_.get());
    };
    add(polygon.outer);
    for (const auto& hole : polygon.holes) add(hole);
  }
  const Layout& layout_;
  std::unique_ptr<cairo_surface_t, void (*)(cairo_surface_t*)> surface_;
  std::unique_ptr<cairo_t, void (*)(cairo_t*)> cairo_;
};

}  // namespace

std::string shadow_svg(const ShadowDrawing& drawing) {
  const Layout layout = lay_out(drawing);
  SvgCanvas canvas(layout);
  draw(canvas, drawing, layout);
  return canvas.finish();
}

Result<void> write_shadow_png(const std::filesystem::path& file, const ShadowDrawing& drawing) {
  constexpr double kPixelsAcross = 1200.0;
  const Layout layout = lay_out(drawing);
  CairoCanvas canvas(layout, kPixelsAcross / std::max(layout.width, layout.height));
  draw(canvas, drawing, layout);
  const cairo_status_t status = canvas.write(file);
  if (status != CAIRO_STATUS_SUCCESS) {
    return fail("{}: can't be written: {}", file.string(), cairo_status_to_string(status));
  }
  return {};
}

}  // namespace penumbra
