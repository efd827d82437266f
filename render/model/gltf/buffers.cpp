#include "render/model/gltf/buffers.hpp"

#include "core/text/file.hpp"
#include "render/model/gltf/uri.hpp"
#include "render/model/model_parts.hpp"

namespace penumbra::gltf {
namespace {

bool is_file(const std::filesystem::path& path) {
  std::error_code ignored;  // of a name that is too long
  return std::filesystem::is_regular_file(path, ignored);
}

}  // namespace

Buffers::Buffers(const std::filesystem::path& file, std::vector<BufferSource> sources,
                 std::optional<std::span<const std::uint8_t>> binary, std::size_t max_bytes)
    : name_(file.string()),
      folder_(file.parent_path()),
      sources_(std::move(sources)),
      binary_(binary),
      bytes_left_(max_bytes),
      fetched_(sources_.size()) {}

bool Buffers::has_data(std::size_t buffer) const {
  return !sources_[buffer].uri.empty() || (buffer == 0 && binary_);
}

Result<std::span<const std::uint8_t>> Buffers::bytes(std::size_t buffer) {
  const BufferSource& source = sources_[buffer];
  if (!has_data(buffer)) {
    return fail("{}: buffers/{}: has neither a uri nor data in a .glb; export the model again",
                name_, buffer);
  }
  std::span<const std::uint8_t> data;
  if (source.uri.empty()) {
    data = *binary_;
  } else {
    std::optional<std::vector<std::uint8_t>>& fetched = fetched_[buffer];
    if (!fetched) {
      Result<std::vector<std::uint8_t>> read = fetch(source.uri);
      if (!read) return fail("{}: buffers/{}: {}", name_, buffer, read.error().message);
      fetched = std::move(*read);
    }
    data = *fetched;
  }
  if (data.size() < source.byte_length) {
    return fail(
        "{}: buffers/{}/byteLength: is {}, but its data has {} bytes; export the model again",
        name_, buffer, source.byte_length, data.size());
  }
  return data.first(source.byte_length);
}

Result<std::vector<std::uint8_t>> Buffers::fetch(std::string_view uri) {
  if (is_data_uri(uri)) return decode_data_uri(uri);
  // The name of a file may contain a '%' that begins no escape.
  Result<std::filesystem::path> file = beside_model(folder_, percent_decoded(uri));
  if (file && !is_file(*file)) {
    const Result<std::filesystem::path> literal = beside_model(folder_, uri);
    if (literal && is_file(*literal)) file = literal;
  }
  if (!file) return tl::unexpected(file.error());
  if (!is_file(*file)) {
    return fail("{}: not found; put it beside the model", file->string());
  }
  Result<std::vector<std::uint8_t>> read = read_file(*file, bytes_left_);
  if (!read) return read;
  bytes_left_ -= read->size();
  if (leaves_folder(percent_decoded(uri))) {
    warnings_.push_back(
        on_one_line(fmt::format("{}: \"{}\" is outside the model's folder; {} is used", name_,
                                uri.substr(0, 200), file->string())));
  }
  return read;
}

}  // namespace penumbra::gltf
