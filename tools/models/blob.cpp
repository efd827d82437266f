// A ball with morph targets.
#include <cmath>
#include <numbers>

#include "tools/models/animated_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {

MovingModel make_blob(double lobes) {
  MovingModel blob;
  const Solid ball = [] {
    constexpr int kRings = 32, kSegments = 48;
    std::vector<glm::dvec2> profile;
    for (int i = 0; i <= kRings; ++i) {
      const double polar = 0.5 * kFullTurn * i / kRings;
      const bool pole = i == 0 || i == kRings;
      profile.emplace_back(pole ? 0.0 : 25.0 * std::sin(polar), 25.0 - 25.0 * std::cos(polar));
    }
    return revolve(profile, kSegments);
  }();
  const auto displaced = [&ball](const std::string& name, const auto& map) {
    Model model;
    model.name = name;
    add_material(model, "blob", {0.10F, 0.45F, 0.16F}, 0.0F, 0.4F);
    add_part(model, "blob", moved(ball, map), 180.0);
    return model;
  };
  blob.model = displaced("blob", [](const Point& p) { return p; });
  // Directions are those from the ball's centre.
  const auto unit = [](const Point& p) { return (p - Point(0.0, 0.0, 25.0)) / 25.0; };
  // A peanut along x.
  blob.targets.push_back(displaced("peanut", [&](const Point& p) {
    const Point n = unit(p);
    const double waist = 1.0 - 0.19 * lobes * (1.0 - n.x * n.x);
    return Point((1.0 + 0.375 * lobes) * p.x, p.y * waist, 25.0 + (p.z - 25.0) * waist);
  }));
  // Three lobes about z.
  blob.targets.push_back(displaced("clover", [&](const Point& p) {
    const Point n = unit(p);
    const double across = n.x * n.x + n.y * n.y;
    const double grown = 1.0 + 0.2 * lobes * std::cos(3.0 * std::atan2(n.y, n.x)) * across;
    return Point(p.x * grown, p.y * grown, p.z);
  }));
  // A disk that lies on the ground.
  blob.targets.push_back(
      displaced("flat", [](const Point& p) { return Point(1.3 * p.x, 1.3 * p.y, 0.45 * p.z); }));
  Motion& motion = blob.motion;
  motion.name = "Morph";
  motion.duration_s = 2.0;
  for (int key = 0; key < kMotionKeys; ++key) {
    const double phase = kFullTurn * key / (kMotionKeys - 1);
    motion.weights.push_back({0.5 - 0.5 * std::cos(phase),
                              std::pow(std::sin(0.5 * (phase + 0.25 * kFullTurn)), 4),
                              0.35 - 0.35 * std::cos(2.0 * phase)});
  }
  return blob;
}

std::vector<MovingModel> make_moving_models() {
  std::vector<MovingModel> all;
  all.push_back(make_figure());
  all.push_back(make_blob());
  return all;
}

}  // namespace penumbra::models
