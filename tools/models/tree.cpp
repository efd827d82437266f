// A tree of many parts: trunk, branches, twigs and tufts of leaves. Each part is a closed surface.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <numbers>

#include "tools/models/bundled_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {
namespace {

// Returns the same numbers on every machine, unlike the standard library's distributions.
class Random {
 public:
  double between(double low, double high) {
    state_ = state_ * 6364136223846793005ULL + 1442695040888963407ULL;
    return low + (high - low) * static_cast<double>(state_ >> 11U) * 0x1p-53;
  }

 private:
  std::uint64_t state_ = 20011;
};

// An uneven ball with a flattened bottom.
Solid tuft(const Point& centre, double radius, double phase) {
  return moved(sphere(Point(0.0), Point(1.0), 1), [=](const Point& p) {
    const double bump = 1.0 + 0.10 * std::sin(5.0 * p.x + phase) +
                        0.10 * std::sin(4.0 * p.y - phase) +
                        0.08 * std::sin(6.0 * p.z + 2.0 * phase);
    const double squash = p.z < 0.0 ? 0.62 : 0.88;
    return centre + radius * bump * Point(p.x, p.y, squash * p.z);
  });
}

}  // namespace

Model make_tree() {
  Model model;
  model.name = "tree";
  const int bark = add_material(model, "bark", {0.16F, 0.085F, 0.045F}, 0.0F, 0.85F);
  const std::array<int, 3> leaves = {
      add_material(model, "dark leaves", {0.035F, 0.145F, 0.03F}, 0.0F, 0.75F),
      add_material(model, "leaves", {0.075F, 0.235F, 0.04F}, 0.0F, 0.75F),
      add_material(model, "light leaves", {0.15F, 0.33F, 0.055F}, 0.0F, 0.75F)};
  Random random;

  const Points trunk_path = smooth_path({{0.0, 0.0, 0.0},
                                         {0.4, 0.2, 5.0},
                                         {2.0, 1.0, 28.0},
                                         {-0.5, 2.0, 60.0},
                                         {1.5, 0.5, 95.0},
                                         {0.5, -0.5, 132.0}},
                                        4);
  std::vector<double> trunk_radii;
  for (const Point& p : trunk_path)
    trunk_radii.push_back(1.2 + 6.0 * (1.0 - p.z / 132.0) + 5.0 * std::exp(-p.z / 5.0));
  Solid trunk = moved(tube(trunk_path, trunk_radii, 16), [](const Point& p) {
    return Point(p.x, p.y, std::max(p.z, 0.0));  // the foot of a leaning trunk ends on the ground
  });
  add_part(model, "trunk", with_material(std::move(trunk), bark), 60.0);

  Solid branches;
  Solid twigs;
  Solid crown;
  int count = 0;
  const auto add_tuft = [&](const Point& at, double radius) {
    append(crown, with_material(tuft(at, radius, random.between(0.0, 2.0 * std::numbers::pi)),
                                leaves[static_cast<std::size_t>(count++ % 3)]));
  };
  const auto point_on_trunk = [&](double z) {
    std::size_t i = 0;
    while (i + 2 < trunk_path.size() && trunk_path[i + 1].z < z) ++i;
    const double t = (z - trunk_path[i].z) / (trunk_path[i + 1].z - trunk_path[i].z);
    return trunk_path[i] + t * (trunk_path[i + 1] - trunk_path[i]);
  };
  constexpr int kBranches = 18;
  constexpr int kTwigs = 7;
  const double golden = std::numbers::pi * (3.0 - std::sqrt(5.0));
  for (int b = 0; b < kBranches; ++b) {
    const double s = static_cast<double>(b) / (kBranches - 1);
    const double z = 46.0 + 78.0 * s;
    const double turn = golden * b + random.between(-0.2, 0.2);
    const double reach = 46.0 * std::sqrt(1.0 - 0.72 * s * s) * random.between(0.85, 1.05);
    const double rise = 14.0 + 12.0 * s;
    const Point out(std::cos(turn), std::sin(turn), 0.0);
    const Point from = point_on_trunk(z);
    const Points path = smooth_path({from, from + 0.35 * reach * out + Point(0.0, 0.0, 0.25 * rise),
                                     from + 0.7 * reach * out + Point(0.0, 0.0, 0.62 * rise),
                                     from + reach * out + Point(0.0, 0.0, rise)},
                                    3);
    std::vector<double> radii;
    for (std::size_t i = 0; i < path.size(); ++i) {
      radii.push_back((2.6 - 0.9 * s) *
                      (1.0 - 0.75 * static_cast<double>(i) / static_cast<double>(path.size() - 1)));
    }
    append(branches, with_material(tube(path, radii, 10), bark));
    add_tuft(path.back() + Point(0.0, 0.0, 2.0), random.between(8.0, 10.5));
    for (int k = 0; k < kTwigs; ++k) {
      const Point foot = path[static_cast<std::size_t>(3 + k)];
      const double side = k % 2 == 0 ? 1.0 : -1.0;
      const double bend = turn + side * random.between(0.6, 1.2);
      const double length = random.between(10.0, 19.0) * (1.0 - 0.35 * s);
      const Point tip =
          foot + length * Point(std::cos(bend), std::sin(bend), random.between(0.1, 0.9));
      const Point knee = 0.5 * (foot + tip) + Point(0.0, 0.0, -random.between(0.5, 2.0));
      append(twigs,
             with_material(tube(smooth_path({foot, knee, tip}, 2), {0.9, 0.75, 0.6, 0.5, 0.4}, 8),
                           bark));
      add_tuft(tip, random.between(5.5, 8.5));
    }
  }
  add_tuft(trunk_path.back() + Point(0.0, 0.0, 3.0), 11.0);
  add_part(model, "branches", branches, 60.0);
  add_part(model, "twigs", twigs, 60.0);
  add_part(model, "crown", crown, 180.0);
  return model;
}

}  // namespace penumbra::models
