// Dragging objects: which one a ray meets, and where a drag moves it. Pure: no window, no OpenGL.
//
// A drag moves an object along two axes, as the three buttons of Layered Penumbrae's experiment do:
// along the table (x, y), up and sideways (z and the image's horizontal), up and away (z and the
// level direction into the image); or it turns the object about the table's normal and the image's
// horizontal.
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

// The pointer at a pixel of the image as captured (distorted), seen from a pose.
struct PointerView {
  Ray ray;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::UnitX();  // the image's horizontal, level, unit
  double radians_per_px = 1e-3;                      // at the image's centre
  double width_px = 640.0;                           // of the image
};
// Empty if the lens model has no ray for the pixel.
[[nodiscard]] std::optional<PointerView> view_at(const CameraModel& camera,
                                                 const CameraPose& T_table_camera,
                                                 const Eigen::Vector2d& pixel);

struct PickedPoint {
  int object = 0;         // index into Scene::objects
  double distance = 0.0;  // along the ray [m]
};
// The nearest surface on the ray. Includes phantoms: real objects hide what is behind them.
[[nodiscard]] std::optional<PickedPoint> pick(const Scene& scene, const SceneState& state,
                                              const Ray& ray);
// Lowest z of an object and its descendants, by their boxes [m].
[[nodiscard]] double lowest_point(const Scene& scene, const SceneState& state, int root);

// Moves the scene's 3D cursor onto the pointer's ray at its own height plus `raised` [m], never
// below the table. Empty if the scene has no cursor, or the ray does not meet that height nearby.
[[nodiscard]] std::optional<ObjectPlaced> cursor_at(const Scene& scene, const SceneState& state,
                                                    const PointerView& pointer, double raised);

enum class DragMode { slide, lift, reach, turn };  // in the order of kDragCommands

class Manipulator {
 public:
  // Grabs the object at the pointer. The edit places it where it is; empty if there is none.
  [[nodiscard]] std::optional<ObjectPlaced> take(const Scene& scene, const SceneState& state,
                                                 const PointerView& pointer, DragMode mode);
  // Moves the grabbed object to the pointer, never below the table unless it was. Empty without an
  // object, or if the pointer is beyond the horizon.
  [[nodiscard]] std::optional<ObjectPlaced> drag(const PointerView& pointer) const;
  void let_go() { grab_.reset(); }
  [[nodiscard]] bool holding() const { return grab_.has_value(); }

  // Puts the selected object on the table at the pointer.
  [[nodiscard]] std::optional<ObjectPlaced> put(const Scene& scene, const SceneState& state,
                                                const PointerView& pointer) const;
  // By name, as indices belong to one scene only. Empty: none.
  [[nodiscard]] const std::string& selected() const { return selected_; }

 private:
  struct Grab {
    DragMode mode = DragMode::slide;
    std::string object;
    Placement start;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  // grabbed, table frame
    double distance = 0.0;                            // to the point [m]
    double clearance = 0.0;  // height above the table [m]; 0 if it is below already
    PointerView pointer;
  };
  std::optional<Grab> grab_;
  std::string selected_;
};

}  // namespace penumbra
