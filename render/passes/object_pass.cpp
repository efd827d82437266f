#include "render/passes/object_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "core/assert.hpp"
#include "render/passes/lens_uniforms.hpp"
#include "render/passes/light_uniforms.hpp"
#include "render/shadow/receiving_levels.hpp"

namespace penumbra {
namespace {

struct Vertex {
  glm::vec3 position;
  glm::vec3 normal;
  glm::vec2 texcoord;
  glm::vec4 color;
};

}  // namespace

float longest_model_edge(double longest_edge_m, double scale) {
  return static_cast<float>(longest_edge_m / std::exp2(std::ceil(4.0 * std::log2(scale)) / 4.0));
}

Result<ObjectPass> ObjectPass::create(GlApi api, const Scene& scene, const CameraModel& camera) {
  if (scene.lights.size() > kMaxLights) {
    return fail("{}: lights: {} of them; at most {} can be drawn", scene.file, scene.lights.size(),
                kMaxLights);
  }
  constexpr std::array<std::string_view, 2> kVertex = {"lens.glsl", "object.vert.glsl"};
  constexpr std::array<std::string_view, 4> kFragment = {"ambient.glsl", "light_share.glsl",
                                                         "surface_normal.glsl", "object.frag.glsl"};
  constexpr std::array<std::string_view, 3> kMasked = {"shadow_mask.glsl", "surface_normal.glsl",
                                                       "masked.frag.glsl"};
  constexpr std::array<std::string_view, 1> kMaskDefines = {"MAX_LEVELS 64"};
  static_assert(kMostReceivingLevels == 64);
  auto program = TranslucentProgram::create(api, kVertex, kFragment, kLightDefines);
  if (!program) return tl::unexpected(program.error());
  auto masked = TranslucentProgram::create(api, kVertex, kMasked, kMaskDefines);
  if (!masked) return tl::unexpected(masked.error());
  ObjectPass pass(std::move(*program), std::move(*masked));
  if (const auto& tone = camera.parameters().tone_curve) {
    pass.tone_ = {static_cast<float>(1.0 / *tone), 1.0F, 0.0F, 0.0F};
  }

  const double longest = longest_edge(camera);
  const std::vector<double> scales = largest_scales(scene);
  std::map<std::pair<const Model*, float>, std::shared_ptr<GpuModel>> uploaded;
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const auto& model = scene.objects[i].model;
    pass.descriptions_.push_back(model);
    if (!model) {
      pass.models_.emplace_back();
      continue;
    }
    const float edge = longest_model_edge(longest, scales[i]);
    auto& entry = uploaded[{model.get(), edge}];
    if (!entry) entry = upload(*model, edge);
    pass.models_.push_back(entry);
  }
  return pass;
}

std::shared_ptr<ObjectPass::GpuModel> ObjectPass::upload(const Model& model, float max_edge) {
  auto gpu = std::make_shared<GpuModel>();
  for (const Texture& texture : model.textures) {
    gpu->textures.emplace_back(TextureFilter::trilinear);
    gpu->textures.back().upload(TexelFormat::srgb8_alpha8, texture.width, texture.height,
                                texture.rgba.data(), std::ptrdiff_t{4} * texture.width);
  }
  for (const Mesh& source : model.meshes) {
    const Mesh mesh = subdivided(source, max_edge);
    std::vector<Vertex> vertices(mesh.positions.size());
    for (std::size_t i = 0; i < vertices.size(); ++i) {
      vertices[i] = {mesh.positions[i], i < mesh.normals.size() ? mesh.normals[i] : glm::vec3(0.0F),
                     i < mesh.texcoords.size() ? mesh.texcoords[i] : glm::vec2(0.0F),
                     i < mesh.colors.size() ? mesh.colors[i] : glm::vec4(1.0F)};
    }
    GpuMesh& out = gpu->meshes.emplace_back();
    out.index_count = static_cast<int>(mesh.indices.size());
    out.material = mesh.material;
    out.layout.bind();
    out.vertices.write(std::span<const Vertex>(vertices));
    VertexArray::attribute(0, 3, sizeof(Vertex), offsetof(Vertex, position));
    VertexArray::attribute(1, 3, sizeof(Vertex), offsetof(Vertex, normal));
    VertexArray::attribute(2, 2, sizeof(Vertex), offsetof(Vertex, texcoord));
    VertexArray::attribute(3, 4, sizeof(Vertex), offsetof(Vertex, color));
    out.indices.write(std::span<const std::uint32_t>(mesh.indices));
  }
  return gpu;
}

Result<void> ObjectPass::choose(Translucency way, std::optional<PixelFormat> video) {
  way_ = way;
  if (auto chosen = program_.choose(way, video); !chosen) return chosen;
  return masked_program_.choose(way, video);
}

void ObjectPass::begin_lit(const ShaderProgram& program, const FramePlan& plan,
                           const LensUniforms& lens) const {
  program.use();
  set_lens(program, lens);
  set_light_uniforms(program, plan);
  program.set("tone", tone_);
  program.set("eye", to_gl(plan.T_table_camera.translation()));
  program.set("darkens", 0);
}

