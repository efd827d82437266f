// A small rescue helicopter, 0.13 m long, with its nose towards +x, its skids on z = 0 and its
// rotor mast over the origin. The rotors are separate models with their hubs at the origin.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "tools/models/bundled_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {
namespace {

struct Paints {
  int red, white, yellow, glass, dark, metal, lamp, beacon;
};

Paints add_paints(Model& model) {
  Paints p{};
  p.red = add_material(model, "red paint", {0.62F, 0.022F, 0.018F}, 0.0F, 0.32F);
  p.white = add_material(model, "white paint", {0.82F, 0.81F, 0.78F}, 0.0F, 0.38F);
  p.yellow = add_material(model, "yellow paint", {0.90F, 0.50F, 0.02F}, 0.0F, 0.35F);
  p.glass = add_material(model, "glass", {0.012F, 0.020F, 0.030F}, 0.0F, 0.08F);
  p.dark = add_material(model, "dark rubber", {0.022F, 0.023F, 0.026F}, 0.0F, 0.62F);
  p.metal = add_material(model, "metal", {0.50F, 0.51F, 0.53F}, 0.75F, 0.38F);
  p.lamp = add_material(model, "lamp", {0.95F, 0.88F, 0.65F}, 0.0F, 0.2F, {0.45F, 0.38F, 0.20F});
  p.beacon = add_material(model, "beacon", {0.80F, 0.05F, 0.02F}, 0.0F, 0.2F, {0.35F, 0.02F, 0.0F});
  return p;
}

// A cross-section across x: superellipse |y / w|^n + |z / h|^n = 1 between bottom and top [mm].
struct Station {
  double x, top, bottom, half_width, exponent;
};

Station operator*(double f, const Station& s) {
  return {f * s.x, f * s.top, f * s.bottom, f * s.half_width, f * s.exponent};
}
Station operator+(const Station& a, const Station& b) {
  return {a.x + b.x, a.top + b.top, a.bottom + b.bottom, a.half_width + b.half_width,
          a.exponent + b.exponent};
}
double chord(const Station& a, const Station& b) {
  return std::hypot(a.x - b.x, a.top - b.top,
                    std::hypot(a.bottom - b.bottom, a.half_width - b.half_width));
}

// Lofts a surface through stations from pole to pole, with `steps` pieces between neighbours.
// Beyond a pole the first section is mirrored, which rounds the end.
Solid superellipse_loft(const std::vector<Station>& stations, const std::vector<int>& steps,
                        int segments) {
  const auto reflected = [](Station s) {
    std::swap(s.top, s.bottom);
    s.half_width = -s.half_width;
    return s;
  };
  std::vector<Station> all = {reflected(stations[1])};
  all.insert(all.end(), stations.begin(), stations.end());
  all.push_back(reflected(stations[stations.size() - 2]));
  std::vector<Points> rings;
  for (std::size_t i = 1; i + 2 < all.size(); ++i) {
    const double t1 = std::sqrt(chord(all[i - 1], all[i]));
    const double t2 = t1 + std::sqrt(chord(all[i], all[i + 1]));
    const double t3 = t2 + std::sqrt(chord(all[i + 1], all[i + 2]));
    const auto between = [](const Station& a, const Station& b, double ta, double tb, double t) {
      return (tb - t) / (tb - ta) * a + (t - ta) / (tb - ta) * b;
    };
    for (int k = i == 1 ? 1 : 0; k < steps[i - 1]; ++k) {
      const double t = t1 + (t2 - t1) * k / steps[i - 1];
      const Station a1 = between(all[i - 1], all[i], 0.0, t1, t);
      const Station a2 = between(all[i], all[i + 1], t1, t2, t);
      const Station a3 = between(all[i + 1], all[i + 2], t2, t3, t);
      const Station s = between(between(a1, a2, 0.0, t2, t), between(a2, a3, t1, t3, t), t1, t2, t);
      const double middle = 0.5 * (s.top + s.bottom);
      const double half_height = 0.5 * (s.top - s.bottom);
      Points ring;
      for (int j = 0; j < segments; ++j) {
        const double turn = 2.0 * std::numbers::pi * j / segments;
        const auto power = [&s](double c) {
          return std::abs(c) < 1e-12 ? 0.0
                                     : std::copysign(std::pow(std::abs(c), 2.0 / s.exponent), c);
        };
        ring.emplace_back(s.x, s.half_width * power(std::cos(turn)),
                          middle + half_height * power(std::sin(turn)));
      }
      rings.push_back(std::move(ring));
    }
  }
  const auto pole = [](const Station& s) { return Point(s.x, 0.0, 0.5 * (s.top + s.bottom)); };
  return loft(rings, pole(stations.front()), pole(stations.back()));
}

double smooth_step(double from, double to, double x) {
  const double t = std::clamp((x - from) / (to - from), 0.0, 1.0);
  return t * t * (3.0 - 2.0 * t);
}

Field seen_from_side(std::vector<glm::dvec2> corners, double radius) {
  return [corners = std::move(corners), radius](const Point& p) {
    return rounded_polygon(corners, radius, {p.x, p.z});
  };
}

Solid fuselage(const Paints& paint_of) {
  Solid body = superellipse_loft({{47.5, 24.5, 24.5, 0.0, 2.0},
                                  {46.4, 30.0, 19.8, 6.6, 2.0},
                                  {43.2, 35.0, 15.9, 11.2, 2.05},
                                  {37.6, 40.0, 12.9, 14.9, 2.1},
                                  {29.5, 45.0, 11.0, 17.6, 2.2},
                                  {20.0, 48.2, 10.2, 19.1, 2.35},
                                  {8.0, 49.6, 10.0, 19.6, 2.5},
                                  {-5.0, 49.2, 10.6, 19.0, 2.5},
                                  {-16.5, 47.4, 13.6, 16.6, 2.35},
                                  {-26.0, 45.2, 19.0, 12.6, 2.2},
                                  {-34.0, 43.6, 25.2, 8.8, 2.1},
                                  {-43.0, 42.7, 29.8, 6.3, 2.0},
                                  {-54.0, 42.3, 32.2, 4.9, 2.0},
                                  {-66.0, 42.3, 33.9, 4.0, 2.0},
                                  {-76.0, 42.4, 35.4, 3.3, 2.0},
                                  {-80.2, 41.6, 36.9, 2.3, 2.0},
                                  {-81.4, 39.4, 39.4, 0.0, 2.0}},
                                 {2, 2, 2, 2, 3, 3, 3, 3, 2, 2, 1, 1, 1, 1, 1, 1}, 24);
  body = with_material(std::move(body), paint_of.red);
  // The belly is white up to a waistline that rises along the boom, below a yellow stripe.
  const auto waist = [](const Point& p) {
    return p.z - (19.5 + 19.2 * smooth_step(4.0, -50.0, p.x) + 1.8 * smooth_step(20.0, 46.0, p.x));
  };
  paint(
      body, [&](const Point& p) { return waist(p) - 2.3; }, paint_of.yellow);
  paint(body, waist, paint_of.white);
  // White bands around the boom.
  for (const double x : {-58.0, -64.5})
    paint_band(
        body, [x](const Point& p) { return p.x - x; }, 1.9, paint_of.white);

  // Windows: a wide windscreen in two halves, and one window in each door. Faces are small where a
  // window's outline is curved.
  struct Window {
    std::vector<glm::dvec2> corners;  // (x, z)
    double radius, frame;             // corner radius; half the width of the post in the middle
  };
  const std::vector<Window> windows = {
      {{{70.0, 27.6}, {30.0, 27.6}, {24.0, 43.4}, {70.0, 43.4}}, 2.5, 0.8},
      {{{20.0, 29.6}, {16.4, 42.4}, {7.8, 42.4}, {7.8, 29.6}}, 2.4, 3.0},
      {{{-0.6, 29.6}, {-0.6, 42.4}, {-8.4, 42.4}, {-10.4, 36.0}, {-8.4, 29.6}}, 2.4, 3.0}};
  for (const Window& window : windows) {
    for (const glm::dvec2& corner : window.corners) {
      refine(
          body,
          [&](const Point& p) {
            return std::max(glm::distance(corner, {p.x, p.z}) - window.radius - 0.5,
                            window.frame - std::abs(p.y));
          },
          1.8);
    }
    const Field outline = seen_from_side(window.corners, window.radius);
    paint(
        body, [&](const Point& p) { return std::max(outline(p), window.frame - std::abs(p.y)); },
        paint_of.glass);
  }
  return body;
}

Solid engine_housing(const Paints& paint_of) {
  Solid housing = superellipse_loft({{15.6, 48.2, 48.2, 0.0, 2.0},
                                     {14.6, 50.6, 45.6, 4.2, 2.2},
                                     {11.0, 53.4, 44.0, 7.6, 2.4},
                                     {4.0, 55.6, 43.0, 9.8, 2.5},
                                     {-5.0, 55.9, 42.6, 10.4, 2.5},
                                     {-14.0, 54.6, 42.2, 9.6, 2.4},
                                     {-23.0, 51.2, 41.8, 7.4, 2.2},
                                     {-30.0, 47.4, 41.4, 4.6, 2.0},
                                     {-34.0, 44.0, 44.0, 0.0, 2.0}},
                                    {1, 1, 2, 2, 2, 2, 1, 2}, 16);
  housing = with_material(std::move(housing), paint_of.red);
  // Air intakes, one on each shoulder.
  paint(
      housing,
      [](const Point& p) {
        return std::max(rounded_polygon({{7.4, 50.8}, {9.6, 50.8}, {7.0, 52.2}}, 1.4, {p.x, p.z}),
                        1.5 - std::abs(p.y));
      },
      paint_of.dark);
  paint_band(
      housing, [](const Point& p) { return p.x + 11.0; }, 1.1, paint_of.white);
  return housing;
}

// An exhaust pipe from the housing's shoulder outwards, backwards and up.
Solid exhaust(const Paints& paint_of) {
  Solid pipe = with_material(
      revolve_loop({{2.5, 0.0}, {2.7, 5.0}, {2.9, 8.6}, {2.4, 8.6}, {2.1, 3.0}, {1.2, 0.0}}, 10),
      paint_of.metal);
  // Soot on the inner wall, which is the part nearer to the axis than half the wall's thickness.
  recolor(
      pipe, [](const Point& p) { return std::hypot(p.x, p.y) - 2.25; }, paint_of.dark);
  const Point along = glm::normalize(Point(-0.80, 0.46, 0.42));
  const Point across = glm::normalize(glm::cross(along, Point(0.0, 0.0, 1.0)));
  const Point up = glm::cross(along, across);
  return moved(std::move(pipe), [=](const Point& p) {
    return Point(-15.5, 5.4, 49.4) + p.x * across + p.y * up + p.z * along;
  });
}

// A lens-shaped section of unit chord: x from 0 (leading edge) to -1, thickness along z.
Points airfoil(double chord_length, double thickness, int segments) {
  Points section;
  for (int j = 0; j < segments; ++j) {
    const double turn = 2.0 * std::numbers::pi * j / segments;
    const double along = 0.5 - 0.5 * std::cos(turn);
    // The section is thickest at a third of the chord.
    const double fullness = std::sin(turn) * (1.15 - 0.55 * along);
    section.emplace_back(-chord_length * along, 0.0, 0.5 * thickness * fullness);
  }
  return section;
}

Solid fin(const Paints& paint_of) {
  struct Level {
    double z, lead, chord, thickness;
  };
  std::vector<Points> rings;
  for (const Level& level :
       {Level{37.0, -64.5, 15.0, 3.0}, Level{41.0, -66.5, 14.0, 3.0}, Level{47.0, -70.2, 12.6, 2.6},
        Level{54.0, -74.3, 11.0, 2.2}, Level{60.0, -77.6, 9.6, 1.9}, Level{63.2, -79.5, 8.6, 1.6},
        Level{64.6, -81.0, 6.6, 1.1}, Level{65.1, -82.6, 3.6, 0.6}}) {
    Points ring = airfoil(level.chord, level.thickness, 10);
    for (Point& p : ring) p = Point(level.lead + p.x, p.z, level.z);
    rings.push_back(std::move(ring));
  }
  Solid surface = with_material(loft(rings), paint_of.red);
  paint(
      surface, [](const Point& p) { return 57.2 + 0.35 * (p.x + 80.0) - p.z; }, paint_of.white);
  paint(
      surface, [](const Point& p) { return 60.4 + 0.35 * (p.x + 80.0) - p.z; }, paint_of.yellow);
  return surface;
}

Solid ventral_fin(const Paints& paint_of) {
  struct Level {
    double z, lead, chord, thickness;
  };
  std::vector<Points> rings;
  for (const Level& level :
       {Level{37.0, -67.0, 12.0, 2.4}, Level{33.0, -70.0, 9.6, 2.0}, Level{29.0, -73.2, 7.2, 1.5},
        Level{27.4, -74.8, 5.6, 1.1}, Level{26.8, -76.2, 3.2, 0.6}}) {
    Points ring = airfoil(level.chord, level.thickness, 8);
    for (Point& p : ring) p = Point(level.lead + p.x, p.z, level.z);
    rings.push_back(std::move(ring));
  }
  return with_material(loft(rings), paint_of.red);
}

Solid stabiliser(const Paints& paint_of) {
  std::vector<Points> rings;
  for (const double y : {-17.6, -17.0, -15.0, -8.0, 8.0, 15.0, 17.0, 17.6}) {
    const double out = std::abs(y) / 17.6;
    const double narrow = std::sqrt(std::max(1.0 - std::pow(out, 8.0), 0.12));
    Points ring = airfoil((9.0 - 1.8 * out) * narrow, 1.5 * narrow, 8);
    for (Point& p : ring) p = Point(-56.5 - 1.4 * out - 4.0 * (1.0 - narrow) + p.x, y, 38.6 + p.z);
    rings.push_back(std::move(ring));
  }
  Solid surface = with_material(loft(rings), paint_of.red);
  paint(
      surface, [](const Point& p) { return 13.4 - std::abs(p.y); }, paint_of.white);
  // End plates, swept back.
  std::vector<Points> levels;
  struct Level {
    double z, lead, chord, thickness;
  };
  for (const Level& level :
       {Level{33.6, -62.6, 3.4, 0.5}, Level{34.2, -61.0, 5.6, 0.9}, Level{38.6, -57.0, 8.6, 1.3},
        Level{44.4, -60.6, 7.2, 1.1}, Level{47.2, -63.0, 5.2, 0.8}, Level{47.7, -64.4, 3.2, 0.4}}) {
    Points ring = airfoil(level.chord, level.thickness, 8);
    for (Point& p : ring) p = Point(level.lead + p.x, 17.3 + p.z, level.z);
    levels.push_back(std::move(ring));
  }
  const Solid plate = with_material(loft(levels), paint_of.yellow);
  append(surface, plate);
  append(surface, mirrored_y(plate));
  return surface;
}

Solid skids(const Paints& paint_of) {
  Points path = {{-27.0, 15.5, 1.5}, {-3.0, 15.5, 1.5}, {21.0, 15.5, 1.5}};
  const Points toe =
      smooth_path({{21.0, 15.5, 1.5}, {27.0, 15.5, 2.0}, {31.6, 15.5, 4.2}, {34.2, 15.5, 8.0}}, 3);
  path.insert(path.end(), toe.begin() + 1, toe.end());
  const Solid runner = with_material(tube(path, 1.5, 8), paint_of.dark);
  Solid both = runner;
  append(both, mirrored_y(runner));
  return both;
}

// Two cross tubes that arch through the belly and stand on the skids.
Solid struts(const Paints& paint_of) {
  Solid all;
  for (const double x : {16.0, -12.0}) {
    const Points arch = {{x, -15.5, 1.9}, {x, -14.6, 5.0}, {x, -12.7, 8.4}, {x, -9.8, 11.2},
                         {x, -5.0, 13.4}, {x, 5.0, 13.4},  {x, 9.8, 11.2},  {x, 12.7, 8.4},
                         {x, 14.6, 5.0},  {x, 15.5, 1.9}};
    append(all, with_material(tube(arch, 1.15, 8), paint_of.metal));
  }
  return all;
}

Solid mast(const Paints& paint_of) {
  Solid all = with_material(revolve({{0.0, 50.0}, {1.25, 50.0}, {1.25, 62.0}, {0.0, 62.0}}, 12),
                            paint_of.metal);
  // The gearbox's dome and the swashplate.
  append(all,
         with_material(
             revolve({{0.0, 53.0}, {5.6, 53.0}, {5.2, 55.6}, {4.0, 57.0}, {2.2, 57.6}, {0.0, 57.7}},
                     16),
             paint_of.dark));
  append(all, with_material(
                  revolve({{0.0, 58.4}, {2.9, 58.4}, {3.3, 58.9}, {2.9, 59.4}, {0.0, 59.4}}, 14),
                  paint_of.metal));
  return all;
}

// A rescue hoist on the starboard side, over the door.
Solid hoist(const Paints& paint_of) {
  Solid all = with_material(
      tube({{4.0, -14.0, 48.4}, {4.0, -18.5, 49.6}, {4.0, -25.0, 49.2}}, 0.9, 8), paint_of.metal);
  Solid drum =
      revolve({{0.0, -4.2}, {1.6, -4.2}, {2.2, -3.4}, {2.2, 3.4}, {1.6, 4.2}, {0.0, 4.2}}, 14);
  drum = moved(std::move(drum),
               [](const Point& p) { return Point(4.0 + p.z, -24.2 + p.x, 48.0 + p.y); });
  append(all, with_material(std::move(drum), paint_of.yellow));
  append(all,
         with_material(tube({{4.0, -24.2, 46.6}, {4.0, -24.2, 42.2}}, 0.35, 6), paint_of.dark));
  append(all, with_material(sphere({4.0, -24.2, 41.4}, {0.9, 0.9, 1.2}, 0), paint_of.metal));
  return all;
}

Solid lamps(const Paints& paint_of) {
  Solid all = with_material(sphere({37.5, 0.0, 12.4}, {2.3, 2.3, 2.0}, 1), paint_of.lamp);
  append(all, with_material(sphere({-85.0, 0.0, 65.2}, {1.0, 1.0, 1.2}, 0), paint_of.beacon));
  append(all, with_material(sphere({-26.0, 0.0, 50.2}, {1.3, 1.3, 1.3}, 0), paint_of.beacon));
  return all;
}

Solid door_handles(const Paints& paint_of) {
  Solid all;
  for (const Point& at : {Point(7.6, 19.55, 25.0), Point(-1.0, 19.25, 25.0)}) {
    const Solid handle = with_material(sphere(at, {1.5, 0.5, 0.45}, 0), paint_of.metal);
    append(all, handle);
    append(all, mirrored_y(handle));
  }
  return all;
}

// The gearbox that carries the tail rotor, and its shaft out to the port side.
Solid tail_gearbox(const Paints& paint_of) {
  const Point hub = kTailRotorHub * 1e3;
  Solid shaft =
      revolve({{0.0, -5.2}, {1.9, -5.2}, {2.1, -3.6}, {1.0, -2.6}, {0.8, 0.0}, {0.0, 0.0}}, 12);
  return with_material(
      moved(std::move(shaft), [hub](const Point& p) { return hub + Point(p.x, p.z, -p.y); }),
      paint_of.metal);
}

struct BladeShape {
  double root, tip;              // radii [mm]
  double chord, thickness;       // [mm]
  double root_pitch, tip_pitch;  // [rad], leading edge up
  double droop;                  // droop of the tip [mm]
  int stations, segments;
};

// A blade along +x with its leading edge towards +y, for a rotor that rotates counter-clockwise
// when seen from above.
Solid blade(const BladeShape& shape) {
  std::vector<Points> rings;
  for (int i = 0; i <= shape.stations; ++i) {
    const double s = static_cast<double>(i) / shape.stations;
    const double r = shape.root + (shape.tip - shape.root) * s;
    const double end = smooth_step(1.0, 0.93, s);
    const double width = shape.chord * (0.55 + 0.45 * smooth_step(0.0, 0.14, s)) *
                         (1.0 - 0.12 * s) * (0.45 + 0.55 * end);
    const double pitch = shape.root_pitch + (shape.tip_pitch - shape.root_pitch) * s;
    Points ring =
        airfoil(width, shape.thickness * (1.0 - 0.4 * s) * (0.5 + 0.5 * end), shape.segments);
    for (Point& p : ring) {
      const double forward = p.x + 0.32 * width;  // pitch axis at the front third
      p = Point(r, std::cos(pitch) * forward - std::sin(pitch) * p.z,
                std::sin(pitch) * forward + std::cos(pitch) * p.z - shape.droop * s * s);
    }
    rings.push_back(std::move(ring));
  }
  return loft(rings);
}

}  // namespace

