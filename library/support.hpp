// Conversions between the public types and those of the modules, and from errors to exceptions.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <exception>
#include <memory>
#include <new>
#include <penumbra/camera.hpp>
#include <penumbra/error.hpp>
#include <penumbra/types.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

// Returns the value, or throws the error as an Exception.
template <class T>
[[nodiscard]] T value_or_throw(Result<T> result) {
  if (!result) throw Exception(result.error().message);
  return std::move(*result);
}
inline void throw_if_failed(const Result<void>& result) {
  if (!result) throw Exception(result.error().message);
}

// throw_failure("{}: {}: ...", argument, cause);
template <class... Args>
[[noreturn]] void throw_failure(fmt::format_string<Args...> text, Args&&... args) {
  throw Exception(without_control_characters(fmt::format(text, std::forward<Args>(args)...)));
}

// Calls the function. Turns exceptions of other libraries into an Exception; std::bad_alloc stays.
template <class Function>
auto guarded(Function&& function) {
  try {
    return std::forward<Function>(function)();
  } catch (const Exception&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception& error) {
    throw Exception(without_control_characters(error.what()));
  }
}

// Limit of times, so that differences of two times don't overflow.
inline constexpr std::int64_t kMaxTime_ns = std::int64_t{1} << 61U;

[[nodiscard]] inline Eigen::Vector3d to_eigen(const types::Vector3& v) {
  return {v[0], v[1], v[2]};
}
[[nodiscard]] inline Eigen::Vector2d to_eigen(const types::Vector2& v) {
  return {v[0], v[1]};
}
[[nodiscard]] inline types::Vector3 to_public(const Eigen::Vector3d& v) {
  return {v.x(), v.y(), v.z()};
}
[[nodiscard]] inline types::Vector2 to_public(const Eigen::Vector2d& v) {
  return {v.x(), v.y()};
}
template <class To, class From>
[[nodiscard]] types::Pose to_public(const Transform<To, From>& T) {
  const Eigen::Quaterniond& q = T.rotation();
  return {to_public(T.translation()), {q.x(), q.y(), q.z(), q.w()}};
}

// Throws if the pose is not finite or its quaternion is not of unit length (to 1 %). `place`: the
// argument's name in the message.
void check_pose(const types::Pose& pose, std::string_view place);
template <class To, class From>
[[nodiscard]] Transform<To, From> checked_transform(const types::Pose& pose,
                                                    std::string_view place) {
  check_pose(pose, place);
  const auto& q = pose.quaternion_xyzw;
  return {Eigen::Quaterniond(q[3], q[0], q[1], q[2]), to_eigen(pose.position)};
}

// Returns a frame that refers to the caller's pixels. Throws if the view is not valid.
[[nodiscard]] Frame checked_frame(const types::ImageView& image, std::string_view place);

namespace types {

struct CameraModel::Impl {
  penumbra::CameraModel camera;
  std::vector<std::string> warnings;
};

struct Access {
  [[nodiscard]] static const penumbra::CameraModel& model_of(const CameraModel& camera);
  [[nodiscard]] static CameraModel make(const penumbra::CameraModel& camera);
};

[[nodiscard]] penumbra::DistortionModel to_internal(DistortionModel model);
[[nodiscard]] DistortionModel to_public(penumbra::DistortionModel model);
[[nodiscard]] penumbra::CameraFileFormat format_of(CameraFileFormat format);

}  // namespace types
}  // namespace penumbra
