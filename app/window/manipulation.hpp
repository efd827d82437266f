// Picks and drags objects with the pointer. Uses neither a window nor OpenGL.
//
// A drag moves an object along two axes, like the three mouse buttons in the experiment of Layered
// Penumbrae: along the table (x, y); up and sideways (z and the image's horizontal); up and away (z
// and the horizontal direction away from the camera). A fourth mode rotates the object about the
// table's normal and the image's horizontal.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>

#include "app/session/scene_edit.hpp"
#include "core/camera/camera_model.hpp"
#include "core/geometry/transform.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// Table frame; the direction is of unit length.
struct Ray {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = -Eigen::Vector3d::UnitZ();
};

// The pointer at a pixel of the captured (distorted) image, with the camera at a given pose.
struct PointerView {
  Ray ray;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::UnitX();  // unit vector, the image's horizontal
  double radians_per_px = 1e-3;                      // angle of a pixel at the image's centre
  double width_px = 640.0;                           // width of the image
};
// Returns nullopt if the lens model has no ray for the pixel.
[[nodiscard]] std::optional<PointerView> view_at(const CameraModel& camera,
                                                 const CameraPose& T_table_camera,
                                                 const Eigen::Vector2d& pixel);

struct PickedPoint {
  int object = 0;         // index into Scene::objects
  double distance = 0.0;  // along the ray [m]
};
// Returns the nearest surface on the ray. Includes phantoms: real objects occlude virtual ones.
[[nodiscard]] std::optional<PickedPoint> pick(const Scene& scene, const SceneState& state,
                                              const Ray& ray);
// Returns the lowest z of the bounding boxes of `root` and its descendants [m]; infinity if none.
[[nodiscard]] double lowest_point(const Scene& scene, const SceneState& state, int root);

// Moves the scene's 3D cursor onto the pointer's ray at the cursor's height plus `raised` [m], but
// not below the table. Returns nullopt if the scene has no cursor, or if the ray does not reach
// that height within 5 m.
[[nodiscard]] std::optional<ObjectPlaced> cursor_at(const Scene& scene, const SceneState& state,
                                                    const PointerView& pointer, double raised);

enum class DragMode { slide, lift, reach, turn };  // same order as kDragCommands

class Manipulator {
 public:
  // Grabs the object at the pointer, if any. Returns an edit that leaves it in place, or nullopt.
  [[nodiscard]] std::optional<ObjectPlaced> take(const Scene& scene, const SceneState& state,
                                                 const PointerView& pointer, DragMode mode);
  // Moves the grabbed object to the pointer. An object cannot sink into the table, or deeper if it
  // is below. Returns nullopt if no object is grabbed or the pointer is too close to the horizon.
  [[nodiscard]] std::optional<ObjectPlaced> drag(const PointerView& pointer) const;
  void release_object() { grab_.reset(); }
  [[nodiscard]] bool holding() const { return grab_.has_value(); }

  // Puts the selected object on the table at the pointer.
  [[nodiscard]] std::optional<ObjectPlaced> put(const Scene& scene, const SceneState& state,
                                                const PointerView& pointer) const;
  // Name of the selected object; empty if none. An index would be valid in one scene only.
  [[nodiscard]] const std::string& selected() const { return selected_; }

 private:
  struct Grab {
    DragMode mode = DragMode::slide;
    std::string object;
    Placement start;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  // grabbed point, table frame
    double distance = 0.0;                            // camera to point [m]
    double clearance = 0.0;  // lowest height above the table [m]; 0 if already below
    PointerView pointer;
  };
  std::optional<Grab> grab_;
  std::string selected_;
};

}  // namespace penumbra
