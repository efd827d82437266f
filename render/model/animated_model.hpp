// A model whose shape follows an animation of its file.
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "core/error.hpp"
#include "render/model/model.hpp"

namespace penumbra {

class AnimatedModel {
 public:
  // Reads a model and one of its animations, or all of them (ModelPose::animation); otherwise like
  // load_model(). Ignores `reading.pose` and stored kernels.
  [[nodiscard]] static Result<std::shared_ptr<const AnimatedModel>> load(
      const std::filesystem::path& file, const std::string& animation,
      const ModelLoadOptions& reading = {});
  ~AnimatedModel();

  // Returns the model at a time [s], limited to the times of the keys. It may have no triangles.
  // Fails if a vertex is too far away. While a shape is in use, calls with its time return the same
  // object. May be called by several threads.
  [[nodiscard]] Result<std::shared_ptr<const Model>> at(double time_s) const;
  // Time of the last key [s].
  [[nodiscard]] double end_s() const;
  // Returns a model of the 8 corners of a box about the shapes at sampled times, without faces.
  [[nodiscard]] const Model& box() const;

 private:
  struct Impl;
  explicit AnimatedModel(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace penumbra
