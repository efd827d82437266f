#include "render/model/gltf/compression/meshopt.hpp"

#include <meshoptimizer.h>

#include <algorithm>
#include <array>
#include <string_view>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/gltf/extensions.hpp"

namespace penumbra::gltf {
namespace {

// The high half of a vertex stream's first byte is 0xA, the low half the version of the codec.
bool has_newer_version(std::span<const std::uint8_t> coded) {
  return coded.front() > 0xA0 && coded.front() <= 0xAF;
}

// Checks the sizes that the decoder and the filters require.
Result<void> check_sizes(const MeshoptView& view) {
  const auto stride_fails = [&](std::string_view expected) {
    return fail("{}/byteStride: is {}; {} {}{}has {}", view.json_path, view.byte_stride, view.mode,
                view.filter == "NONE" ? "" : view.filter, view.filter == "NONE" ? "" : " ",
                expected);
  };
  if (view.count == 0) return fail("{}/count: is 0; export the model again", view.json_path);
  const std::size_t stride = view.byte_stride;
  if (view.mode == "ATTRIBUTES") {
    if (stride == 0 || stride > 256 || stride % 4 != 0) return stride_fails("4, 8, ... or 256");
    if (view.filter == "OCTAHEDRAL" && stride != 4 && stride != 8) return stride_fails("4 or 8");
    if (view.filter == "QUATERNION" && stride != 8) return stride_fails("8");
    return {};
  }
  if (view.filter != "NONE") {
    return fail("{}/filter: {} is not for mode {}; export the model again", view.json_path,
                view.filter, view.mode);
  }
  if (stride != 2 && stride != 4) return stride_fails("2 or 4");
  if (view.mode == "TRIANGLES" && view.count % 3 != 0) {
    return fail("{}/count: is {}, not a multiple of 3; export the model again", view.json_path,
                view.count);
  }
  return {};
}

// Decodes in place what the encoder's filter rounded.
void undo_filter(const MeshoptView& view, std::uint8_t* data) {
  if (view.filter == "OCTAHEDRAL") meshopt_decodeFilterOct(data, view.count, view.byte_stride);
  if (view.filter == "QUATERNION") meshopt_decodeFilterQuat(data, view.count, view.byte_stride);
  if (view.filter == "EXPONENTIAL") meshopt_decodeFilterExp(data, view.count, view.byte_stride);
}

}  // namespace

Result<std::optional<MeshoptView>> meshopt_view(const tinygltf::BufferView& view,
                                                const std::string& json_path) {
  const char* extension = compression_of(view);
  if (extension == nullptr) return std::optional<MeshoptView>();
  const tinygltf::Value& from = view.extensions.at(extension);
  MeshoptView to;
  to.json_path = fmt::format("{}/extensions/{}", json_path, extension);
  for (const char* key : {"buffer", "byteLength", "byteStride", "count", "mode"}) {
    if (!from.Has(key)) return fail("{}: has no {}; export the model again", to.json_path, key);
  }
  // parse_document() checked the types.
  const auto number = [&from](const char* key) {
    return from.Has(key) ? static_cast<std::size_t>(from.Get(key).GetNumberAsInt()) : 0U;
  };
  to.buffer = number("buffer");
  to.byte_offset = number("byteOffset");
  to.byte_length = number("byteLength");
  to.byte_stride = number("byteStride");
  to.count = number("count");
  to.mode = from.Get("mode").Get<std::string>();
  to.filter = from.Has("filter") ? from.Get("filter").Get<std::string>() : "NONE";
  constexpr std::array<std::string_view, 3> kModes = {"ATTRIBUTES", "TRIANGLES", "INDICES"};
  if (std::ranges::count(kModes, to.mode) == 0) {
    return fail("{}/mode: \"{}\" is none of ATTRIBUTES, TRIANGLES and INDICES", to.json_path,
                shortened(to.mode, 40));
  }
  constexpr std::array<std::string_view, 4> kFilters = {"NONE", "OCTAHEDRAL", "QUATERNION",
                                                        "EXPONENTIAL"};
  if (std::ranges::count(kFilters, to.filter) == 0) {
    return fail("{}/filter: \"{}\" can't be read; export with another filter or without one",
                to.json_path, shortened(to.filter, 40));
  }
  PENUMBRA_TRY_VOID(check_sizes(to));
  if (to.decoded_bytes() != view.byteLength) {
    return fail("{}: has {} elements of {} bytes for a buffer view of {} bytes", to.json_path,
                to.count, to.byte_stride, view.byteLength);
  }
  return to;
}

Result<std::vector<std::uint8_t>> decode_meshopt(const MeshoptView& view,
                                                 std::span<const std::uint8_t> coded) {
  if (coded.empty()) return fail("{}/byteLength: is 0; export the model again", view.json_path);
  std::vector<std::uint8_t> decoded(view.decoded_bytes());
  int error = 0;
  if (view.mode == "ATTRIBUTES") {
    error = meshopt_decodeVertexBuffer(decoded.data(), view.count, view.byte_stride, coded.data(),
                                       coded.size());
  } else if (view.mode == "TRIANGLES") {
    error = meshopt_decodeIndexBuffer(decoded.data(), view.count, view.byte_stride, coded.data(),
                                      coded.size());
  } else {
    error = meshopt_decodeIndexSequence(decoded.data(), view.count, view.byte_stride, coded.data(),
                                        coded.size());
  }
  if (error != 0 && view.mode == "ATTRIBUTES" && has_newer_version(coded)) {
    return fail(
        "{}: is in version {} of the format, which can't be read; export it with "
        "EXT_meshopt_compression",
        view.json_path, coded.front() & 0xF);
  }
  if (error != 0) {
    return fail("{}: its data is damaged; copy or export the model again", view.json_path);
  }
  undo_filter(view, decoded.data());
  return decoded;
}

}  // namespace penumbra::gltf
