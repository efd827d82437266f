// Primitives: attributes and faces in the frame of their mesh.
#include "render/gltf/gltf_reader.hpp"

namespace penumbra {

// Indices of a triangle list; strips and fans are written out.
Result<std::vector<std::uint32_t>> GltfReader::triangles(const tinygltf::Primitive& primitive,
                                                         std::size_t vertices,
                                                         const std::string& what) const {
  std::vector<std::uint32_t> order;
  if (primitive.indices < 0) {
    order.resize(vertices);
    for (std::size_t i = 0; i < vertices; ++i) order[i] = static_cast<std::uint32_t>(i);
  } else {
    const std::string place = what + "/indices";
    const Result<Elements> indices = elements(primitive.indices, place);
    if (!indices) return tl::unexpected(indices.error());
    const tinygltf::Accessor& accessor =
        gltf_.accessors[static_cast<std::size_t>(primitive.indices)];
    const bool whole = accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE ||
                       accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT ||
                       accessor.componentType == TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT;
    if (indices->width != 1 || !whole || accessor.normalized) {
      return fail("{}: {}: are not unsigned integers", name_, place);
    }
    order.reserve(indices->count);
    for (const double index : indices->values) {
      if (!(index < static_cast<double>(vertices))) {
        return fail("{}: {}: names vertex {}, there are {}", name_, place, index, vertices);
      }
      order.push_back(static_cast<std::uint32_t>(index));
    }
  }
  const int mode = primitive.mode < 0 ? TINYGLTF_MODE_TRIANGLES : primitive.mode;
  std::vector<std::uint32_t> result;
  // Faces whose corners coincide stay in a list; in a strip they only lead on.
  const bool listed = mode == TINYGLTF_MODE_TRIANGLES;
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    if (listed || (a != b && b != c && c != a)) result.insert(result.end(), {a, b, c});
  };
  switch (mode) {
    case TINYGLTF_MODE_TRIANGLES:
      if (order.size() % 3 != 0) {
        return fail("{}: {}: has {} indices, not a multiple of 3", name_, what, order.size());
      }
      for (std::size_t i = 0; i + 2 < order.size(); i += 3) {
        add(order[i], order[i + 1], order[i + 2]);
      }
      break;
    case TINYGLTF_MODE_TRIANGLE_STRIP:
      for (std::size_t i = 0; i + 2 < order.size(); ++i) {
        const bool odd = i % 2 == 1;
        add(order[i], order[i + (odd ? 2 : 1)], order[i + (odd ? 1 : 2)]);
      }
      break;
    case TINYGLTF_MODE_TRIANGLE_FAN:
      for (std::size_t i = 1; i + 1 < order.size(); ++i) add(order[0], order[i], order[i + 1]);
      break;
    default:
      return fail("{}: {}/mode: {} draws points or lines; export triangles", name_, what, mode);
  }
  if (result.size() / 3 > limits_.max_triangles) {
    return fail("{}: {}: has {} triangles, more than the {} allowed", name_, what,
                result.size() / 3, limits_.max_triangles);
  }
  return result;
}

