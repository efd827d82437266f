#include "render/passes/layers/field_quad.hpp"

#include <algorithm>
#include <bit>

#include "core/propagate.hpp"
#include "render/passes/uniforms.hpp"

namespace penumbra {
namespace {

// Converts to half float: rounds to nearest, ties to even; clamps; values below 2^-14 become 0.
std::uint16_t half_float(float value) {
  constexpr float kLargest = 60'000.0F;
  constexpr std::uint32_t kSmallestNormal = 0x38800000U;
  constexpr std::uint32_t kBiasDifference = 0x38000000U;
  const float clamped = value > -kLargest ? (value < kLargest ? value : kLargest) : -kLargest;
  const auto bits = std::bit_cast<std::uint32_t>(clamped);
  const std::uint32_t sign = (bits >> 16U) & 0x8000U;
  const std::uint32_t magnitude = bits & 0x7FFFFFFFU;
  const std::uint32_t half =
      (magnitude - kBiasDifference + 0x0FFFU + ((magnitude >> 13U) & 1U)) >> 13U;
  return static_cast<std::uint16_t>(sign | (magnitude < kSmallestNormal ? 0U : half));
}

}  // namespace

void FieldTexture::upload(const ShadowField& field) {
  layers_ = {};
  if (field.width < 2 || field.height < 2) return;
  const std::size_t count =
      static_cast<std::size_t>(field.width) * static_cast<std::size_t>(field.height);
  texels_.assign(4 * count, 0);
  for (std::size_t layer = 0; layer < 3; ++layer) {
    const float* values = field.layer(kShadowLayers[layer]).data();
    float greatest = 0.0F;
    for (std::size_t i = 0; i < count; ++i) {
      greatest = values[i] > greatest ? values[i] : greatest;
      texels_[4 * i + layer] = half_float(values[i]);
    }
    layers_[layer] = greatest > 0.0F;
  }
  if (!texture_) texture_.emplace(filter_);
  texture_->upload(TexelFormat::rgba16f, field.width, field.height,
                   reinterpret_cast<const std::uint8_t*>(texels_.data()),
                   static_cast<std::ptrdiff_t>(8) * field.width);
  last_ = {static_cast<float>(field.width - 1), static_cast<float>(field.height - 1)};
  const auto cell = static_cast<float>(field.cell);
  rect_ = {static_cast<float>(field.origin.x() + 0.5 * field.cell),
           static_cast<float>(field.origin.y() + 0.5 * field.cell), cell * last_.x, cell * last_.y};
}

Result<FieldQuad> FieldQuad::create(GlApi api, double longest_edge_m, ShaderFiles fragment) {
  FieldQuad quad;
  PENUMBRA_TRY(quad.program_,
               TranslucentProgram::create(api, {"lens.glsl", "field.vert.glsl"},
                                          std::move(fragment), {}, Background::video));
  quad.longest_edge_m_ = longest_edge_m;
  return quad;
}

void FieldQuad::begin(const ShaderProgram& program, const LensUniforms& lens,
                      const glm::mat4x3& camera_from_plane) {
  program.use();
  set_lens(program, lens);
  program.set("camera_from_plane", camera_from_plane);
  program.set("field", 0);
  undistorted_ = lens.model == 0;
}

void FieldQuad::draw(const ShaderProgram& program, const FieldTexture& field,
                     const PlanarMotion& T_plane_own, const std::array<bool, 3>& wanted,
                     const glm::vec3& layer_light) const {
  program.use();
  program.set("layer_wanted", glm::vec3(wanted[0], wanted[1], wanted[2]));
  program.set("layer_light", layer_light);
  draw(program, field, T_plane_own);
}

void FieldQuad::draw(const ShaderProgram& program, const FieldTexture& field,
                     const PlanarMotion& T_plane_own) const {
  program.use();
  program.set("field_rect", field.rect_);
  program.set("field_last", field.last_);
  program.set("plane_from_own", glm::vec4(static_cast<float>(T_plane_own.cosine),
                                          static_cast<float>(T_plane_own.sine),
                                          static_cast<float>(T_plane_own.displacement.x()),
                                          static_cast<float>(T_plane_own.displacement.y())));
  field.texture_->bind(0);
  grids_.draw(UnitGrids::grid_for(static_cast<double>(std::max(field.rect_.z, field.rect_.w)),
                                  longest_edge_m_, undistorted_));
}

}  // namespace penumbra
