// Reads animations and evaluates their channels (glTF 2.0, 3.11 and appendix C).
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/document.hpp"
#include "render/model/gltf/node_pose.hpp"
#include "render/model/gltf/notes.hpp"

namespace penumbra::gltf {

// The keys of one channel.
struct Curve {
  enum class Interpolation { step, linear, cubic_spline };
  using Numbers = std::shared_ptr<const std::vector<double>>;

  Interpolation interpolation = Interpolation::linear;
  bool rotation = false;  // values are quaternions (x, y, z, w)
  Numbers times;          // [s], strictly increasing, not empty
  Numbers values;         // cubic_spline: in-tangent, value and out-tangent of each key
  std::size_t width = 0;  // numbers per value

  // Returns the value at a time, `width` numbers. Before the first key and after the last one, it
  // is constant.
  [[nodiscard]] std::vector<double> at(double time_s) const;
  [[nodiscard]] const double* key_value(std::size_t key) const;
};

class Animations {
 public:
  Animations(const Document& document, Accessors& accessors, const ModelLimits& limits,
             Notes& notes)
      : document_(document),
        accessors_(accessors),
        limits_(limits),
        notes_(notes),
        numbers_left_(limits.max_vertices) {}

  // Reads an animation: its name or index, or "all". Of equal names, the first one is meant.
  [[nodiscard]] Result<void> read(const std::string& chosen);
  // Returns the poses of the animated nodes.
  [[nodiscard]] NodePoses poses_at(double time_s) const;
  // Time of the last key [s].
  [[nodiscard]] double end_s() const;

 private:
  enum class Path { translation, rotation, scale, weights };

  [[nodiscard]] Result<std::vector<std::size_t>> find(const std::string& chosen) const;
  [[nodiscard]] Result<void> read_animation(std::size_t index);
  [[nodiscard]] Result<void> read_channel(const AnimationSource& from, std::size_t index,
                                          const std::string& json_path);
  [[nodiscard]] Result<Curve> read_curve(const AnimationSource& from, int sampler, Path path,
                                         std::size_t width, const std::string& json_path);
  [[nodiscard]] Result<Curve::Numbers> read_times(int accessor, const std::string& json_path);
  [[nodiscard]] Result<Curve::Numbers> read_values(int accessor, const Curve& curve, Path path,
                                                   const std::string& json_path);
  // Returns the numbers of an accessor, which is read once.
  [[nodiscard]] Result<Curve::Numbers> numbers(int accessor, const std::string& json_path);
  // Returns the number of morph targets of a node's mesh.
  [[nodiscard]] Result<std::size_t> target_count(int node, const std::string& json_path) const;

  const Document& document_;
  Accessors& accessors_;
  const ModelLimits& limits_;
  Notes& notes_;
  std::size_t numbers_left_;  // a limit over all curves, because these may share their accessors
  std::map<int, Curve::Numbers> accessed_;          // by accessor
  std::map<std::pair<int, Path>, Curve> channels_;  // by node
};

}  // namespace penumbra::gltf
