#include "render/passes/object_painter.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"
#include "render/shadow/layers/receiving_levels.hpp"

namespace penumbra {
namespace {

struct Vertex {
  glm::vec3 position;
  glm::vec3 normal;
  glm::vec2 texcoord;
  glm::vec4 color;
};
// Additional attributes, if the material has maps.
struct MapVertex {
  glm::vec4 tangent;
  glm::vec2 texcoord_2;
};

constexpr const char* kMapsDefine = "MATERIAL_MAPS";

// Texture units; other programs use 1 to 7.
constexpr int kBaseColorUnit = 0;
constexpr int kMetalUnit = 8;
constexpr int kNormalUnit = 9;
constexpr int kOcclusionUnit = 10;
constexpr int kEmissiveUnit = 11;
constexpr int kEnvironmentUnit = 12;

const Material& material_of(const Model& model, int index) {
  static const Material plain;
  const auto at = static_cast<std::size_t>(index);
  return index >= 0 && at < model.materials.size() ? model.materials[at] : plain;
}

// Checks image sizes before the upload, because a driver's error would not report the image.
Result<void> images_fit(const Scene& scene) {
  GLint max_side = 0;
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &max_side);
  for (const SceneObject& object : scene.objects) {
    if (!object.model) continue;
    for (const auto& texture : object.model->textures) {
      if (std::max(texture->width, texture->height) <= max_side) continue;
      return fail(
          "{}: object \"{}\": an image of its model{}{} is {} x {} px, and this graphics driver "
          "takes {} px along a side at most; make the image smaller",
          scene.file, object.name, object.model_file.empty() ? "" : " ", object.model_file,
          texture->width, texture->height, max_side);
    }
  }
  return {};
}

}  // namespace

float longest_model_edge(double longest_edge_m, double scale) {
  return static_cast<float>(longest_edge_m / std::exp2(std::ceil(4.0 * std::log2(scale)) / 4.0));
}

Result<ObjectPainter> ObjectPainter::create(GlApi api, const Scene& scene,
                                            const CameraModel& camera, bool with_edges) {
  if (scene.lights.size() > kMaxLights) {
    return fail("{}: lights: {} of them; at most {} can be drawn", scene.file, scene.lights.size(),
                kMaxLights);
  }
  const auto any_material = [&scene](const auto& has) {
    return std::ranges::any_of(scene.objects, [&](const SceneObject& object) {
      return object.model && std::ranges::any_of(object.model->materials, has);
    });
  };
  const ShaderFiles vertex = {"lens.glsl", "object.vert.glsl"};
  const bool maps = any_material(&Material::needs_map_program);
  const ShaderFiles lit = {"ambient.glsl", "light_share.glsl", "surface_normal.glsl",
                           "object.frag.glsl"};
  const auto make = [&](std::vector<std::string_view> defines) -> Result<SurfaceProgram> {
    SurfaceProgram program;
    PENUMBRA_TRY(program.plain, TranslucentProgram::create(api, vertex, lit, defines));
    if (!maps) return program;
    defines.emplace_back(kMapsDefine);
    PENUMBRA_TRY(program.maps, TranslucentProgram::create(api, vertex, lit, defines));
    return program;
  };
  ObjectPainter painter;
  PENUMBRA_TRY(painter.lit_program_, make({kLightDefine}));
  if (any_material(&Material::reflects)) {
    ShaderFiles with_lens = {"lens.glsl"};
    with_lens.insert(with_lens.end(), lit.begin(), lit.end());
    PENUMBRA_TRY(painter.lit_program_.mirror,
                 TranslucentProgram::create(api, vertex, with_lens,
                                            {kLightDefine, kMapsDefine, "REFLECTS"}));
  }
  if (any_material([](const Material& material) { return material.unlit; })) {
    PENUMBRA_TRY(
        painter.lit_program_.unlit,
        TranslucentProgram::create(api, vertex, lit, {kLightDefine, kMapsDefine, "UNLIT"}));
  }
  PENUMBRA_TRY(painter.darkening_program_, make({kLightDefine, "DARKENS"}));
  static_assert(kMaxReceivingLevels == 64);
  PENUMBRA_TRY(painter.masked_program_,
               TranslucentProgram::create(
                   api, vertex, {"shadow_mask.glsl", "surface_normal.glsl", "masked.frag.glsl"},
                   {"MAX_LEVELS 64"}));
  painter.blends_ = any_material(
      [](const Material& material) { return material.alpha_mode == AlphaMode::blend; });
  if (const auto& tone = camera.parameters().tone_curve)
    painter.tone_ = {static_cast<float>(1.0 / *tone), 1.0F, 0.0F, 0.0F};

  PENUMBRA_TRY_VOID(images_fit(scene));

  const double longest = longest_edge(camera);
  const std::vector<double> scales = largest_scales(scene);
  std::map<std::pair<const Model*, float>, std::shared_ptr<GpuModel>> uploaded;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const auto& model = scene.objects[i].model;
    painter.phantoms_.push_back(scene.objects[i].phantom);
    std::shared_ptr<GpuModel>& gpu = painter.models_.emplace_back();
    if (!model) continue;
    const float edge = longest_model_edge(longest, scales[i]);
    if (scene.objects[i].playback.model) {
      gpu = upload(model, edge, with_edges);
      continue;
    }
    auto& entry = uploaded[{model.get(), edge}];
    if (!entry) entry = upload(model, edge, with_edges);
    gpu = entry;
  }
  return painter;
}

