// Reads the bytes of a glTF file's buffers, data URIs (RFC 2397) and external files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"
#include "render/model/gltf/document.hpp"

namespace penumbra::gltf {

[[nodiscard]] bool is_data_uri(std::string_view uri);

// Reads a buffer when it is first used. Errors and warnings do not contain the model's name.
class Buffers {
 public:
  // `binary`: the second chunk of a .glb. `max_bytes` limits the total size of external files.
  Buffers(const std::filesystem::path& file, std::vector<BufferSource> sources,
          std::optional<std::span<const std::uint8_t>> binary, std::size_t max_bytes);

  [[nodiscard]] std::size_t count() const { return sources_.size(); }
  // Returns false for a buffer without data, such as a placeholder for decompressed data.
  [[nodiscard]] bool has_data(std::size_t buffer) const;
  // Returns the first byteLength bytes of a buffer.
  [[nodiscard]] Result<std::span<const std::uint8_t>> bytes(std::size_t buffer);
  // Returns the bytes of a data URI or of a file in the model's folder.
  [[nodiscard]] Result<std::vector<std::uint8_t>> fetch(std::string_view uri);
  // Returns warnings about files read from the model's folder although their URIs lead elsewhere.
  [[nodiscard]] const std::vector<std::string>& warnings() const { return warnings_; }
  // Returns the files read so far.
  [[nodiscard]] const std::vector<std::filesystem::path>& files() const { return files_; }

 private:
  std::filesystem::path folder_;
  std::vector<BufferSource> sources_;
  std::optional<std::span<const std::uint8_t>> binary_;
  std::size_t bytes_left_;
  std::vector<std::string> warnings_;
  std::vector<std::filesystem::path> files_;
  std::vector<std::optional<std::vector<std::uint8_t>>> fetched_;  // per buffer
};

}  // namespace penumbra::gltf
