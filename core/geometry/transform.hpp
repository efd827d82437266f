// Rigid transforms with both frames in the variable's name and in the type.
//   Transform<Table, Camera> T_table_camera;   p_table = T_table_camera * p_camera
// T_a_b * T_b_c compiles, T_a_b * T_c_b does not. Right-handed frames, metres.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace penumbra {

// Frames. Table: origin at the board's centre, x right, y up on the sheet, z out of the table.
// Camera: OpenCV optical axes, x right, y down, z forward. Tag: origin at the tag's centre, x right
// and y up on the upright printed tag, z out of the paper. Object: a model's frame, z up (loading
// rotates glTF files). Map: frame of the tags or points of a tracker or solver; its caller chooses
// it (the table, the middle of a group of tags, or a board).
namespace frame {
struct Table;
struct Camera;
struct Tag;
struct Object;
struct Map;
}  // namespace frame

template <class To, class From>
class Transform {
 public:
  Transform() = default;
  // Normalises the rotation, so that rounding errors do not accumulate in products.
  Transform(const Eigen::Quaterniond& rotation, const Eigen::Vector3d& translation)
      : rotation_(rotation.normalized()), translation_(translation) {}
  Transform(const Eigen::Matrix3d& rotation, const Eigen::Vector3d& translation)
      : Transform(Eigen::Quaterniond(rotation), translation) {}

  [[nodiscard]] static Transform identity() { return {}; }
  // Returns T with the same numbers. Frame To must coincide with frame Same.
  template <class Same>
  [[nodiscard]] static Transform renamed(const Transform<Same, From>& T) {
    Transform result;
    result.rotation_ = T.rotation();
    result.translation_ = T.translation();
    return result;
  }

  [[nodiscard]] const Eigen::Quaterniond& rotation() const { return rotation_; }
  [[nodiscard]] const Eigen::Vector3d& translation() const { return translation_; }
  [[nodiscard]] Eigen::Matrix3d rotation_matrix() const { return rotation_.toRotationMatrix(); }
  [[nodiscard]] Eigen::Matrix4d matrix() const {
    Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
    m.topLeftCorner<3, 3>() = rotation_matrix();
    m.topRightCorner<3, 1>() = translation_;
    return m;
  }
  [[nodiscard]] bool is_finite() const {
    return rotation_.coeffs().allFinite() && translation_.allFinite();
  }

  [[nodiscard]] Transform<From, To> inverse() const {
    const Eigen::Quaterniond inverse_rotation = rotation_.conjugate();
    return {inverse_rotation, -(inverse_rotation * translation_)};
  }

  template <class Other>
  [[nodiscard]] Transform<To, Other> operator*(const Transform<From, Other>& other) const {
    return {rotation_ * other.rotation(), rotation_ * other.translation() + translation_};
  }
  // Transforms a point from frame From to frame To.
  [[nodiscard]] Eigen::Vector3d operator*(const Eigen::Vector3d& p_from) const {
    return rotation_ * p_from + translation_;
  }

 private:
  Eigen::Quaterniond rotation_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation_ = Eigen::Vector3d::Zero();
};

using CameraPose = Transform<frame::Table, frame::Camera>;   // T_table_camera
using MapFromCamera = Transform<frame::Map, frame::Camera>;  // T_map_camera

// Return the pose with its frame renamed; the map frame must be the table frame.
[[nodiscard]] inline MapFromCamera as_map_pose(const CameraPose& T_table_camera) {
  return MapFromCamera::renamed(T_table_camera);
}
[[nodiscard]] inline CameraPose as_table_pose(const MapFromCamera& T_map_camera) {
  return CameraPose::renamed(T_map_camera);
}

}  // namespace penumbra