std::shared_ptr<ObjectPainter::GpuModel> ObjectPainter::upload(
    const std::shared_ptr<const Model>& source_model, float max_edge, bool with_edges) {
  auto gpu = std::make_shared<GpuModel>();
  gpu->with_edges = with_edges;
  gpu->source = source_model;
  gpu->max_edge = max_edge;
  const Model& model = *source_model;
  for (const Material& material : model.materials) {
    gpu->materials.push_back({texture_of(*gpu, model, material.base_color_texture, true),
                              texture_of(*gpu, model, material.metallic_roughness_texture, false),
                              texture_of(*gpu, model, material.normal_texture, false),
                              texture_of(*gpu, model, material.occlusion_texture, false),
                              texture_of(*gpu, model, material.emissive_texture, true)});
  }
  upload_meshes(*gpu, BufferLife::once);
  return gpu;
}

void ObjectPainter::pose(std::span<const PosedModel> posed) {
  for (const PosedModel& object : posed) {
    GpuModel& gpu = *models_[static_cast<std::size_t>(object.object)];
    if (gpu.source == object.model) continue;
    // Hidden surfaces are not in the model, so its meshes may have changed.
    if (!std::ranges::equal(gpu.meshes, object.model->meshes, {}, &GpuMesh::material,
                            &Mesh::material))
      gpu.meshes.clear();
    gpu.source = object.model;
    upload_meshes(gpu, BufferLife::every_frame);
  }
}

void ObjectPainter::upload_meshes(GpuModel& gpu, BufferLife life) {
  const Model& model = *gpu.source;
  gpu.meshes.resize(model.meshes.size());
  std::vector<Mesh> uploaded;
  for (std::size_t m = 0; m < gpu.meshes.size(); ++m) {
    Mesh mesh = subdivided(model.meshes[m], gpu.max_edge);
    std::vector<Vertex> vertices(mesh.positions.size());
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      vertices[i] = {mesh.positions[i], i < mesh.normals.size() ? mesh.normals[i] : glm::vec3(0.0F),
                     i < mesh.texcoords.size() ? mesh.texcoords[i] : glm::vec2(0.0F),
                     i < mesh.colors.size() ? mesh.colors[i] : glm::vec4(1.0F)};
    }
    GpuMesh& out = gpu.meshes[m];
    out.material = mesh.material;
    out.surface.write(vertices, life);
    out.surface.write_indices(mesh.indices, life);
    const Material& material = material_of(model, mesh.material);
    if (material.needs_map_program()) {
      std::vector<MapVertex> maps(mesh.positions.size(), {glm::vec4(0.0F), glm::vec2(0.0F)});
      for (std::size_t i = 0; i < maps.size(); ++i) {
        if (i < mesh.tangents.size()) maps[i].tangent = mesh.tangents[i];
        if (i < mesh.texcoords_2.size()) maps[i].texcoord_2 = mesh.texcoords_2[i];
      }
      if (!out.map_vertices) out.map_vertices.emplace(BufferUse::vertices);
      out.map_vertices->write(std::span<const MapVertex>(maps), life);
      VertexArray::attributes({4, 2}, 4);
    }
    if (material.alpha_mode != AlphaMode::blend) {
      if (gpu.with_edges) uploaded.push_back(std::move(mesh));
      continue;
    }
    out.faces.clear();
    out.middles.clear();
    out.middle = glm::vec3(0.0F);
    for (std::size_t i = 0; i + 2 < mesh.indices.size(); i += 3) {
      out.faces.push_back({mesh.indices[i], mesh.indices[i + 1], mesh.indices[i + 2]});
      out.middles.push_back((mesh.positions[mesh.indices[i]] + mesh.positions[mesh.indices[i + 1]] +
                             mesh.positions[mesh.indices[i + 2]]) /
                            3.0F);
      out.middle += out.middles.back();
    }
    out.middle /= std::max(static_cast<float>(out.middles.size()), 1.0F);
    if (gpu.with_edges) uploaded.push_back(std::move(mesh));
  }
  if (gpu.with_edges) make_edges(gpu, uploaded);
}

