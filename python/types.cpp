// Pose, CameraModel and load_image().
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cmath>
#include <limits>
#include <penumbra/camera.hpp>

#include "bindings.hpp"
#include "names.hpp"

namespace penumbra::python {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

types::Pose make_pose(const py::object& position, const py::object& quaternion) {
  const types::Pose pose = {numbers<3>(position, "position"),
                            numbers<4>(quaternion, "quaternion_xyzw")};
  double squares = 0.0;
  for (const double value : pose.quaternion_xyzw) squares += value * value;
  constexpr double kTolerance = 0.01;  // of the library
  if (!(std::abs(std::sqrt(squares) - 1.0) < kTolerance)) {
    throw ArgumentError("quaternion_xyzw: has length " +
                        py::str(py::float_(std::sqrt(squares))).cast<std::string>() +
                        "; give a unit quaternion (x, y, z, w)");
  }
  return pose;
}

std::size_t coefficient_count(types::DistortionModel model) {
  switch (model) {
    case types::DistortionModel::rational:
      return 8;
    case types::DistortionModel::fisheye:
      return 4;
    case types::DistortionModel::plumb_bob:
      break;
  }
  return 5;
}

types::CameraModel make_camera(int width, int height, double fx, double fy, double cx, double cy,
                               const std::string& model, const py::object& distortion,
                               std::optional<double> tone_curve,
                               std::optional<double> rolling_shutter_row_s,
                               std::optional<double> overlay_sigma_px) {
  types::CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = fx;
  p.fy = fy;
  p.cx = cx;
  p.cy = cy;
  p.model = value_of(kDistortionModels, "model", model);
  const Doubles coefficients = doubles(distortion, "distortion");
  // OpenCV keeps them in a row or a column.
  const bool in_line =
      coefficients.ndim() == 1 ||
      (coefficients.ndim() == 2 && (coefficients.shape(0) == 1 || coefficients.shape(1) == 1));
  const auto count = static_cast<std::size_t>(coefficients.size());
  if ((count > 0 && !in_line) || count > coefficient_count(p.model)) {
    throw_shape(distortion, "distortion",
                "up to " + std::to_string(coefficient_count(p.model)) + " coefficients for '" +
                    model + "'");
  }
  for (std::size_t i = 0; i < count; ++i) p.distortion[i] = coefficients.data()[i];
  p.tone_curve = tone_curve;
  p.rolling_shutter_row_s = rolling_shutter_row_s;
  p.overlay_sigma_px = overlay_sigma_px;
  return types::CameraModel(p);
}

// Maps each row of an array of In numbers (or a single row) to Out numbers; NaN if there are none.
template <std::size_t In, std::size_t Out, class Map>
py::array_t<double> map_rows(const py::object& value, const char* argument, const Map& map) {
  const Doubles given = doubles(value, argument);
  constexpr auto kIn = static_cast<py::ssize_t>(In);
  if (given.ndim() < 1 || given.ndim() > 2 || given.shape(given.ndim() - 1) != kIn) {
    throw_shape(value, argument,
                "N x " + std::to_string(In) + ", or " + std::to_string(In) + " numbers");
  }
  const py::ssize_t count = given.size() / kIn;
  std::vector<py::ssize_t> shape = {static_cast<py::ssize_t>(Out)};
  if (given.ndim() == 2) shape.insert(shape.begin(), count);
  py::array_t<double> result(std::move(shape));
  const double* from = given.data();
  double* to = result.mutable_data();
  unlocked([&] {
    for (py::ssize_t i = 0; i < count; ++i, from += In, to += Out) {
      std::array<double, In> row{};
      std::copy_n(from, In, row.begin());
      std::array<double, Out> mapped{};
      mapped.fill(kNan);
      if (const auto found = map(row)) mapped = *found;
      std::copy_n(mapped.begin(), Out, to);
    }
  });
  return result;
}

py::array_t<double> camera_matrix(const types::CameraModel& camera) {
  const types::CameraParameters p = camera.parameters();
  const std::array<double, 9> K = {p.fx, 0.0, p.cx, 0.0, p.fy, p.cy, 0.0, 0.0, 1.0};
  return matrix_of(K.data(), 3, 3);
}

void bind_pose(py::module_& module) {
  py::class_<types::Pose>(module, "Pose",
                          R"(A rigid transform T_a_b from frame b to frame a: p_a = R p_b + t.

Immutable. Functions that take a pose also take its 4 x 4 matrix. np.asarray(pose) is the matrix,
so pose @ point and np.linalg.inv(pose) work.)")
      .def(py::init(&make_pose), py::arg("position") = py::make_tuple(0.0, 0.0, 0.0),
           py::arg("quaternion_xyzw") = py::make_tuple(0.0, 0.0, 0.0, 1.0),
           R"(position: translation t [m].
quaternion_xyzw: rotation R as a unit quaternion (to 1 %).)")
      .def_static(
          "from_matrix", [](const py::object& matrix) { return pose_of(matrix, "matrix"); },
          py::arg("matrix"), "Pose of a 4 x 4 matrix, whose rotation must be orthonormal to 1e-6.")
      .def_property_readonly(
          "position", [](const types::Pose& pose) { return array_of(pose.position); },
          "Translation [m], shape (3,). A new array.")
      .def_property_readonly(
          "quaternion_xyzw", [](const types::Pose& pose) { return array_of(pose.quaternion_xyzw); },
          "Rotation as a unit quaternion (x, y, z, w), shape (4,). A new array.")
      .def_property_readonly(
          "matrix", [](const types::Pose& pose) { return array_of(pose); },
          "The 4 x 4 matrix. The translation has the bits of `position`; the rotation is computed "
          "from the quaternion. A new array.")
      .def(
          "__array__",
          [](const types::Pose& pose, const py::object& dtype, const py::object&) -> py::object {
            const py::array_t<double> matrix = array_of(pose);
            if (dtype.is_none()) return matrix;
            return matrix.attr("astype")(dtype);
          },
          py::arg("dtype") = py::none(), py::arg("copy") = py::none(), "The 4 x 4 matrix.")
      .def(py::pickle(
          [](const types::Pose& pose) {
            return py::make_tuple(pose.position, pose.quaternion_xyzw);
          },
          [](const py::tuple& state) {
            check_fields(state, 2);
            return make_pose(state[0], state[1]);
          }))
      .def(
          "__eq__",
          [](const types::Pose& a, const types::Pose& b) {
            return a.position == b.position && a.quaternion_xyzw == b.quaternion_xyzw;
          },
          py::is_operator())
      .def("__repr__", [](const types::Pose& pose) {
        return py::str("Pose(position={}, quaternion_xyzw={})")
            .format(array_of(pose.position).attr("tolist")(),
                    array_of(pose.quaternion_xyzw).attr("tolist")());
      });
}

template <class Member>
auto parameter(Member member) {
  return [member](const types::CameraModel& camera) { return camera.parameters().*member; };
}

void bind_parameters(py::class_<types::CameraModel>& type) {
  using types::CameraModel;
  using types::CameraParameters;
  type.def_property_readonly("width", parameter(&CameraParameters::width), "Image width [px].")
      .def_property_readonly("height", parameter(&CameraParameters::height), "Image height [px].")
      .def_property_readonly("fx", parameter(&CameraParameters::fx), "Focal length in x [px].")
      .def_property_readonly("fy", parameter(&CameraParameters::fy), "Focal length in y [px].")
      .def_property_readonly("cx", parameter(&CameraParameters::cx), "Principal point, x [px].")
      .def_property_readonly("cy", parameter(&CameraParameters::cy), "Principal point, y [px].")
      .def_property_readonly("matrix", &camera_matrix,
                             "Camera matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], shape (3, 3).")
      .def_property_readonly(
          "model",
          [](const CameraModel& camera) {
            return name_of(kDistortionModels, camera.parameters().model);
          },
          "Distortion model: 'plumb_bob', 'rational' or 'fisheye'.")
      .def_property_readonly(
          "distortion",
          [](const CameraModel& camera) {
            const CameraParameters p = camera.parameters();
            return py::array_t<double>(static_cast<py::ssize_t>(coefficient_count(p.model)),
                                       p.distortion.data());
          },
          "Coefficients of the distortion model, in OpenCV's order: 5, 8 or 4.")
      .def_property_readonly("tone_curve", parameter(&CameraParameters::tone_curve),
                             "Camera response (gamma exponent), or None if unknown.")
      .def_property_readonly("rolling_shutter_row_s",
                             parameter(&CameraParameters::rolling_shutter_row_s),
                             "Time between the read-outs of two rows [s], or None.")
      .def_property_readonly("overlay_sigma_px", parameter(&CameraParameters::overlay_sigma_px),
                             "Overlay error (1 sigma) due to the lens [px], or None.")
      .def_property_readonly("warnings", &CameraModel::warnings,
                             "Assumptions and implausible values of the loaded file.");
}

void bind_camera(py::module_& module) {
  using types::CameraModel;
  py::class_<CameraModel> type(module, "CameraModel", R"(A camera and its lens.

Camera frame: x right, y down, z forward, as in OpenCV and ROS. Pixel (0, 0) is the centre of the
top left pixel. Immutable; threads may share it.)");
  type.def(py::init(&make_camera), py::arg("width"), py::arg("height"), py::arg("fx"),
           py::arg("fy"), py::arg("cx"), py::arg("cy"), py::arg("model") = "plumb_bob",
           py::arg("distortion") = py::tuple(), py::kw_only(), py::arg("tone_curve") = py::none(),
           py::arg("rolling_shutter_row_s") = py::none(), py::arg("overlay_sigma_px") = py::none(),
           R"(Camera from its parameters.

width, height: size of the images [px].
fx, fy, cx, cy: focal lengths and principal point [px].
model: 'plumb_bob' (k1 k2 p1 p2 k3), 'rational' (k1 k2 p1 p2 k3 k4 k5 k6), both in OpenCV's order,
    or 'fisheye' (k1 k2 k3 k4 of OpenCV's fisheye module).
distortion: these coefficients; missing ones are 0.
tone_curve: camera response (gamma exponent), if known.
rolling_shutter_row_s: time between the read-outs of two rows [s].
overlay_sigma_px: overlay error (1 sigma) due to the lens [px].

Raises Error if a number is not finite or out of range.)")
      .def_static("load", &CameraModel::load, py::arg("file"), py::arg("name") = "",
                  py::call_guard<Unlocked>(), R"(Reads a camera file.

Reads camera_info YAML of ROS, YAML, JSON and XML of OpenCV, camchain.yaml of Kalibr and
.cameramodel of mrcal. `name` selects one of several cameras. Raises Error.)")
      .def(
          "save",
          [](const CameraModel& camera, const std::filesystem::path& file,
             const std::string& format) {
            const auto chosen = value_of(kCameraFormats, "format", format);
            unlocked([&] { camera.save(file, chosen); });
          },
          py::arg("file"), py::arg("format") = "ros",
          "Writes a camera file. format: 'ros', 'opencv' or 'kalibr'. Raises Error if the format "
          "cannot represent the lens or the file cannot be written.")
      .def(
          "project",
          [](const CameraModel& camera, const py::object& points) {
            return map_rows<3, 2>(points, "points",
                                  [&](const types::Vector3& p) { return camera.project(p); });
          },
          py::arg("points"), R"(Pixels of points in the camera frame.

points: [m], shape (N, 3) or (3,). Returns pixels of shape (N, 2) or (2,), which may lie outside the
image. NaN if a point is behind the camera or where the distortion is not monotonic.)")
      .def(
          "unproject",
          [](const CameraModel& camera, const py::object& pixels) {
            return map_rows<2, 3>(pixels, "pixels",
                                  [&](const types::Vector2& p) { return camera.unproject(p); });
          },
          py::arg("pixels"), R"(Directions (x, y, 1) in the camera frame that project to pixels.

pixels: shape (N, 2) or (2,). Returns shape (N, 3) or (3,); NaN if there is none.)")
      .def(py::pickle(
          [](const CameraModel& camera) {
            const types::CameraParameters p = camera.parameters();
            return py::make_tuple(p.width, p.height, p.fx, p.fy, p.cx, p.cy,
                                  name_of(kDistortionModels, p.model), p.distortion, p.tone_curve,
                                  p.rolling_shutter_row_s, p.overlay_sigma_px);
          },
          [](const py::tuple& state) {
            check_fields(state, 11);
            using Number = std::optional<double>;
            types::CameraParameters p;
            p.width = state[0].cast<int>();
            p.height = state[1].cast<int>();
            p.fx = state[2].cast<double>();
            p.fy = state[3].cast<double>();
            p.cx = state[4].cast<double>();
            p.cy = state[5].cast<double>();
            p.model = value_of(kDistortionModels, "model", state[6].cast<std::string>());
            p.distortion = numbers<8>(state[7], "distortion");
            p.tone_curve = state[8].cast<Number>();
            p.rolling_shutter_row_s = state[9].cast<Number>();
            p.overlay_sigma_px = state[10].cast<Number>();
            return CameraModel(p);
          }))
      .def("__repr__", [](const CameraModel& camera) {
        const types::CameraParameters p = camera.parameters();
        return py::str("<penumbra.CameraModel {} x {} px, fx {:.6g}, fy {:.6g}, {}>")
            .format(p.width, p.height, p.fx, p.fy, name_of(kDistortionModels, p.model));
      });
  bind_parameters(type);
}

}  // namespace

void bind_types(py::module_& module) {
  bind_pose(module);
  bind_camera(module);
  module.def(
      "load_image",
      [](const std::filesystem::path& file) {
        const types::Image image = unlocked([&] { return types::Image::load(file); });
        return array_of(image);
      },
      py::arg("file"), R"(Decodes a PNG or JPEG file, as the program does.

Returns a read-only uint8 array: of a JPEG the luma, shape (height, width); of a PNG grey values or
RGB, shape (height, width, 3). 16-bit samples are reduced to 8. Raises Error if the file is missing,
damaged or of another format.)");
}

}  // namespace penumbra::python
