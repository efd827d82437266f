// glTF extensions: those that are read, those that can be ignored, and those that are refused.
#pragma once

#include <string>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/document.hpp"

namespace penumbra::gltf {

inline constexpr const char* kInstancing = "EXT_mesh_gpu_instancing";
inline constexpr const char* kVisibility = "KHR_node_visibility";
inline constexpr const char* kDraco = "KHR_draco_mesh_compression";

// Returns the extension that compresses a buffer view, or nullptr.
[[nodiscard]] const char* compression_of(const tinygltf::BufferView& view);

[[nodiscard]] tl::unexpected<Error> fail_compressed(const std::string& extension);

// Refuses a file that requires an extension which may change its shape and is not read.
[[nodiscard]] Result<void> check_required(const Document& document);

// Returns warnings about content that the reader ignores, one line per kind.
[[nodiscard]] std::vector<std::string> ignored_content(const Document& document);

}  // namespace penumbra::gltf