Result<Mesh> GltfReader::read_primitive(const tinygltf::Primitive& primitive,
                                        const std::string& what) {
  Mesh mesh;
  const Result<Elements> positions = attribute(primitive, "POSITION", 3, 3, 0, what);
  if (!positions) return tl::unexpected(positions.error());
  if (positions->count == 0) return fail("{}: {}: has no POSITION attribute", name_, what);
  if (positions->count > limits_.max_vertices) {
    return fail("{}: {}: has {} vertices, more than the {} allowed", name_, what, positions->count,
                limits_.max_vertices);
  }
  const std::size_t count = positions->count;
  const Result<Elements> normals = attribute(primitive, "NORMAL", 3, 3, count, what);
  if (!normals) return tl::unexpected(normals.error());
  const Result<Elements> colors = attribute(primitive, "COLOR_0", 3, 4, count, what);
  if (!colors) return tl::unexpected(colors.error());
  const Result<Elements> kernels = attribute(primitive, "_SHADOW_KERNEL", 3, 3, count, what);
  if (!kernels) return tl::unexpected(kernels.error());
  if (primitive.material >= static_cast<int>(gltf_.materials.size())) {
    return fail("{}: {}: names material {}, there are {}", name_, what, primitive.material,
                gltf_.materials.size());
  }
  mesh.material =
      primitive.material < 0 ? static_cast<int>(gltf_.materials.size()) : primitive.material;
  std::vector<int> sets;
  if (primitive.material >= 0) sets = texcoord_sets_[static_cast<std::size_t>(primitive.material)];
  if (sets.empty()) sets.push_back(0);
  const auto read_texcoords = [&](int set, std::vector<glm::vec2>& to) -> Result<void> {
    const Result<Elements> from =
        attribute(primitive, fmt::format("TEXCOORD_{}", set), 2, 2, count, what);
    if (!from) return tl::unexpected(from.error());
    for (std::size_t i = 0; i < from->count; ++i)
      to.emplace_back(static_cast<float>(from->at(i, 0)), static_cast<float>(from->at(i, 1)));
    return {};
  };
  if (auto done = read_texcoords(sets[0], mesh.texcoords); !done)
    return tl::unexpected(done.error());
  if (sets.size() > 1) {
    if (auto done = read_texcoords(sets[1], mesh.texcoords_2); !done)
      return tl::unexpected(done.error());
  }
  const bool bumpy =
      model_.materials[static_cast<std::size_t>(mesh.material)].normal_texture.image >= 0;
  const Result<Elements> tangents =
      bumpy ? attribute(primitive, "TANGENT", 4, 4, count, what) : Result<Elements>(Elements{});
  if (!tangents) return tl::unexpected(tangents.error());
  Result<std::vector<std::uint32_t>> indices = triangles(primitive, count, what);
  if (!indices) return tl::unexpected(indices.error());
  mesh.indices = std::move(*indices);
  const auto number = [](const Elements& from, std::size_t i, std::size_t c) {
    return static_cast<float>(from.at(i, c));
  };
  mesh.positions.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    mesh.positions.emplace_back(number(*positions, i, 0), number(*positions, i, 1),
                                number(*positions, i, 2));
    mesh.source_vertex.push_back(model_.source_vertex_count + static_cast<std::uint32_t>(i));
  }
  for (std::size_t i = 0; i < kernels->count; ++i) {
    mesh.shadow_kernels.emplace_back(number(*kernels, i, 0), number(*kernels, i, 1),
                                     number(*kernels, i, 2));
  }
  for (std::size_t i = 0; i < normals->count; ++i) {
    mesh.normals.emplace_back(number(*normals, i, 0), number(*normals, i, 1),
                              number(*normals, i, 2));
  }
  for (std::size_t i = 0; i < tangents->count; ++i) {
    mesh.tangents.emplace_back(number(*tangents, i, 0), number(*tangents, i, 1),
                               number(*tangents, i, 2), number(*tangents, i, 3));
  }
  for (std::size_t i = 0; i < colors->count; ++i) {
    mesh.colors.emplace_back(number(*colors, i, 0), number(*colors, i, 1), number(*colors, i, 2),
                             colors->width == 4 ? number(*colors, i, 3) : 1.0F);
  }
  return mesh;
}

Result<void> GltfReader::read_meshes() {
  std::size_t vertices = 0;
  for (std::size_t m = 0; m < gltf_.meshes.size(); ++m) {
    const tinygltf::Mesh& from = gltf_.meshes[m];
    std::vector<Mesh> primitives;
    for (std::size_t p = 0; p < from.primitives.size(); ++p) {
      Result<Mesh> mesh =
          read_primitive(from.primitives[p], fmt::format("meshes/{}/primitives/{}", m, p));
      if (!mesh) return tl::unexpected(mesh.error());
      vertices += mesh->positions.size();
      if (vertices > limits_.max_vertices) {
        return fail("{}: has more than the {} vertices allowed", name_, limits_.max_vertices);
      }
      model_.source_vertex_count = static_cast<std::uint32_t>(vertices);
      mesh->name = from.name;
      primitives.push_back(std::move(*mesh));
    }
    meshes_.push_back(std::move(primitives));
  }
  return {};
}

}  // namespace penumbra
