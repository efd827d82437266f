// Reads materials with their textures and samplers.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/accessors.hpp"
#include "render/model/gltf/notes.hpp"
#include "render/model/gltf/texture_layout.hpp"

namespace penumbra::gltf {

// Reads the materials into a model, in the order of the file, followed by the default material. An
// image that can't be read causes a warning; its material keeps the plain colour.
class MaterialReader {
 public:
  MaterialReader(const Document& document, Accessors& accessors, Buffers& buffers,
                 const ModelLimits& limits, Model& model, Notes& notes)
      : document_(document),
        gltf_(document.model),
        accessors_(accessors),
        buffers_(buffers),
        limits_(limits),
        model_(model),
        notes_(notes) {}

  // `used`: per material, whether to read its factors and images.
  [[nodiscard]] Result<void> read(const std::vector<bool>& used);

  // Returns the layouts of a material's textures, at most two.
  [[nodiscard]] const std::vector<TextureLayout>& layouts(std::size_t material) const {
    return layouts_[material];
  }

 private:
  [[nodiscard]] Result<Material> factors(std::size_t material) const;
  // Returns the factor of KHR_materials_emissive_strength.
  [[nodiscard]] float emissive_strength(const tinygltf::Material& from,
                                        const std::string& what) const;
  [[nodiscard]] Result<void> read_textures(std::size_t material, Material& to);
  // `Info`: one of tinygltf's types of texture reference.
  template <class Info>
  [[nodiscard]] Result<MaterialTexture> texture(const Info& info, const std::string& what,
                                                std::vector<TextureLayout>& layouts);
  [[nodiscard]] Result<TextureSampling> sampling(int sampler) const;
  // Returns an index into the model's textures, or -1 if the image can't be read.
  [[nodiscard]] int image_of(int texture);
  // Decodes an image on first use. Returns its texture, or -1 with a warning unless `quiet`.
  [[nodiscard]] int decode_once(int image, bool quiet);
  [[nodiscard]] Result<int> decoded_image(int image);
  [[nodiscard]] Result<int> add_image(std::span<const std::uint8_t> coded, const std::string& name);

  const Document& document_;
  const tinygltf::Model& gltf_;
  Accessors& accessors_;
  Buffers& buffers_;
  const ModelLimits& limits_;
  Model& model_;
  Notes& notes_;
  std::unordered_map<int, int> texture_of_image_;
  std::vector<std::vector<TextureLayout>> layouts_;  // per material
};

}  // namespace penumbra::gltf
