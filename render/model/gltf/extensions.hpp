// glTF extensions: which are supported, ignored or rejected.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/document.hpp"

namespace penumbra::gltf {

inline constexpr const char* kInstancing = "EXT_mesh_gpu_instancing";
inline constexpr const char* kVisibility = "KHR_node_visibility";
inline constexpr const char* kWebp = "EXT_texture_webp";
inline constexpr const char* kUnlit = "KHR_materials_unlit";
inline constexpr const char* kEmissiveStrength = "KHR_materials_emissive_strength";
inline constexpr const char* kTextureTransform = "KHR_texture_transform";
inline constexpr const char* kDraco = "KHR_draco_mesh_compression";

inline constexpr std::array kMeshoptNames = {"EXT_meshopt_compression", "KHR_meshopt_compression"};

// Returns the extension that compresses a buffer view, or nullptr.
[[nodiscard]] const char* compression_of(const tinygltf::BufferView& view);

// Fails if the file requires an unsupported extension that may affect its geometry.
[[nodiscard]] Result<void> check_required(const Document& document);

// Returns warnings about content that the reader ignores, one line per kind. `posed`: an animation
// is read.
[[nodiscard]] std::vector<std::string> ignored_content(const Document& document, bool posed);

}  // namespace penumbra::gltf