int ObjectPass::draw_all(const ShaderProgram& program, const Scene& scene,
                         std::span<const ObjectDraw> draws, const CameraPose& pose) const {
  PENUMBRA_ASSERT(models_.size() == scene.objects.size());
  const Material plain;
  int calls = 0;
  for (const ObjectDraw& draw : draws) {
    const auto index = static_cast<std::size_t>(draw.object);
    const GpuModel* gpu = models_[index].get();
    if (gpu == nullptr) continue;
    const Model& model = *descriptions_[index];
    program.set("table_from_object", to_gl(draw.T_table_object));
    program.set("camera_from_object", camera_from_object(pose, draw.T_table_object));
    for (const GpuMesh& mesh : gpu->meshes) {
      const auto at = static_cast<std::size_t>(mesh.material);
      const Material& material =
          mesh.material >= 0 && at < model.materials.size() ? model.materials[at] : plain;
      program.set("base_color", glm::vec3(material.base_color));
      program.set("emissive", material.emissive);
      program.set("metallic", material.metallic);
      program.set("roughness", material.roughness);
      const int texture = material.base_color_texture;
      const bool textured =
          texture >= 0 && static_cast<std::size_t>(texture) < gpu->textures.size();
      program.set("has_texture", textured ? 1 : 0);
      program.set("base_color_texture", 0);
      if (textured) gpu->textures[static_cast<std::size_t>(texture)].bind(0);
      mesh.layout.bind();
      glDrawElements(GL_TRIANGLES, mesh.index_count, GL_UNSIGNED_INT, nullptr);
      ++calls;
    }
  }
  return calls;
}

int ObjectPass::draw_phantoms(const Scene& scene, const FramePlan& plan,
                              const LensUniforms& lens) const {
  if (plan.phantoms.empty()) return 0;
  const ShaderProgram& program = program_.plain();
  program.use();
  set_lens(program, lens);
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  const int calls = draw_all(program, scene, plan.phantoms, plan.T_table_camera);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  return calls;
}

int ObjectPass::draw_objects(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                             Framebuffer& framebuffer) const {
  if (plan.objects.empty()) return 0;
  const ShaderProgram& plain = program_.plain();
  begin_lit(plain, plan, lens);
  glFrontFace(GL_CW);  // counter-clockwise faces, seen in a framebuffer whose row 0 is the top
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  glDisable(GL_STENCIL_TEST);
  glDisable(GL_BLEND);
  std::vector<ObjectDraw> faint;
  for (const ObjectDraw& draw : plan.objects) {
    if (draw.opacity < 1.0F) faint.push_back(draw);
  }
  if (faint.empty()) return draw_all(plain, scene, plan.objects, plan.T_table_camera);
  int calls = 0;
  if (faint.size() < plan.objects.size()) {
    std::vector<ObjectDraw> solid = plan.objects;
    std::erase_if(solid, [](const ObjectDraw& draw) { return draw.opacity < 1.0F; });
    calls += draw_all(plain, scene, solid, plan.T_table_camera);
  }
  std::ranges::stable_sort(faint, {}, &ObjectDraw::opacity);

  glColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  calls += draw_all(plain, scene, faint, plan.T_table_camera);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
  glDepthFunc(GL_EQUAL);
  glDepthMask(GL_FALSE);
  const ShaderProgram& mixed = program_.get();
  if (way_ == Translucency::retexture) framebuffer.copy_picture(kPictureBeforeUnit);
  begin_lit(mixed, plan, lens);
  mixed.set("picture_before", kPictureBeforeUnit);
  begin_mixing(way_);
  for (std::span<const ObjectDraw> left = faint; !left.empty();) {
    const float opacity = left.front().opacity;
    std::size_t count = 1;
    while (count < left.size() && left[count].opacity == opacity) ++count;
    set_mixing(way_, mixed, opacity);
    calls += draw_all(mixed, scene, left.first(count), plan.T_table_camera);
    left = left.subspan(count);
  }
  end_translucent();
  glDepthMask(GL_TRUE);
  glDepthFunc(GL_LESS);
  return calls;
}

int ObjectPass::draw_alone(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                           const LensUniforms& lens) const {
  const ShaderProgram& program = program_.plain();
  program.use();
  set_lens(program, lens);
  return draw_all(program, scene, {&draw, 1}, plan.T_table_camera);
}

int ObjectPass::draw_darkened(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                              const LensUniforms& lens, int light, float opacity,
                              bool add_up) const {
  const ShaderProgram& program = program_.get();
  program.use();
  set_lens(program, lens);
  std::vector<float> blocked(plan.lights.size(), 0.0F);
  blocked.at(static_cast<std::size_t>(light)) = 1.0F;
  set_light_uniforms(program, plan, blocked);
  program.set("eye", to_gl(plan.T_table_camera.translation()));
  program.set("opacity", opacity);
  program.set("darkens", add_up ? 2 : 1);
  program.set("picture_before", kPictureBeforeUnit);
  program.set("sums_before", kSumsBeforeUnit);
  glFrontFace(GL_CW);
  const int calls = draw_all(program, scene, {&draw, 1}, plan.T_table_camera);
  program.set("darkens", 0);
  return calls;
}

int ObjectPass::draw_under_shadow(const Scene& scene, const ObjectDraw& draw, const FramePlan& plan,
                                  const LensUniforms& lens, const ShadowMask& mask) const {
  const ShaderProgram& p = masked_program_.get();
  p.use();
  p.set("picture_before", kPictureBeforeUnit);
  set_lens(p, lens);
  p.set("eye", to_gl(plan.T_table_camera.translation()));
  p.set("mask_from_table", mask.plane_from_table);
  p.set("mask_normal", mask.normal);
  p.set("mask_origin", mask.origin);
  p.set("mask_extent", mask.extent);
  p.set("mask_levels", std::span<const glm::vec4>(mask.levels));
  p.set("mask_count", mask.level_count);
  p.set("mask_layer", mask.layer);
  p.set("mask_light_left", mask.light_left);
  p.set("mask_step", static_cast<float>(kLevelStep));
  p.set("shadow_mask", kShadowMaskUnit);
  glFrontFace(GL_CW);
  return draw_all(p, scene, {&draw, 1}, plan.T_table_camera);
}

}  // namespace penumbra
