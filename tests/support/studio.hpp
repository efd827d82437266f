// Scenes built in memory and drawn offscreen, for tests of rendering.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <glm/common.hpp>
#include <glm/geometric.hpp>
#include <memory>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/geometry/pose_estimate.hpp"
#include "core/image/frame.hpp"
#include "render/compositor.hpp"
#include "render/frame_plan.hpp"
#include "render/gl/context.hpp"
#include "render/scene/scene.hpp"
#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra::test {

// Returns the model flat-shaded (separate vertices per triangle), with bounds and one material.
inline std::shared_ptr<const Model> finished(const Model& shape, const glm::vec4& color,
                                             const glm::vec3& emissive = glm::vec3(0.0F)) {
  auto model = std::make_shared<Model>();
  Material material;
  material.base_color = color;
  material.emissive = emissive;
  model->materials.push_back(material);
  bool first = true;
  for (const Mesh& source : shape.meshes) {
    Mesh& mesh = model->meshes.emplace_back();
    for (std::size_t i = 0; i + 2 < source.indices.size(); i += 3) {
      const glm::vec3 a = source.positions[source.indices[i]];
      const glm::vec3 b = source.positions[source.indices[i + 1]];
      const glm::vec3 c = source.positions[source.indices[i + 2]];
      const glm::vec3 cross = glm::cross(b - a, c - a);
      const float length = glm::length(cross);
      const glm::vec3 n = length > 0.0F ? cross / length : glm::vec3(0.0F, 0.0F, 1.0F);
      for (const glm::vec3& p : {a, b, c}) {
        mesh.indices.push_back(static_cast<std::uint32_t>(mesh.positions.size()));
        mesh.source_vertex.push_back(static_cast<std::uint32_t>(mesh.positions.size()));
        mesh.positions.push_back(p);
        mesh.normals.push_back(n);
        model->min_corner = first ? p : glm::min(model->min_corner, p);
        model->max_corner = first ? p : glm::max(model->max_corner, p);
        first = false;
      }
    }
    model->source_vertex_count += static_cast<std::uint32_t>(mesh.positions.size());
  }
  return model;
}

inline Placement at(double x, double y, double z, const Eigen::Vector3d& axis = {0, 0, 1},
                    double angle_rad = 0.0, double scale = 1.0) {
  return {{x, y, z}, Eigen::Quaterniond(Eigen::AngleAxisd(angle_rad, axis.normalized())), scale};
}

// Builds a scene with a table plane and one shadow node that contains every added object.
class SceneBuilder {
 public:
  SceneBuilder() {
    scene_.name = "test";
    scene_.file = "test.json";
    scene_.planes.emplace_back().name = "table";
    ShadowNode& node = scene_.shadows.emplace_back();
    node.name = "shadow";
    node.planes = {0};
  }
  int add(std::shared_ptr<const Model> model, const Placement& placement, bool casts = true,
          bool phantom = false) {
    SceneObject& object = scene_.objects.emplace_back();
    object.name = "object" + std::to_string(scene_.objects.size());
    object.model = std::move(model);
    object.placement = placement;
    object.phantom = phantom;
    const int index = static_cast<int>(scene_.objects.size()) - 1;
    if (casts) scene_.shadows[0].casters.push_back(index);
    return index;
  }
  Scene& scene() { return scene_; }
  [[nodiscard]] std::shared_ptr<const Scene> build() const {
    return std::make_shared<const Scene>(scene_);
  }

 private:
  Scene scene_;
};

// Camera at `eye` that looks towards `target`; the image's x axis is horizontal.
inline CameraPose look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target) {
  const Eigen::Vector3d z = (target - eye).normalized();
  Eigen::Vector3d x = z.cross(Eigen::Vector3d::UnitZ());
  if (x.norm() < 1e-6) x = Eigen::Vector3d::UnitX();
  x.normalize();
  Eigen::Matrix3d R;
  R << x, z.cross(x), z;
  return {R, eye};
}
inline PoseEstimate tracked(const CameraPose& T_table_camera) {
  PoseEstimate pose;
  pose.status = TrackStatus::tracked;
  pose.T_table_camera = T_table_camera;
  return pose;
}