void ObjectPainter::make_edges(GpuModel& gpu, std::span<const Mesh> meshes) {
  const Model& model = *gpu.source;
  std::vector<EdgeMeshPart> opaque;
  std::vector<EdgeMeshPart> blended;
  for (const Mesh& mesh : meshes) {
    const Material& material = material_of(model, mesh.material);
    if (material.alpha_mode == AlphaMode::mask) continue;  // the cut-outs have the visible edges
    const bool one_sided = model.culls_back_faces && !material.double_sided;
    (material.alpha_mode == AlphaMode::blend ? blended : opaque)
        .push_back({mesh.positions, mesh.normals, mesh.indices, mesh.material, one_sided});
  }
  for (const auto& [parts, edges] :
       {std::pair(&opaque, &gpu.opaque_edges), std::pair(&blended, &gpu.blended_edges)}) {
    if (parts->empty()) {
      edges->reset();
    } else if (!edges->has_value() || !(*edges)->move(*parts)) {
      edges->emplace(*parts);
    }
  }
}

ObjectEdges ObjectPainter::edges_of(int object) const {
  const GpuModel* gpu = models_[static_cast<std::size_t>(object)].get();
  if (gpu == nullptr) return {};
  return {gpu->opaque_edges ? &*gpu->opaque_edges : nullptr,
          gpu->blended_edges ? &*gpu->blended_edges : nullptr};
}

const Texture2d* ObjectPainter::texture_of(GpuModel& gpu, const Model& model,
                                           const MaterialTexture& from, bool color) {
  const auto at = static_cast<std::size_t>(from.image);
  if (from.image < 0 || at >= model.textures.size()) return nullptr;
  const auto [entry, is_new] =
      gpu.textures.try_emplace({from.image, color, from.sampling}, from.sampling);
  if (is_new) {
    const Texture& texture = *model.textures[at];
    entry->second.upload(color ? TexelFormat::srgb8_alpha8 : TexelFormat::rgba8, texture.width,
                         texture.height, texture.rgba.data(), std::ptrdiff_t{4} * texture.width);
  }
  return &entry->second;
}

Result<void> ObjectPainter::choose(Translucency mode, std::optional<PixelFormat> video) {
  mode_ = mode;
  for (SurfaceProgram* program : {&lit_program_, &darkening_program_}) {
    PENUMBRA_TRY_VOID(program->plain.choose(mode, video));
    if (program->maps) PENUMBRA_TRY_VOID(program->maps->choose(mode, video));
    if (program->mirror) PENUMBRA_TRY_VOID(program->mirror->choose(mode, video));
    if (program->unlit) PENUMBRA_TRY_VOID(program->unlit->choose(mode, video));
  }
  return masked_program_.choose(mode, video);
}

ObjectPainter::Programs ObjectPainter::SurfaceProgram::opaque() const {
  return {plain.plain(), maps ? &maps->plain() : nullptr, mirror ? &mirror->plain() : nullptr,
          unlit ? &unlit->plain() : nullptr};
}

ObjectPainter::Programs ObjectPainter::SurfaceProgram::chosen() const {
  return {plain.get(), maps ? &maps->get() : nullptr, mirror ? &mirror->get() : nullptr,
          unlit ? &unlit->get() : nullptr};
}

template <class Action>
void ObjectPainter::for_each(const Programs& programs, const Action& action) {
  for (const ShaderProgram* program :
       {programs.unlit, programs.mirror, programs.maps, &programs.plain}) {
    if (program == nullptr) continue;
    program->use();
    action(*program);
  }
}

