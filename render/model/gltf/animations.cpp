#include "render/model/gltf/animations.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <utility>

#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra::gltf {
namespace {

constexpr std::string_view kAll = "all";

// Returns the animations' indices and names, for messages.
std::string list_of(const std::vector<AnimationSource>& animations) {
  constexpr std::size_t kMaxListed = 20;
  std::string list;
  for (std::size_t i = 0; i < std::min(animations.size(), kMaxListed); ++i) {
    list += fmt::format("{}{}", i > 0 ? ", " : "", i);
    const std::string& name = animations[i].name;
    if (!name.empty()) list += fmt::format(" \"{}\"", shortened(name, 60));
  }
  return animations.size() > kMaxListed ? list + ", ..." : list;
}

// Fails unless the component type is one of glTF 2.0, 3.11: floats or, for rotations and weights,
// normalised integers.
Result<void> check_type(const tinygltf::Accessor& accessor, bool may_be_integer,
                        const std::string& json_path) {
  const int type = accessor.componentType;
  if (type == TINYGLTF_COMPONENT_TYPE_FLOAT) return {};
  if (may_be_integer && accessor.normalized && type != TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT)
    return {};
  return fail("{}: are not floats{}; export the model again", json_path,
              may_be_integer ? " or normalized integers" : "");
}

// Hermite spline (glTF 2.0, C.5). Each key: in-tangent, value and out-tangent.
double spline(const double* a, const double* b, std::size_t width, double t, double span) {
  const double t2 = t * t, t3 = t2 * t;
  return (2.0 * t3 - 3.0 * t2 + 1.0) * a[width] + span * (t3 - 2.0 * t2 + t) * a[2 * width] +
         (-2.0 * t3 + 3.0 * t2) * b[width] + span * (t3 - t2) * b[0];
}

}  // namespace

const double* Curve::key_value(std::size_t key) const {
  const bool tangents = interpolation == Interpolation::cubic_spline;
  return values->data() + (tangents ? 3 * key + 1 : key) * width;
}

std::vector<double> Curve::at(double time_s) const {
  const auto after = std::ranges::upper_bound(*times, time_s);
  const auto key = static_cast<std::size_t>(
      std::max<std::ptrdiff_t>(after - times->begin() - 1, 0));  // the last one not after the time
  const double* a = key_value(key);
  std::vector<double> value(a, a + width);
  const bool outside = after == times->begin() || after == times->end();
  if (outside || interpolation == Interpolation::step) return value;
  const double* b = key_value(key + 1);
  const double span = (*times)[key + 1] - (*times)[key];
  const double t = (time_s - (*times)[key]) / span;
  if (interpolation == Interpolation::cubic_spline) {
    for (std::size_t i = 0; i < width; ++i)
      value[i] = spline(a - width + i, b - width + i, width, t, span);
  } else if (!rotation) {
    for (std::size_t i = 0; i < width; ++i) value[i] = a[i] + t * (b[i] - a[i]);
  } else {
    // Over the shorter arc, because slerp() negates one quaternion if necessary. read_values()
    // checked the keys.
    const Eigen::Quaterniond turned = rotation_of(a)->slerp(t, *rotation_of(b));
    value = {turned.x(), turned.y(), turned.z(), turned.w()};
  }
  return value;
}

Result<std::vector<std::size_t>> Animations::find(const std::string& chosen) const {
  const std::vector<AnimationSource>& animations = document_.animations;
  if (animations.empty()) {
    return fail("has no animations; its rest pose is its only shape");
  }
  const auto named = std::ranges::find(animations, chosen, &AnimationSource::name);
  if (named != animations.end() && !chosen.empty())
    return std::vector{static_cast<std::size_t>(named - animations.begin())};
  if (chosen == kAll) {
    std::vector<std::size_t> all(animations.size());
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = i;
    return all;
  }
  std::size_t index = 0;
  const char* const end = chosen.data() + chosen.size();
  const auto [stop, error] = std::from_chars(chosen.data(), end, index);
  if (!chosen.empty() && error == std::errc() && stop == end && index < animations.size())
    return std::vector{index};
  return fail("has no animation \"{}\"; give one of {}, or all", shortened(chosen, 60),
              list_of(animations));
}

Result<void> Animations::read(const std::string& chosen) {
  PENUMBRA_TRY(const std::vector<std::size_t> indices, find(chosen));
  for (const std::size_t index : indices) PENUMBRA_TRY_VOID(read_animation(index));
  return {};
}