inline CameraModel camera_of(int width, int height, double focal,
                             DistortionModel model = DistortionModel::plumb_bob,
                             const std::array<double, 8>& k = {}) {
  CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = focal;
  p.fy = focal * 0.997;
  p.cx = 0.5 * width + 2.3;
  p.cy = 0.5 * height - 2.4;
  p.model = model;
  p.distortion = k;
  return CameraModel::make(p).value();
}

// Camera with a square image and a distortion of a few pixels.
inline CameraModel distorted_camera(int side, double focal) {
  return camera_of(side, side, focal, DistortionModel::plumb_bob,
                   {-0.28, 0.08, 0.001, -0.0008, 0.0, 0.0, 0.0, 0.0});
}

inline Frame plain_frame(int width, int height, std::uint8_t value) {
  FrameBuffer buffer = allocate_frame(PixelFormat::grey8, width, height);
  for (int y = 0; y < height; ++y) {
    std::memset(buffer.plane_data[0] + y * buffer.frame.planes[0].stride, value,
                static_cast<std::size_t>(width));
  }
  return buffer.frame;
}

struct RenderedImage {
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> rgba;
  [[nodiscard]] const std::uint8_t* at(int x, int y) const {
    return rgba.data() + 4 * (static_cast<std::ptrdiff_t>(y) * width + x);
  }
  [[nodiscard]] int red(int x, int y) const { return *at(x, y); }
  friend bool operator==(const RenderedImage&, const RenderedImage&) = default;
};

// A context with a compositor. It uses one sample per pixel, also on a GPU, because tests compare
// images pixel by pixel.
class Studio {
 public:
  Studio(std::shared_ptr<const Scene> scene, const CameraModel& camera, GlApi api = GlApi::gl33,
         const CompositorOptions& options = {.msaa = 0})
      : scene_(std::move(scene)), camera_(camera) {
    auto context = create_offscreen_context(api);
    if (!context) throw std::runtime_error(context.error().message);
    context_ = std::move(*context);
    auto compositor = Compositor::create(*context_, scene_, camera, options);
    if (!compositor) throw std::runtime_error(compositor.error().message);
    compositor_ = std::make_unique<Compositor>(std::move(*compositor));
  }

  [[nodiscard]] FramePlan plan(const PoseEstimate& pose, const PlanOptions& options = {},
                               double time_s = 0.0) const {
    return plan_frame(*scene_, evaluate_scene(*scene_, time_s), pose, camera_, options);
  }
  RenderedImage draw(const Frame& frame, const FramePlan& plan) {
    context_->make_current();
    const auto stats = compositor_->draw(frame, plan);
    if (!stats) throw std::runtime_error(stats.error().message);
    stats_ = *stats;
    RenderedImage image{camera_.width(), camera_.height(), {}};
    image.rgba.resize(std::size_t{4} * static_cast<std::size_t>(image.width) *
                      static_cast<std::size_t>(image.height));
    const auto read = compositor_->read_back(image.rgba);
    if (!read) throw std::runtime_error(read.error().message);
    return image;
  }
  RenderedImage draw_shadows(const Frame& frame, FramePlan plan) {  // draws no objects
    plan.objects.clear();
    return draw(frame, plan);
  }
  [[nodiscard]] const CompositeStats& stats() const { return stats_; }
  [[nodiscard]] const CameraModel& camera() const { return camera_; }
  [[nodiscard]] const Scene& scene() const { return *scene_; }
  Compositor& compositor() { return *compositor_; }
  GlContext& context() { return *context_; }

 private:
  std::shared_ptr<const Scene> scene_;
  CameraModel camera_;
  std::unique_ptr<GlContext> context_;
  std::unique_ptr<Compositor> compositor_;
  CompositeStats stats_;
};

}  // namespace penumbra::test
