// Adds animations to glTF files that tests build.
#pragma once

#include <string>
#include <vector>

#include "support/gltf_builder.hpp"

namespace penumbra::test {

struct ChannelForm {
  std::string interpolation = "LINEAR";
  std::size_t animation = 0;
  bool normalized = false;  // of integer values
};

// Returns the accessor type of a path's values.
inline std::string type_of_path(const std::string& path) {
  return path == "rotation" ? "VEC4" : path == "weights" ? "SCALAR" : "VEC3";
}

// Adds a channel to an animation, which is added if it is the next one.
inline void add_channel(GltfBuilder& file, std::size_t node, const std::string& path,
                        std::size_t times, std::size_t values, const ChannelForm& form = {}) {
  nlohmann::json& animation = file.json["animations"][form.animation];
  animation["samplers"].push_back(
      {{"input", times}, {"output", values}, {"interpolation", form.interpolation}});
  animation["channels"].push_back({{"sampler", animation["samplers"].size() - 1},
                                   {"target", {{"node", node}, {"path", path}}}});
}

template <class T>
void animate(GltfBuilder& file, std::size_t node, const std::string& path,
             const std::vector<float>& times, const std::vector<T>& values,
             const ChannelForm& form = {}) {
  const std::size_t input = file.accessor(times, "SCALAR");
  add_channel(file, node, path, input, file.accessor(values, type_of_path(path), form.normalized),
              form);
}

// A square of 0.1 m that rises from 0.02 m to 0.2 m, stretches and turns over within two seconds.
inline GltfBuilder moving_square() {
  GltfBuilder file;
  file.node({{"mesh", file.square(0.1F)}});
  file.json["materials"] = {{{"doubleSided", true}}};
  file.primitive()["material"] = 0;
  animate(file, 0, "translation", {0, 2}, std::vector<float>{0, 0.02F, 0, 0, 0.2F, 0});
  animate(file, 0, "scale", {0, 2}, std::vector<float>{1, 1, 1, 1.5F, 1, 0.5F});
  animate(file, 0, "rotation", {0, 1, 2},
          std::vector<float>{0, 0, 0, 1, 0.6F, 0, 0, 0.8F, 1, 0, 0, 0});
  return file;
}

}  // namespace penumbra::test
