#include "render/passes/mask_part.hpp"

#include "render/shadow/fields/fixed_light.hpp"

namespace penumbra {
namespace {

constexpr std::array<bool, 3> kNoLayers{};

}  // namespace

MaskPart MaskPart::of(const ShadowDraw& draw, CachedCaster& caster, const PreparedShadow& prepared,
                      const glm::vec3& light) {
  MaskPart part;
  part.caster = &caster;
  part.kernels = prepared.kernel_key;
  part.reduced = prepared.reduced;
  part.own = prepared.own;
  part.light = light;
  if (draw.technique == ShadowTechnique::simple) {
    part.constants = zenith_constants();
  } else {
    part.constants = draw.constants;
    part.light_mode = draw.light_mode;
  }
  if (draw.technique == ShadowTechnique::field) part.outlines = prepared.outlines;
  for (std::size_t layer = 0; layer < 3; ++layer) {
    const LayerSource source = prepared.layers[layer].source;
    part.layers[layer] = source == LayerSource::masked;
    part.faces[layer] = source == LayerSource::masked_faces;
    part.sides[layer] = source == LayerSource::masked_outline;
  }
  return part;
}

bool MaskPart::covers_nothing() const {
  return layers == kNoLayers && faces == kNoLayers && sides == kNoLayers;
}

bool MaskPart::covers_same_as(const MaskPart& other) const {
  return caster == other.caster && kernels == other.kernels && reduced == other.reduced &&
         own.same_shape(other.own) && own.T_plane_own == other.own.T_plane_own &&
         constants == other.constants && light_mode == other.light_mode && layers == other.layers &&
         faces == other.faces && sides == other.sides;
}

MaskPart::Faces MaskPart::face_images(RenderWork& work) const {
  Faces images;
  if (faces == kNoLayers) return images;
  const ShadowMesh& mesh = caster->casting_mesh(reduced);
  const CasterBody& body = caster->body(reduced);
  const std::vector<std::uint32_t>& indices = body.oriented ? *body.oriented : mesh.indices;
  std::vector<CasterVertex> vertices =
      own_vertices(own, mesh.positions, caster->kernels(caster->sets.at(kernels), reduced));
  settle_contact(vertices);
  work[Counter::shadow_vertices] += static_cast<std::int64_t>(vertices.size());
  std::vector<VertexDisc> discs;
  if (light_mode == LightMode::fixed) {
    discs = CasterCache::discs_of(*caster, kernels, reduced, own.T_own_object.scale, work);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (!faces[i]) continue;
    images[i] = light_mode == LightMode::fixed
                    ? fixed_light_triangles(vertices, discs, indices, constants, kShadowLayers[i])
                    : layer_triangles(vertices, indices, constants, kShadowLayers[i]);
  }
  return images;
}

void MaskPart::project(const Faces& images, double cell, MaskCaster& projected,
                       RenderWork& work) const {
  if (layers == kNoLayers) {
    projected.begin(own, cell);
  } else {
    const std::vector<glm::vec3>& positions = caster->casting_mesh(reduced).positions;
    projected.project(positions, caster->sets.at(kernels).vertices(reduced).kernels, own, constants,
                      layers, cell);
    work[Counter::shadow_vertices] += static_cast<std::int64_t>(positions.size());
  }
  for (std::size_t layer = 0; layer < 3; ++layer) {
    projected.project_faces(kShadowLayers[layer], images[layer]);
    if (sides[layer]) projected.project_outline(kShadowLayers[layer], (*outlines)[layer]);
  }
}

void MaskPart::cover(MaskCaster& projected, MaskPicture& picture) const {
  static const std::vector<FacePair> kNoEdges;
  if (layers == kNoLayers) {
    picture.cover(projected, {}, kNoEdges);
  } else {
    picture.cover(projected, caster->casting_mesh(reduced).indices, *caster->body(reduced).edges);
  }
}

}  // namespace penumbra