Result<void> Animations::read_animation(std::size_t index) {
  const AnimationSource& from = document_.animations[index];
  if (!from.fault.empty()) return fail("{}", from.fault);
  for (std::size_t i = 0; i < from.channels.size(); ++i) {
    PENUMBRA_TRY_VOID(read_channel(from, i, fmt::format("animations/{}", index)));
  }
  return {};
}

Result<void> Animations::read_channel(const AnimationSource& from, std::size_t index,
                                      const std::string& animation) {
  const AnimationSource::Channel& source = from.channels[index];
  const std::string json_path = fmt::format("{}/channels/{}", animation, index);
  constexpr std::array<std::pair<std::string_view, Path>, 4> kPaths = {
      {{"translation", Path::translation},
       {"rotation", Path::rotation},
       {"scale", Path::scale},
       {"weights", Path::weights}}};
  const auto known =
      std::ranges::find(kPaths, source.path, &std::pair<std::string_view, Path>::first);
  // Extensions animate other things, and without a node (glTF 2.0, 5.8.1).
  if (source.node < 0 || known == kPaths.end()) {
    notes_.add("does not animate a node's transform or weights; it is ignored", json_path);
    return {};
  }
  const auto& nodes = document_.model.nodes;
  if (!has(nodes, source.node)) {
    return fail("{}/target/node: names node {}, there are {}", json_path, source.node,
                nodes.size());
  }
  const Path path = known->second;
  std::size_t width = path == Path::rotation ? 4 : 3;
  if (path == Path::weights) {
    PENUMBRA_TRY(width, target_count(source.node, json_path));
    if (width == 0) {
      notes_.add("animates weights of a node without morph targets; it is ignored", json_path);
      return {};
    }
  } else if (!nodes[static_cast<std::size_t>(source.node)].matrix.empty()) {
    return fail(
        "{}/target/node: node {} has a matrix; export it with translation, rotation and "
        "scale",
        json_path, source.node);
  }
  if (source.sampler < 0 || static_cast<std::size_t>(source.sampler) >= from.samplers.size()) {
    return fail("{}/sampler: names sampler {}, there are {}", json_path, source.sampler,
                from.samplers.size());
  }
  PENUMBRA_TRY(Curve curve, read_curve(from, source.sampler, path, width,
                                       fmt::format("{}/samplers/{}", animation, source.sampler)));
  const auto [entry, is_new] =
      channels_.insert_or_assign(std::pair(source.node, path), std::move(curve));
  if (!is_new) {
    notes_.add("is animated by several channels; the last one is used",
               fmt::format("nodes/{}/{}", source.node, source.path));
  }
  return {};
}

Result<std::size_t> Animations::target_count(int node, const std::string& json_path) const {
  const tinygltf::Model& gltf = document_.model;
  const int mesh = gltf.nodes[static_cast<std::size_t>(node)].mesh;
  if (!has(gltf.meshes, mesh) || gltf.meshes[static_cast<std::size_t>(mesh)].primitives.empty())
    return std::size_t{0};
  const auto& primitives = gltf.meshes[static_cast<std::size_t>(mesh)].primitives;
  const std::size_t count = primitives.front().targets.size();
  for (const tinygltf::Primitive& primitive : primitives) {
    if (primitive.targets.size() == count) continue;
    return fail(
        "{}/target/node: the primitives of mesh {} have {} and {} morph targets; export "
        "the model again",
        json_path, mesh, count, primitive.targets.size());
  }
  return count;
}

Result<Curve> Animations::read_curve(const AnimationSource& from, int sampler, Path path,
                                     std::size_t width, const std::string& json_path) {
  using Interpolation = Curve::Interpolation;
  const AnimationSource::Sampler& source = from.samplers[static_cast<std::size_t>(sampler)];
  constexpr std::array<std::pair<std::string_view, Interpolation>, 3> kInterpolations = {
      {{"STEP", Interpolation::step},
       {"LINEAR", Interpolation::linear},
       {"CUBICSPLINE", Interpolation::cubic_spline}}};
  const auto known = std::ranges::find(kInterpolations, source.interpolation,
                                       &std::pair<std::string_view, Interpolation>::first);
  if (known == kInterpolations.end()) {
    return fail("{}/interpolation: \"{}\" is none of STEP, LINEAR and CUBICSPLINE", json_path,
                shortened(source.interpolation, 40));
  }
  Curve curve;
  curve.interpolation = known->second;
  curve.rotation = path == Path::rotation;
  curve.width = width;
  PENUMBRA_TRY(curve.times, read_times(source.input, json_path + "/input"));
  PENUMBRA_TRY(curve.values, read_values(source.output, curve, path, json_path + "/output"));
  return curve;
}