void ObjectPainter::begin_lit(const Programs& programs, const FramePlan& plan,
                              const LensUniforms& lens) const {
  for_each(programs, [&](const ShaderProgram& program) {
    set_lens(program, lens);
    set_lights(program, plan);
    program.set("tone", tone_);
    if (&program != programs.mirror) return;
    program.set("environment", kEnvironmentUnit);
    program.set("camera_from_table", camera_from_object(plan.T_table_camera, Placement()));
  });
}

bool ObjectPainter::any_reflects(const FramePlan& plan) const {
  return lit_program_.mirror && std::ranges::any_of(plan.objects, [this](const ObjectDraw& draw) {
           const GpuModel* gpu = models_[static_cast<std::size_t>(draw.object)].get();
           return gpu != nullptr &&
                  std::ranges::any_of(gpu->source->materials, &Material::reflects);
         });
}

void ObjectPainter::set_material(const ShaderProgram& program, const GpuModel& gpu, int index,
                                 bool maps) {
  const Material& material = material_of(*gpu.source, index);
  program.set("base_color", glm::vec3(material.base_color));
  program.set("emissive", material.emissive);
  program.set("metallic", material.metallic);
  program.set("roughness", material.roughness);
  const auto at = static_cast<std::size_t>(index);
  const GpuMaterial textures =
      index >= 0 && at < gpu.materials.size() ? gpu.materials[at] : GpuMaterial();
  program.set("has_texture", textures.base_color != nullptr ? 1 : 0);
  program.set("base_color_texture", kBaseColorUnit);
  if (textures.base_color != nullptr) textures.base_color->bind(kBaseColorUnit);
  if (!maps) return;
  const auto set_map = [&program](const char* has, const char* name, int unit,
                                  const MaterialTexture& from, const Texture2d* texture) {
    program.set(has,
                glm::vec2(texture != nullptr ? 1.0F : 0.0F, static_cast<float>(from.texcoords)));
    program.set(name, unit);
    if (texture != nullptr) texture->bind(unit);
  };
  program.set("base_color_by_second", static_cast<float>(material.base_color_texture.texcoords));
  set_map("has_metal_map", "metal_map", kMetalUnit, material.metallic_roughness_texture,
          textures.metallic_roughness);
  set_map("has_normal_map", "normal_map", kNormalUnit, material.normal_texture, textures.normal);
  set_map("has_occlusion_map", "occlusion_map", kOcclusionUnit, material.occlusion_texture,
          textures.occlusion);
  set_map("has_emissive_map", "emissive_map", kEmissiveUnit, material.emissive_texture,
          textures.emissive);
  program.set("normal_scale", material.normal_scale);
  program.set("occlusion_strength", material.occlusion_strength);
  program.set("base_alpha", material.base_color.a);
  program.set("alpha_cutoff",
              material.alpha_mode == AlphaMode::mask ? material.alpha_cutoff : -1.0F);
  program.set("alpha_blends", material.alpha_mode == AlphaMode::blend ? 1 : 0);
}

const ShaderProgram* ObjectPainter::program_for(const Programs& programs, const Material& material,
                                                bool phantom) {
  // A phantom stands for a real object, which is lit.
  if (material.unlit && !phantom) return programs.unlit;
  if (material.reflects() && programs.mirror != nullptr) return programs.mirror;
  return programs.maps != nullptr && material.needs_map_program() ? programs.maps : &programs.plain;
}

int ObjectPainter::draw_surfaces(const ShaderProgram& program, const Programs& programs,
                                 std::span<const ObjectDraw> draws, const CameraPose& pose) const {
  int calls = 0;
  bool culls = false;
  program.use();
  for (const ObjectDraw& draw : draws) {
    const auto index = static_cast<std::size_t>(draw.object);
    const GpuModel* gpu = models_[index].get();
    if (gpu == nullptr) continue;
    const bool phantom = phantoms_[index];
    const Model& model = *gpu->source;
    bool placed = false;
    for (const GpuMesh& mesh : gpu->meshes) {
      const Material& material = material_of(model, mesh.material);
      if (program_for(programs, material, phantom) != &program) continue;
      if (material.alpha_mode == AlphaMode::blend && !phantom) continue;
      if (!placed) {
        program.set("table_from_object", to_gl(draw.T_table_object));
        program.set("camera_from_object", camera_from_object(pose, draw.T_table_object));
        placed = true;
      }
      set_material(program, *gpu, mesh.material, &program != &programs.plain);
      // Phantoms occlude with either orientation of their faces.
      const bool one_sided = model.culls_back_faces && !material.double_sided && !phantom;
      if (one_sided != culls) one_sided ? glEnable(GL_CULL_FACE) : glDisable(GL_CULL_FACE);
      culls = one_sided;
      mesh.surface.draw(GL_TRIANGLES);
      ++calls;
    }
  }
  if (culls) glDisable(GL_CULL_FACE);
  return calls;
}

