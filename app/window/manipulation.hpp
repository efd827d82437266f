// Hands on the objects: which one a ray meets, and what a drag makes of it. Pure: no window, no
// OpenGL.
//
// A drag moves an object in two axes, as the three buttons of Layered Penumbrae's experiment do:
// along the table (x, y), up and sideways (z and the picture's horizontal), up and away (z and the
// level direction into the picture); or it turns it (about the table's normal and about the
// picture's horizontal).
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

// What is at the pointer: a pixel of the picture as captured (lens and all), seen from a pose.
struct PointerView {
  Ray ray;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::UnitX();  // the picture's horizontal, level, unit
  double radians_per_px = 1e-3;                      // at the picture's centre
  double width_px = 640.0;                           // of the picture
};
// Nothing where the lens sends no ray to that pixel.
[[nodiscard]] std::optional<PointerView> view_at(const CameraModel& camera,
                                                 const CameraPose& T_table_camera,
                                                 const Eigen::Vector2d& pixel);

struct PickedPoint {
  int object = 0;         // index into Scene::objects
  double distance = 0.0;  // along the ray [m]
};
// The nearest surface that the ray meets, phantoms too: what a real thing hides can't be taken.
[[nodiscard]] std::optional<PickedPoint> pick(const Scene& scene, const SceneState& state,
                                              const Ray& ray);
// The object that all of it hangs on, itself or one before it.
[[nodiscard]] int root_of(const Scene& scene, int object);
// Lowest point above z = 0 of an object and what hangs on it, by their boxes [m].
[[nodiscard]] double lowest_point(const Scene& scene, const SceneState& state, int root);

// Where the scene's 3D cursor is when the pointer came here: on the pointer's ray at its own
// height, `raised` by so much [m], never below the table. Nothing where the scene has no cursor, or
// the ray meets that height nowhere near.
[[nodiscard]] std::optional<ObjectPlaced> cursor_at(const Scene& scene, const SceneState& state,
                                                    const PointerView& pointer, double raised);

enum class DragMode { slide, lift, reach, turn };

class Manipulator {
 public:
  // Takes what is at the pointer. The edit holds it where it is; nothing where nothing is.
  [[nodiscard]] std::optional<ObjectPlaced> take(const Scene& scene, const SceneState& state,
                                                 const PointerView& pointer, DragMode mode);
  // Where the object is after the pointer came here; nothing without an object in hand, or where
  // the pointer says nothing (past the horizon). Never below the table, unless it was.
  [[nodiscard]] std::optional<ObjectPlaced> drag(const PointerView& pointer) const;
  void let_go() { grab_.reset(); }
  [[nodiscard]] bool holding() const { return grab_.has_value(); }

  // Stands the selected object on the table at the pointer.
  [[nodiscard]] std::optional<ObjectPlaced> put(const Scene& scene, const SceneState& state,
                                                const PointerView& pointer) const;
  // By name: indices are of one scene only. Empty: none.
  [[nodiscard]] const std::string& selected() const { return selected_; }

 private:
  struct Grab {
    DragMode mode = DragMode::slide;
    std::string object;
    Placement start;
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  // that was taken, table frame
    double distance = 0.0;                            // to it [m]
    double clearance = 0.0;  // how far the object could sink [m]; 0 where it is below already
    PointerView pointer;
  };
  std::optional<Grab> grab_;
  std::string selected_;
};

}  // namespace penumbra
