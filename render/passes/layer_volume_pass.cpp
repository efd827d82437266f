#include "render/passes/layer_volume_pass.hpp"

#include <epoxy/gl.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr unsigned kCountBits = kMostVolumesCounted;
constexpr unsigned kDoneBit = 0x40U;  // darkened already, by a darker layer
static_assert((kCountBits & kDoneBit) == 0);

// One layer of one caster, on those receivers that are as faint as each other.
struct Fill {
  const VolumeBuffers* volume = nullptr;
  float light_left = 1.0F;
  Eigen::Vector3d normal;  // of the plane
  std::vector<const ObjectDraw*> receivers;
};

}  // namespace

LayerVolumePass::LayerVolumePass(GlApi api, const CameraModel& camera) : api_(api) {
  if (make_lens(camera).model != 0) longest_edge_ = longest_edge(camera);
}

Result<void> LayerVolumePass::choose(const FramePlan& plan) {
  if (program_ || plan.climbing != Climbing::volumes) return {};
  PENUMBRA_TRY(auto linked, volume_program(api_));
  program_ = std::move(linked);
  return {};
}

void LayerVolumePass::prepare(const Scene& scene, const FramePlan& plan, ShadowPass& shadows,
                              ShadowWork& work) {
  ++frame_count_;
  if (!plan.reuse) volumes_.clear();
  if (plan.climbing == Climbing::volumes) {
    for (const ReceivedShadowDraw& draw : plan.received_shadows) {
      const ShadowDraw& shadow = draw.shadow;
      Volumes& volumes = volumes_[key_of(shadow)];
      if (std::exchange(volumes.last_used, frame_count_) == frame_count_) continue;
      if (volumes.valid && same_shapes(volumes.shadow, shadow)) {
        work.kept.push_back(
            {"layer_volume",
             fmt::format("{}: the volumes of its shadow are those of an earlier picture",
                         scene.objects[static_cast<std::size_t>(shadow.object)].name)});
        continue;
      }
      volumes.valid = true;
      volumes.shadow = shadow;
      const CasterOverPlane over = shadows.caster_over(scene, shadow, work);
      auto& caster = casters_[over.mesh];
      if (!caster) caster = std::make_unique<LayerVolumeCaster>(*over.mesh);
      const std::array<bool, 3> wanted = {shadow.umbra, shadow.middle, shadow.penumbra};
      for (std::size_t i = 0; i < 3; ++i) {
        std::unique_ptr<VolumeBuffers>& layer = volumes.layers[i];
        if (!wanted[i]) {
          layer.reset();
          continue;
        }
        if (!layer) layer = std::make_unique<VolumeBuffers>();
        const ShadowVolume made = caster->volume(over, kShadowLayers[i], shadow.plane_frame);
        work.vertices += static_cast<std::int64_t>(layer->write(made, longest_edge_));
      }
    }
  }
  std::erase_if(volumes_, [this](const auto& entry) {
    return entry.second.last_used + kFramesKept < frame_count_;
  });
}

int LayerVolumePass::draw(const Scene& scene, const FramePlan& plan, const LensUniforms& lens,
                          const ObjectPass& objects, Translucency way, Receivers& receivers,
                          Framebuffer& framebuffer) const {
  if (plan.climbing != Climbing::volumes) return 0;
  std::vector<Fill> fills;
  for (std::size_t i = 0; i < plan.received_shadows.size(); ++i) {
    const ShadowDraw& shadow = plan.received_shadows[i].shadow;
    const Volumes& volumes = volumes_.at(key_of(shadow));
    const auto like_it = [&shadow](const ReceivedShadowDraw& other) {
      return key_of(other.shadow) == key_of(shadow) && other.shadow.opacity == shadow.opacity;
    };
    if (std::ranges::any_of(std::span(plan.received_shadows).first(i), like_it)) continue;
    Fill fill;
    fill.normal = shadow.plane_frame.n;
    for (const ReceivedShadowDraw& other : plan.received_shadows) {
      const ObjectDraw* receiver = like_it(other) ? drawn_object(plan, other.receiver) : nullptr;
      if (receiver != nullptr) fill.receivers.push_back(receiver);
    }
    for (std::size_t layer = 0; layer < 3; ++layer) {
      fill.volume = volumes.layers[layer].get();
      fill.light_left = layer_light(shadow)[static_cast<glm::length_t>(layer)];
      const bool shows = fill.volume != nullptr && fill.volume->batches() > 0;
      if (shows && !fill.receivers.empty()) fills.push_back(fill);
    }
  }
  if (fills.empty()) return 0;
  std::ranges::stable_sort(fills, {}, &Fill::light_left);

  const glm::mat4x3 camera_from_table = camera_from_object(plan.T_table_camera, Placement());
  int calls = 0;
  glDepthMask(GL_FALSE);
  // Planes that are parallel have one light: what lies in its shadow for several is darkened once.
  std::vector<const Fill*> left;
  for (const Fill& fill : fills) left.push_back(&fill);
  while (!left.empty()) {
    const Eigen::Vector3d normal = left.front()->normal;
    const auto other = std::ranges::stable_partition(
        left, [&normal](const Fill* fill) { return (fill->normal - normal).norm() < 1e-3; });
    receivers.begin_marks();
    glEnable(GL_STENCIL_TEST);
    if (way == Translucency::retexture) framebuffer.copy_picture(kPictureBeforeUnit);
    for (auto at = left.begin(); at != other.begin(); ++at) {
      const Fill& fill = **at;
      for (std::size_t batch = 0; batch < fill.volume->batches(); ++batch) {
        count_volume(*program_, lens, camera_from_table, *fill.volume, batch, kDoneBit);
        glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
        begin_darkening(way);
        glEnable(GL_DEPTH_TEST);
        glDepthFunc(GL_EQUAL);
        // Each pixel once, though faces may lie in one place.
        glStencilMask(kCountBits | kDoneBit);
        glStencilFunc(GL_NOTEQUAL, static_cast<GLint>(kDoneBit), kCountBits);
        glStencilOp(GL_KEEP, GL_KEEP, GL_REPLACE);
        for (const ObjectDraw* receiver : fill.receivers) {
          calls += objects.draw_in_layer(scene, *receiver, plan, lens, fill.light_left);
        }
        end_translucent();
        glStencilMask(kCountBits);
        glClear(GL_STENCIL_BUFFER_BIT);
        ++calls;
      }
    }
    left.erase(left.begin(), other.begin());
  }
  glStencilMask(0xFF);
  glDisable(GL_STENCIL_TEST);
  glDepthFunc(GL_LESS);
  glDepthMask(GL_TRUE);
  return calls;
}

}  // namespace penumbra