int ObjectPainter::draw_all(const Programs& programs, std::span<const ObjectDraw> draws,
                            const CameraPose& pose) const {
  glFrontFace(GL_CW);  // selects counter-clockwise faces, as row 0 of the framebuffer is the top
  int calls = 0;
  for (const ShaderProgram* program :
       {&programs.plain, programs.maps, programs.mirror, programs.unlit}) {
    if (program != nullptr) calls += draw_surfaces(*program, programs, draws, pose);
  }
  return calls;
}

int ObjectPainter::draw_phantoms(const FramePlan& plan, const LensUniforms& lens) const {
  if (plan.phantoms.empty()) return 0;
  const Programs programs = lit_program_.opaque();
  for_each(programs, [&lens](const ShaderProgram& program) { set_lens(program, lens); });
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  const int calls = draw_all(programs, plan.phantoms, plan.T_table_camera);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  return calls;
}

int ObjectPainter::draw_objects(const FramePlan& plan, const LensUniforms& lens,
                                Framebuffer& framebuffer) const {
  if (plan.objects.empty()) return 0;
  if (any_reflects(plan)) framebuffer.copy_image_reduced(kEnvironmentUnit);
  const Programs plain = lit_program_.opaque();
  begin_lit(plain, plan, lens);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  std::vector<ObjectDraw> faint;
  for (const ObjectDraw& draw : plan.objects) {
    if (draw.opacity < 1.0F) faint.push_back(draw);
  }
  if (faint.empty()) return draw_all(plain, plan.objects, plan.T_table_camera);
  int calls = 0;
  if (faint.size() < plan.objects.size()) {
    std::vector<ObjectDraw> solid = plan.objects;
    std::erase_if(solid, [](const ObjectDraw& draw) { return draw.opacity < 1.0F; });
    calls += draw_all(plain, solid, plan.T_table_camera);
  }
  std::ranges::stable_sort(faint, {}, &ObjectDraw::opacity);

  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  calls += draw_all(plain, faint, plan.T_table_camera);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  const Programs mixed = lit_program_.chosen();
  if (mode_ == Translucency::retexture) framebuffer.copy_image(kFramebufferCopyUnit);
  begin_lit(mixed, plan, lens);
  begin_translucent(mode_, Blending::mix);
  for (std::span<const ObjectDraw> left = faint; !left.empty();) {
    const float opacity = left.front().opacity;
    std::size_t count = 1;
    while (count < left.size() && left[count].opacity == opacity) ++count;
    for_each(mixed, [&](const ShaderProgram& program) { set_mixing(mode_, program, opacity); });
    calls += draw_all(mixed, left.first(count), plan.T_table_camera);
    left = left.subspan(count);
  }
  end_translucent();
  glDepthMask(GL_TRUE);
  glDepthFunc(GL_LESS);
  return calls;
}

