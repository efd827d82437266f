#include "render/passes/layers/mask_part.hpp"

#include "render/shadow/fields/fixed_light.hpp"

namespace penumbra {
namespace {

std::array<bool, 3> layers_from(const LayerSources& layers, LayerSource source) {
  return {layers[0] == source, layers[1] == source, layers[2] == source};
}
bool any_from(const LayerSources& layers, LayerSource source) {
  return layers_from(layers, source) != std::array<bool, 3>{};
}

}  // namespace

MaskPart MaskPart::of(const ShadowDraw& draw, CachedCaster& caster, const PreparedShadow& prepared,
                      const glm::vec3& light) {
  MaskPart part;
  part.caster = &caster;
  part.pose_s = prepared.key.pose_s;
  part.kernels = prepared.key.kernels;
  part.reduced = prepared.key.reduced;
  part.own = prepared.own;
  part.light = light;
  part.constants = traits_of(draw.technique).has_penumbra ? draw.constants : zenith_constants();
  part.light_mode = draw.light_mode;
  part.outlines = prepared.outlines;
  for (std::size_t i = 0; i < 3; ++i) part.layers[i] = prepared.layers[i].source;
  return part;
}

MaskPart::Faces MaskPart::face_images(RenderWork& work) const {
  Faces images;
  if (!any_from(layers, LayerSource::masked_faces)) return images;
  const ShadowMesh& mesh = caster->casting_mesh(reduced);
  const CasterBody& body = caster->body(reduced);
  const std::vector<std::uint32_t>& indices = body.oriented ? *body.oriented : mesh.indices;
  std::vector<CasterVertex> vertices =
      own_vertices(own, mesh.positions, caster->kernels(caster->sets.at(kernels), reduced), work);
  settle_contact(vertices);
  std::vector<VertexDisc> discs;
  if (light_mode == LightMode::fixed) {
    discs = CasterCache::discs_of(*caster, kernels, reduced, own.T_own_object.scale, work);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (layers[i] != LayerSource::masked_faces) continue;
    images[i] = light_mode == LightMode::fixed
                    ? fixed_light_triangles(vertices, discs, indices, constants, kShadowLayers[i])
                    : layer_triangles(vertices, indices, constants, kShadowLayers[i]);
  }
  return images;
}

void MaskPart::project(const Faces& images, double cell, MaskCaster& projected,
                       RenderWork& work) const {
  if (!any_from(layers, LayerSource::masked)) {
    projected.begin(own, cell);
  } else {
    const std::vector<glm::vec3>& positions = caster->casting_mesh(reduced).positions;
    projected.project(positions, caster->sets.at(kernels).vertices(reduced).kernels, own, constants,
                      layers_from(layers, LayerSource::masked), cell);
    work[Counter::shadow_vertices] += static_cast<std::int64_t>(positions.size());
  }
  for (std::size_t layer = 0; layer < 3; ++layer) {
    projected.project_faces(kShadowLayers[layer], images[layer]);
    if (layers[layer] == LayerSource::masked_outline)
      projected.project_outline(kShadowLayers[layer], (*outlines)[layer]);
  }
}

void MaskPart::cover(MaskCaster& projected, MaskRaster& raster) const {
  static const std::vector<SharedEdge> kNoEdges;
  if (!any_from(layers, LayerSource::masked)) {
    raster.cover(projected, {}, kNoEdges);
  } else {
    raster.cover(projected, caster->casting_mesh(reduced).indices, *caster->body(reduced).edges);
  }
}

}  // namespace penumbra
