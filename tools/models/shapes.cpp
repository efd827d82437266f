// Small plain shapes that rest on z = 0, for tests and shadow studies.
#include <cmath>
#include <numbers>

#include "tools/models/bundled_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {
namespace {

Model plain(const std::string& name, const Solid& solid, const glm::vec3& linear_color,
            double crease_deg) {
  Model model;
  model.name = name;
  add_material(model, name, linear_color, 0.0F, 0.55F);
  add_part(model, name, solid, crease_deg);
  return model;
}

}  // namespace

Model make_sphere() {
  return plain("sphere", sphere({0.0, 0.0, 25.0}, {25.0, 25.0, 25.0}, 3), {0.05F, 0.22F, 0.60F},
               60.0);
}

Model make_cube() {
  return plain("cube", box({-20.0, -20.0, 0.0}, {20.0, 20.0, 40.0}), {0.75F, 0.28F, 0.03F}, 30.0);
}

Model make_bar() {
  return plain("bar", box({-60.0, -6.0, 0.0}, {60.0, 6.0, 12.0}), {0.10F, 0.45F, 0.16F}, 30.0);
}

Model make_ring() {
  std::vector<glm::dvec2> profile;
  for (int i = 0; i < 20; ++i) {
    const double turn = 2.0 * std::numbers::pi * i / 20;
    profile.emplace_back(40.0 + 8.0 * std::cos(turn), 8.0 + 8.0 * std::sin(turn));
  }
  return plain("ring", revolve_loop(profile, 48), {0.78F, 0.52F, 0.08F}, 60.0);
}

Model make_l_shape() {
  return plain(
      "l_shape",
      prism({{-20.0, -20.0}, {40.0, -20.0}, {40.0, 0.0}, {0.0, 0.0}, {0.0, 40.0}, {-20.0, 40.0}},
            {-10.0, -10.0}, 0.0, 20.0),
      {0.42F, 0.10F, 0.50F}, 30.0);
}

Model make_tube() {
  return plain("tube", revolve_loop({{15.0, 0.0}, {20.0, 0.0}, {20.0, 60.0}, {15.0, 60.0}}, 48),
               {0.06F, 0.42F, 0.45F}, 30.0);
}

Model make_spiral_staircase() {
  constexpr int kSteps = 18;
  constexpr double kTurnPerStep = 2.0 * std::numbers::pi * 1.25 / kSteps;
  constexpr double kRise = 5.5;  // [mm] per step
  Model model;
  model.name = "spiral_staircase";
  const int wood = add_material(model, "wood", {0.42F, 0.20F, 0.07F}, 0.0F, 0.6F);
  const int iron = add_material(model, "iron", {0.06F, 0.065F, 0.07F}, 0.4F, 0.45F);

  Solid column = revolve({{0.0, 0.0},
                          {9.0, 0.0},
                          {9.0, 2.0},
                          {4.5, 3.5},
                          {4.5, 122.0},
                          {5.5, 123.5},
                          {5.5, 125.5},
                          {3.0, 128.0},
                          {0.0, 129.0}},
                         20);
  add_part(model, "column", with_material(std::move(column), iron), 40.0);

  Solid steps;
  Solid balusters;
  Points rail;
  for (int i = 0; i < kSteps; ++i) {
    const double from = kTurnPerStep * i;
    const double top = kRise * (i + 1);
    std::vector<glm::dvec2> outline;
    constexpr int kArc = 5;
    const double width = kTurnPerStep * 1.12;  // treads overlap slightly
    for (int k = 0; k <= kArc; ++k) {
      const double turn = from + width * k / kArc;
      outline.emplace_back(38.0 * std::cos(turn), 38.0 * std::sin(turn));
    }
    for (int k = kArc; k >= 0; --k) {
      const double turn = from + width * k / kArc;
      outline.emplace_back(3.5 * std::cos(turn), 3.5 * std::sin(turn));
    }
    const double middle = from + 0.5 * kTurnPerStep;
    append(steps, with_material(prism(outline, {20.0 * std::cos(middle), 20.0 * std::sin(middle)},
                                      top - 2.2, top),
                                wood));
    const Point foot(36.0 * std::cos(middle), 36.0 * std::sin(middle), top - 1.1);
    append(balusters, with_material(tube({foot, foot + Point(0.0, 0.0, 24.0)}, 0.7, 8), iron));
    if (i == 0) rail.push_back(Point(foot.x, foot.y, foot.z + 18.0));
    for (int k = 0; k < 3 && (i + 1 < kSteps || k == 0); ++k) {
      const double turn = middle + kTurnPerStep * k / 3;
      rail.emplace_back(36.0 * std::cos(turn), 36.0 * std::sin(turn), top + 23.0 + kRise * k / 3);
    }
  }
  add_part(model, "steps", steps, 30.0);
  add_part(model, "balusters", balusters, 40.0);
  add_part(model, "rail", with_material(tube(rail, 1.3, 10), wood), 50.0);
  return model;
}

std::vector<Model> make_bundled_models() {
  std::vector<Model> all;
  for (Model (*make)() : {make_helicopter, make_helicopter_rotor, make_helicopter_tail_rotor,
                          make_sphere, make_cube, make_bar, make_ring, make_l_shape, make_tube,
                          make_tree, make_hand, make_spiral_staircase}) {
    all.push_back(make());
  }
  return all;
}

}  // namespace penumbra::models