int ObjectPainter::draw_blended(const FramePlan& plan, const LensUniforms& lens,
                                Framebuffer& framebuffer) const {
  if (!blends_) return 0;
  struct Surface {
    const ObjectDraw* draw;
    const GpuModel* model;
    GpuMesh* mesh;
    glm::mat4x3 camera_from_object;
    float depth;  // [m]
  };
  std::vector<Surface> surfaces;
  for (const ObjectDraw& draw : plan.objects) {
    GpuModel* gpu = models_[static_cast<std::size_t>(draw.object)].get();
    if (gpu == nullptr) continue;
    const glm::mat4x3 to_camera = camera_from_object(plan.T_table_camera, draw.T_table_object);
    for (GpuMesh& mesh : gpu->meshes) {
      if (mesh.faces.empty()) continue;
      const float depth = (to_camera * glm::vec4(mesh.middle, 1.0F)).z;
      surfaces.push_back({&draw, gpu, &mesh, to_camera, depth});
    }
  }
  if (surfaces.empty()) return 0;
  std::ranges::stable_sort(surfaces, std::greater<>(), &Surface::depth);

  const Programs programs = lit_program_.chosen();
  begin_lit(programs, plan, lens);
  const bool door = mode_ != Translucency::blend && mode_ != Translucency::retexture;
  glFrontFace(GL_CW);
  glDisable(GL_STENCIL_TEST);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(door ? GL_TRUE : GL_FALSE);
  int calls = 0;
  std::vector<std::pair<float, std::size_t>> order;
  std::vector<std::uint32_t> sorted;
  for (const Surface& surface : surfaces) {
    GpuMesh& mesh = *surface.mesh;
    const Model& model = *surface.model->source;
    order.clear();
    for (std::size_t i = 0; i < mesh.middles.size(); ++i) {
      const glm::vec3 at = surface.camera_from_object * glm::vec4(mesh.middles[i], 1.0F);
      order.emplace_back(-at.z, i);
    }
    std::ranges::sort(order);
    sorted.clear();
    for (const auto& [depth, face] : order)
      sorted.insert(sorted.end(), mesh.faces[face].begin(), mesh.faces[face].end());
    if (mode_ == Translucency::retexture) framebuffer.copy_image(kFramebufferCopyUnit);
    begin_translucent(mode_, Blending::see_through);
    const ShaderProgram& program = *program_for(programs, material_of(model, mesh.material), false);
    program.use();
    program.set("opacity", surface.draw->opacity);
    program.set("table_from_object", to_gl(surface.draw->T_table_object));
    program.set("camera_from_object", surface.camera_from_object);
    set_material(program, *surface.model, mesh.material, true);
    const bool one_sided =
        model.culls_back_faces && !material_of(model, mesh.material).double_sided;
    one_sided ? glEnable(GL_CULL_FACE) : glDisable(GL_CULL_FACE);
    mesh.surface.write_indices(sorted, BufferLife::every_frame);
    mesh.surface.draw(GL_TRIANGLES);
    ++calls;
  }
  glDisable(GL_CULL_FACE);
  end_translucent();
  glDepthMask(GL_TRUE);
  return calls;
}

int ObjectPainter::draw_alone(const ObjectDraw& draw, const FramePlan& plan,
                              const LensUniforms& lens) const {
  const Programs programs = lit_program_.opaque();
  for_each(programs, [&lens](const ShaderProgram& program) { set_lens(program, lens); });
  return draw_all(programs, {&draw, 1}, plan.T_table_camera);
}

int ObjectPainter::draw_darkened(const ObjectDraw& draw, const FramePlan& plan,
                                 const LensUniforms& lens, int light, float opacity,
                                 bool add_up) const {
  const Programs programs = darkening_program_.chosen();
  std::vector<float> blocked(plan.lights.size(), 0.0F);
  blocked.at(static_cast<std::size_t>(light)) = 1.0F;
  for_each(programs, [&](const ShaderProgram& program) {
    set_lens(program, lens);
    set_lights(program, plan, blocked);
    program.set("opacity", opacity);
    program.set("darkens", add_up ? 2 : 1);
  });
  return draw_all(programs, {&draw, 1}, plan.T_table_camera);
}

int ObjectPainter::draw_under_shadow(const ObjectDraw& draw, const FramePlan& plan,
                                     const LensUniforms& lens, const ShadowMask& mask,
                                     Gathering gathering) const {
  const ShaderProgram& p = masked_program_.get();
  p.use();
  set_lens(p, lens);
  p.set("eye", to_gl(plan.T_table_camera.translation()));
  p.set("mask_from_table", mask.plane_from_table);
  p.set("mask_normal", mask.normal);
  p.set("mask_origin", mask.origin);
  p.set("mask_extent", mask.extent);
  p.set("mask_levels", std::span<const glm::vec4>(mask.levels));
  p.set("mask_count", mask.level_count);
  p.set("gathering", static_cast<int>(gathering));
  p.set("mask_light_left", mask.encoded_factors);
  p.set("encoding", static_cast<float>(1.0 / plan.tone_exponent));
  p.set("mask_step", static_cast<float>(kLevelStep));
  p.set("mask_level_width", static_cast<float>(kLevelWidth));
  p.set("shadow_mask", kShadowMaskUnit);
  return draw_all({p, nullptr}, {&draw, 1}, plan.T_table_camera);
}

}  // namespace penumbra
