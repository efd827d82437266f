// A walking figure: limbs of closed surfaces, moved by the bones of a skin.
#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "tools/models/animated_models.hpp"
#include "tools/models/solid.hpp"

namespace penumbra::models {
namespace {

enum BoneIndex : std::uint8_t {
  kHips,
  kChest,
  kHead,
  kUpperArm,  // of the left side; then forearm, thigh, shin and foot, then those of the right side
  kForearm,
  kThigh,
  kShin,
  kFoot,
  kBonesOfSide = 5,
};

std::uint8_t of_side(BoneIndex bone, int side) {
  return static_cast<std::uint8_t>(bone + (side > 0 ? 0 : kBonesOfSide));
}

std::vector<Bone> make_bones() {
  std::vector<Bone> bones = {{"hips", -1, {0.0, 0.0, 60.0}},
                             {"chest", kHips, {0.0, 0.0, 72.0}},
                             {"head", kChest, {0.0, 0.0, 98.0}}};
  for (const int side : {1, -1}) {
    const std::string name = side > 0 ? "left " : "right ";
    const double y = side;
    bones.push_back({name + "upper arm", kChest, {0.0, 19.0 * y, 92.0}});
    bones.push_back({name + "forearm", of_side(kUpperArm, side), {0.0, 22.0 * y, 71.0}});
    bones.push_back({name + "thigh", kHips, {0.0, 8.0 * y, 57.0}});
    bones.push_back({name + "shin", of_side(kThigh, side), {0.0, 8.0 * y, 31.0}});
    bones.push_back({name + "foot", of_side(kShin, side), {0.0, 8.0 * y, 6.0}});
  }
  return bones;
}

// Weights of two bones: that of the second one rises from 0 to 1 as `at` goes from -1 to 1.
BoneWeights between(std::uint8_t first, std::uint8_t second, double at) {
  const double t = std::clamp(0.5 * (at + 1.0), 0.0, 1.0);
  // In steps of 1/64, so that the weights are exact and their sum is 1.
  const double smooth = std::round(64.0 * t * t * (3.0 - 2.0 * t)) / 64.0;
  if (smooth == 0.0) return {{first}, {1.0F}};
  if (smooth == 1.0) return {{second}, {1.0F}};
  return {{first, second}, {static_cast<float>(1.0 - smooth), static_cast<float>(smooth)}};
}

Solid make_torso() {
  // Half widths along x and y at heights.
  struct Section {
    double z, x, y;
  };
  constexpr std::array<Section, 15> kSections = {{{53.0, 3.5, 5.0},
                                                  {54.5, 7.0, 9.0},
                                                  {58.0, 9.2, 11.8},
                                                  {62.0, 9.8, 12.5},
                                                  {66.0, 9.2, 11.8},
                                                  {70.0, 8.5, 11.0},
                                                  {74.0, 8.5, 11.2},
                                                  {78.0, 9.1, 12.0},
                                                  {82.0, 9.7, 13.2},
                                                  {86.0, 10.0, 14.2},
                                                  {90.0, 9.4, 14.8},
                                                  {93.0, 8.0, 13.0},
                                                  {95.5, 5.6, 8.4},
                                                  {97.5, 4.2, 4.6},
                                                  {101.0, 3.9, 4.1}}};
  constexpr int kSides = 20;
  std::vector<Points> rings;
  for (const Section& section : kSections) {
    Points& ring = rings.emplace_back();
    for (int i = 0; i < kSides; ++i) {
      const double turn = kFullTurn * i / kSides;
      ring.emplace_back(section.x * std::cos(turn), section.y * std::sin(turn), section.z);
    }
  }
  return loft(rings);
}

Solid make_limb(const Points& through, const std::vector<double>& radii, int sides) {
  constexpr int kSteps = 4;
  const Points path = smooth_path(through, kSteps);
  std::vector<double> smooth;
  for (std::size_t i = 0; i < path.size(); ++i) {
    const std::size_t from = std::min(i / kSteps, radii.size() - 2);
    const double t = static_cast<double>(i) / kSteps - static_cast<double>(from);
    smooth.push_back(radii[from] + t * (radii[from + 1] - radii[from]));
  }
  // Rounds the ends.
  smooth.front() *= 0.6;
  smooth.back() *= 0.6;
  return tube(path, smooth, sides);
}

glm::dquat about_y(double degrees) {
  return glm::angleAxis(degrees * kFullTurn / 360.0, glm::dvec3(0.0, 1.0, 0.0));
}
glm::dquat about_z(double degrees) {
  return glm::angleAxis(degrees * kFullTurn / 360.0, glm::dvec3(0.0, 0.0, 1.0));
}

// A rotation about +y moves what hangs down towards -x, which is backwards.
Motion make_walk(std::size_t bone_count) {
  Motion walk;
  walk.name = "Walk";
  walk.duration_s = 1.0;
  for (int key = 0; key < kMotionKeys; ++key) {
    const double phase = kFullTurn * key / (kMotionKeys - 1);
    std::vector<glm::dquat> turns(bone_count, glm::dquat(1.0, 0.0, 0.0, 0.0));
    turns[kHips] = about_z(6.0 * std::sin(phase));
    turns[kChest] = about_z(-12.0 * std::sin(phase)) * about_y(4.0);
    turns[kHead] = about_z(6.0 * std::sin(phase)) * about_y(-2.0);
    for (const int side : {1, -1}) {
      const double leg = side > 0 ? phase : phase + 0.5 * kFullTurn;
      const double thigh = -24.0 * std::cos(leg) + 2.0;
      // The knee bends most while the leg swings forward.
      const double swing = std::max(0.0, -std::sin(leg));
      const double knee = 6.0 + 48.0 * swing * swing;
      turns[of_side(kThigh, side)] = about_y(thigh);
      turns[of_side(kShin, side)] = about_y(knee);
      turns[of_side(kFoot, side)] = about_y(-0.5 * (thigh + knee));
      turns[of_side(kUpperArm, side)] = about_y(20.0 * std::cos(leg));
      turns[of_side(kForearm, side)] = about_y(-22.0 + 10.0 * std::cos(leg));
    }
    walk.rotations.push_back(std::move(turns));
    walk.root_offsets.emplace_back(0.0, 0.0, 1.4 * std::cos(2.0 * phase) - 1.6);
  }
  return walk;
}

}  // namespace

MovingModel make_figure() {
  MovingModel figure;
  figure.bones = make_bones();
  Model& model = figure.model;
  model.name = "figure";
  const int shirt = add_material(model, "shirt", {0.10F, 0.30F, 0.55F}, 0.0F, 0.7F);
  const int trousers = add_material(model, "trousers", {0.12F, 0.12F, 0.16F}, 0.0F, 0.7F);
  const int skin = add_material(model, "skin", {0.62F, 0.36F, 0.22F}, 0.0F, 0.6F);

  // Adds a closed surface with the weights of its vertices.
  const auto add = [&](const std::string& name, Solid solid, int material, const auto& weights) {
    const std::size_t first = model.meshes.size();
    add_part(model, name, with_material(std::move(solid), material), 70.0);
    for (std::size_t m = first; m < model.meshes.size(); ++m) {
      std::vector<BoneWeights>& of_mesh = figure.skin.emplace_back();
      for (const glm::vec3& p : model.meshes[m].positions)
        of_mesh.push_back(weights(1e3 * glm::dvec3(p)));
    }
  };
  add("torso", make_torso(), shirt,
      [](const Point& p) { return between(kHips, kChest, (p.z - 72.0) / 7.0); });
  add("head", sphere({0.0, 0.0, 109.0}, {8.6, 7.6, 10.5}, 2), skin, [](const Point&) {
    return BoneWeights{{kHead}, {1.0F}};
  });
  for (const int side : {1, -1}) {
    const std::string name = side > 0 ? "left " : "right ";
    const double y = side;
    add(name + "arm",
        make_limb({{0.0, 17.5 * y, 94.5},
                   {0.0, 19.5 * y, 86.0},
                   {0.0, 22.0 * y, 71.0},
                   {1.0, 23.0 * y, 58.0},
                   {1.5, 22.5 * y, 47.0}},
                  {4.6, 4.6, 4.3, 4.1, 4.2}, 12),
        skin, [side](const Point& p) {
          return between(of_side(kUpperArm, side), of_side(kForearm, side), (71.0 - p.z) / 5.0);
        });
    add(name + "leg",
        make_limb({{0.0, 7.5 * y, 61.0},
                   {0.0, 8.0 * y, 48.0},
                   {0.0, 8.0 * y, 31.0},
                   {-0.5, 8.0 * y, 17.0},
                   {-0.5, 8.0 * y, 4.0}},
                  {6.4, 6.3, 5.8, 5.5, 5.0}, 12),
        trousers, [side](const Point& p) {
          return between(of_side(kThigh, side), of_side(kShin, side), (31.0 - p.z) / 7.0);
        });
    add(name + "foot", sphere({3.0, 8.0 * y, 3.8}, {7.8, 5.0, 3.7}, 2), trousers,
        [side](const Point&) {
          return BoneWeights{{of_side(kFoot, side)}, {1.0F}};
        });
  }
  figure.motion = make_walk(figure.bones.size());
  return figure;
}

}  // namespace penumbra::models