Model make_helicopter() {
  Model model;
  model.name = "helicopter";
  const Paints paint_of = add_paints(model);
  add_part(model, "fuselage", fuselage(paint_of), 50.0);
  add_part(model, "engine housing", engine_housing(paint_of), 50.0);
  Solid exhausts = exhaust(paint_of);
  append(exhausts, mirrored_y(exhaust(paint_of)));
  add_part(model, "exhausts", exhausts, 35.0);
  add_part(model, "mast", mast(paint_of), 35.0);
  add_part(model, "fin", fin(paint_of), 60.0);
  add_part(model, "ventral fin", ventral_fin(paint_of), 60.0);
  add_part(model, "stabiliser", stabiliser(paint_of), 60.0);
  add_part(model, "tail gearbox", tail_gearbox(paint_of), 35.0);
  add_part(model, "skids", skids(paint_of), 50.0);
  add_part(model, "struts", struts(paint_of), 50.0);
  add_part(model, "hoist", hoist(paint_of), 40.0);
  add_part(model, "lamps", lamps(paint_of), 60.0);
  add_part(model, "door handles", door_handles(paint_of), 60.0);
  return model;
}

Model make_helicopter_rotor() {
  Model model;
  model.name = "helicopter_rotor";
  const Paints paint_of = add_paints(model);
  Solid hub = with_material(revolve({{0.0, -1.4},
                                     {2.6, -1.4},
                                     {3.4, -0.8},
                                     {3.4, 0.8},
                                     {2.8, 1.6},
                                     {2.5, 2.6},
                                     {1.7, 3.4},
                                     {0.0, 3.8}},
                                    14),
                            paint_of.yellow);
  paint(
      hub, [](const Point& p) { return p.z - 1.2; }, paint_of.metal);
  Solid grips;
  Solid blades;
  Solid one = with_material(blade({6.0, 57.0, 5.6, 1.0, 0.20, 0.06, 1.6, 8, 6}), paint_of.dark);
  paint(
      one, [](const Point& p) { return 50.5 - p.x; }, paint_of.yellow);
  const Solid grip =
      with_material(tube({{1.5, 0.0, 0.0}, {4.0, 0.0, 0.0}, {7.6, 0.0, -0.02}, {8.6, 0.0, -0.03}},
                         {1.3, 1.1, 1.1, 0.7}, 8),
                    paint_of.metal);
  for (int i = 0; i < 4; ++i) {
    const double turn = std::numbers::pi / 4.0 + std::numbers::pi / 2.0 * i;
    append(grips, turned_about_z(grip, turn));
    append(blades, turned_about_z(one, turn));
  }
  add_part(model, "hub", hub, 35.0);
  add_part(model, "grips", grips, 40.0);
  add_part(model, "blades", blades, 60.0);
  return model;
}

Model make_helicopter_tail_rotor() {
  Model model;
  model.name = "helicopter_tail_rotor";
  const Paints paint_of = add_paints(model);
  // Models the rotor about z, then tilts it so that z becomes y.
  const auto laid = [](Solid solid) {
    return moved(std::move(solid), [](const Point& p) { return Point(p.x, p.z, -p.y); });
  };
  Solid hub = with_material(
      revolve({{0.0, -0.9}, {1.3, -0.9}, {1.6, -0.4}, {1.6, 0.5}, {1.1, 1.1}, {0.0, 1.3}}, 14),
      paint_of.metal);
  Solid one = with_material(blade({0.9, 11.5, 2.6, 0.7, 0.25, 0.12, 0.0, 5, 6}), paint_of.dark);
  paint(
      one, [](const Point& p) { return 8.6 - p.x; }, paint_of.yellow);
  Solid blades;
  for (int i = 0; i < 3; ++i) append(blades, turned_about_z(one, 2.0 * std::numbers::pi / 3.0 * i));
  add_part(model, "hub", laid(std::move(hub)), 35.0);
  add_part(model, "blades", laid(std::move(blades)), 60.0);
  return model;
}

}  // namespace penumbra::models