Result<Curve::Numbers> Animations::numbers(int accessor, const std::string& json_path) {
  Curve::Numbers& known = accessed_[accessor];
  if (!known) {
    PENUMBRA_TRY(Elements elements, accessors_.elements(accessor, json_path));
    known = std::make_shared<const std::vector<double>>(std::move(elements.values));
  }
  if (known->size() > numbers_left_) {
    return fail("{}: the animations have more than the {} numbers allowed", json_path,
                limits_.max_vertices);
  }
  numbers_left_ -= known->size();
  return known;
}

Result<Curve::Numbers> Animations::read_times(int accessor, const std::string& json_path) {
  PENUMBRA_TRY(Curve::Numbers times, numbers(accessor, json_path));
  const tinygltf::Accessor& source = *accessors_.find(accessor);
  PENUMBRA_TRY_VOID(check_type(source, false, json_path));
  if (source.type != TINYGLTF_TYPE_SCALAR) {
    return fail("{}: are not single numbers of seconds; export the model again", json_path);
  }
  if (times->front() < 0.0) {
    return fail("{}: time 0 is {} s; give 0 or more", json_path, times->front());
  }
  for (std::size_t i = 1; i < times->size(); ++i) {
    if ((*times)[i] > (*times)[i - 1]) continue;
    return fail("{}: time {} is {} s, not after the one before; export the model again", json_path,
                i, (*times)[i]);
  }
  return times;
}

Result<Curve::Numbers> Animations::read_values(int accessor, const Curve& curve, Path path,
                                               const std::string& json_path) {
  PENUMBRA_TRY(Curve::Numbers values, numbers(accessor, json_path));
  const tinygltf::Accessor& source = *accessors_.find(accessor);
  PENUMBRA_TRY_VOID(check_type(source, path == Path::rotation || path == Path::weights, json_path));
  const std::size_t components = path == Path::weights ? 1 : curve.width;
  if (component_count(source.type) != components) {
    return fail("{}: have {} components, {} expected", json_path, component_count(source.type),
                components);
  }
  const std::size_t keys = curve.times->size();
  const bool cubic = curve.interpolation == Curve::Interpolation::cubic_spline;
  if (cubic && keys < 2) {
    return fail("{}: a CUBICSPLINE needs at least 2 keys; export the model again", json_path);
  }
  const std::size_t expected = (cubic ? 3 : 1) * keys * curve.width / components;
  if (source.count != expected) {
    return fail("{}: are {} for {} keys, {} expected", json_path, source.count, keys, expected);
  }
  Curve complete = curve;
  complete.values = values;
  for (std::size_t key = 0; curve.rotation && key < keys; ++key) {
    if (!rotation_of(complete.key_value(key)))
      return fail("{}: the rotation of key {} is not a unit quaternion", json_path, key);
  }
  return values;
}

NodePoses Animations::poses_at(double time_s) const {
  NodePoses poses;
  for (const auto& [target, curve] : channels_) {
    NodePose& pose = poses[target.first];
    const std::vector<double> value = curve.at(time_s);
    switch (target.second) {
      case Path::translation:
        pose.translation = Eigen::Map<const Eigen::Vector3d>(value.data());
        break;
      case Path::rotation:
        pose.rotation = Eigen::Map<const Eigen::Quaterniond>(value.data());
        // A spline between opposite keys may pass through zero, which is no rotation.
        if (pose.rotation->norm() < 1e-6) pose.rotation->setIdentity();
        pose.rotation->normalize();
        break;
      case Path::scale:
        pose.scale = Eigen::Map<const Eigen::Vector3d>(value.data());
        break;
      case Path::weights:
        pose.weights = value;
        break;
    }
  }
  return poses;
}

double Animations::end_s() const {
  double end = 0.0;
  for (const auto& [target, curve] : channels_) end = std::max(end, curve.times->back());
  return end;
}

}  // namespace penumbra::gltf
