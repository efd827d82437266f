// Trajectory and evaluate().
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cmath>
#include <limits>
#include <penumbra/evaluation.hpp>

#include "bindings.hpp"

namespace penumbra::python {
namespace {

using evaluation::Errors;
using evaluation::Statistics;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Poses with times.
struct Trajectory {
  evaluation::Trajectory poses;
};

std::optional<double> predicted(double value) {
  if (value != value) return std::nullopt;  // NaN: not known
  return value;
}

Trajectory make_trajectory(const py::object& times_ns, const py::object& positions,
                           const py::object& quaternions, const py::object& predicted_px) {
  Trajectory trajectory;
  if (!py::isinstance<py::iterable>(times_ns)) {
    throw py::type_error("times_ns: is a " + describe(times_ns) + "; give a list of integers");
  }
  std::vector<std::int64_t> times;
  for (const py::handle time : times_ns) {
    times.push_back(nanoseconds(py::reinterpret_borrow<py::object>(time), "times_ns"));
  }
  const auto t = rows<3>(positions, "positions");
  const auto q = rows<4>(quaternions, "quaternions_xyzw");
  std::vector<double> errors(times.size(), kNan);
  if (!predicted_px.is_none()) {
    const Doubles given = doubles(predicted_px, "predicted_px");
    if (given.ndim() != 1) throw_shape(predicted_px, "predicted_px", "a number for each pose");
    errors.assign(given.data(), given.data() + given.size());
  }
  if (t.size() != times.size() || q.size() != times.size() || errors.size() != times.size()) {
    throw ArgumentError("times_ns, positions, quaternions_xyzw and predicted_px: have " +
                        std::to_string(times.size()) + ", " + std::to_string(t.size()) + ", " +
                        std::to_string(q.size()) + " and " + std::to_string(errors.size()) +
                        " rows; give the same number of each");
  }
  for (std::size_t i = 0; i < times.size(); ++i) {
    trajectory.poses.push_back({times[i], {t[i], q[i]}, predicted(errors[i])});
  }
  return trajectory;
}

void append(Trajectory& self, const py::object& time_ns, const py::object& pose,
            std::optional<double> predicted_px) {
  const types::Pose added = pose_of(pose, "pose");
  for (const double value : added.position) {
    if (!std::isfinite(value)) {
      throw Exception(
          "pose: is not a number, as of a lost frame; append only poses of frames with has_pose");
    }
  }
  self.poses.push_back({nanoseconds(time_ns, "time_ns"), added,
                        predicted_px ? predicted(*predicted_px) : std::nullopt});
}

// The poses of a slice, or the time and the pose of an index.
py::object item(const Trajectory& self, const py::object& index) {
  const std::size_t size = self.poses.size();
  if (py::isinstance<py::slice>(index)) {
    std::size_t start = 0;
    std::size_t stop = 0;
    std::size_t step = 0;
    std::size_t count = 0;
    if (!py::reinterpret_borrow<py::slice>(index).compute(size, &start, &stop, &step, &count)) {
      throw py::error_already_set();
    }
    Trajectory part;
    for (std::size_t i = 0; i < count; ++i, start += step) part.poses.push_back(self.poses[start]);
    return py::cast(std::move(part));
  }
  std::int64_t at = nanoseconds(index, "index");
  if (at < 0) at += static_cast<std::int64_t>(size);
  if (at < 0 || at >= static_cast<std::int64_t>(size)) {
    throw py::index_error("the trajectory has " + std::to_string(size) + " poses");
  }
  const evaluation::StampedPose& pose = self.poses[static_cast<std::size_t>(at)];
  return py::make_tuple(pose.timestamp_ns, pose.T_table_camera);
}

// Returns an array with a value, or a row, of each pose.
template <class Value, class Row>
py::array_t<Value> columns(const Trajectory& self, std::vector<py::ssize_t> row_shape,
                           const Row& row) {
  row_shape.insert(row_shape.begin(), static_cast<py::ssize_t>(self.poses.size()));
  py::array_t<Value> array(std::move(row_shape));
  Value* to = array.mutable_data();
  for (const evaluation::StampedPose& pose : self.poses) {
    for (const Value value : row(pose)) *to++ = value;
  }
  return array;
}

void bind_trajectory(py::module_& module) {
  using evaluation::StampedPose;
  py::class_<Trajectory>(module, "Trajectory", R"(Poses with times, in the order of time.

For a camera they are T_table_camera, for a group of tags T_table_group. A slice is a Trajectory; an
index gives the time [ns] and the Pose.)")
      .def(py::init(&make_trajectory), py::arg("times_ns") = py::tuple(),
           py::arg("positions") = py::tuple(), py::arg("quaternions_xyzw") = py::tuple(),
           py::arg("predicted_px") = py::none(), R"(times_ns: integers, shape (N,).
positions: [m], shape (N, 3). quaternions_xyzw: unit quaternions, shape (N, 4).
predicted_px: predicted overlay errors [px], shape (N,); NaN where not known.

The functions that take a trajectory check the values.)")
      .def_static(
          "load",
          [](const std::filesystem::path& file) {
            return unlocked([&] { return Trajectory{evaluation::load_trajectory(file)}; });
          },
          py::arg("file"),
          "Reads a TUM file (timestamp tx ty tz qx qy qz qw), ground truth of EuRoC, or the "
          "tracked "
          "poses of a frame log (--frame-log FILE.csv) with predicted_px. Raises Error.")
      .def(
          "save",
          [](const Trajectory& self, const std::filesystem::path& file) {
            const evaluation::Trajectory poses = self.poses;  // append() may run meanwhile
            unlocked([&] { evaluation::save_trajectory(file, poses); });
          },
          py::arg("file"),
          "Writes a TUM file, as `penumbra replay --poses` does, without predicted_px. Raises "
          "Error.")
      .def("append", &append, py::arg("time_ns"), py::arg("pose"),
           py::arg("predicted_px") = py::none(),
           "Adds a pose: a Pose or a 4 x 4 matrix. predicted_px: predicted overlay error [px].")
      .def_property_readonly(
          "times_ns",
          [](const Trajectory& self) {
            return columns<std::int64_t>(
                self, {}, [](const StampedPose& pose) { return std::array{pose.timestamp_ns}; });
          },
          "Times [ns], int64, shape (N,). A new array.")
      .def_property_readonly(
          "positions",
          [](const Trajectory& self) {
            return columns<double>(
                self, {3}, [](const StampedPose& pose) { return pose.T_table_camera.position; });
          },
          "Positions [m], shape (N, 3). A new array.")
      .def_property_readonly(
          "quaternions_xyzw",
          [](const Trajectory& self) {
            return columns<double>(self, {4}, [](const StampedPose& pose) {
              return pose.T_table_camera.quaternion_xyzw;
            });
          },
          "Unit quaternions, shape (N, 4). A new array.")
      .def_property_readonly(
          "matrices",
          [](const Trajectory& self) {
            return columns<double>(self, {4, 4}, [](const StampedPose& pose) {
              return matrix_of(pose.T_table_camera);
            });
          },
          "The poses as matrices, shape (N, 4, 4). A new array.")
      .def_property_readonly(
          "predicted_px",
          [](const Trajectory& self) {
            return columns<double>(self, {}, [](const StampedPose& pose) {
              return std::array{pose.predicted_px.value_or(kNan)};
            });
          },
          "Predicted overlay errors [px], NaN where not known, shape (N,). A new array.")
      .def("__len__", [](const Trajectory& self) { return self.poses.size(); })
      .def("__getitem__", &item, py::arg("index"))
      .def("__repr__", [](const Trajectory& self) {
        return py::str("<penumbra.Trajectory of {} poses>").format(self.poses.size());
      });
}

}  // namespace

void bind_evaluation(py::module_& module) {
  bind_trajectory(module);
  py::class_<Statistics>(module, "Statistics", "Statistics of errors; 0 if there are none.")
      .def_readonly("rmse", &Statistics::rmse, "Root mean square.")
      .def_readonly("median", &Statistics::median, "Median.")
      .def_readonly("p95", &Statistics::p95, "95th percentile.")
      .def_readonly("max", &Statistics::max, "Maximum.")
      .def("__repr__", [](const Statistics& s) {
        return py::str("<penumbra.Statistics rmse {:.4g}, median {:.4g}, p95 {:.4g}, max {:.4g}>")
            .format(s.rmse, s.median, s.p95, s.max);
      });
  py::class_<Errors>(module, "Errors", "Errors of estimated poses against true ones.")
      .def_readonly("frames_with_truth", &Errors::frames_with_truth, "Number of true poses.")
      .def_readonly("frames_estimated", &Errors::frames_estimated, "Number of estimated poses.")
      .def_readonly("frames_judged", &Errors::frames_judged,
                    "Number of estimated poses that have a true pose.")
      .def_readonly("outside_truth", &Errors::outside_truth,
                    "Number not judged: before the first or after the last true pose.")
      .def_readonly("gap_too_long", &Errors::gap_too_long,
                    "Number not judged: in a gap of the truth longer than max_gap_s.")
      .def_readonly("translation_mm", &Errors::translation_mm, "Statistics [mm].")
      .def_readonly("rotation_deg", &Errors::rotation_deg, "Statistics [degrees].")
      .def_readonly("overlay_px", &Errors::overlay_px,
                    "Statistics [px]: distance between the pixels to which the two poses project "
                    "the corners of a cube of 0.2 m that stands on the table's origin.")
      .def_readonly("jitter_px", &Errors::jitter_px,
                    "RMS change of this difference from frame to frame [px]; None if no two frames "
                    "follow each other.")
      .def_readonly("warnings", &Errors::warnings,
                    "Such as a likely mistake in the convention of the truth.")
      .def("__repr__", [](const Errors& errors) {
        return py::str("<penumbra.Errors of {} frames: overlay rmse {:.4g} px>")
            .format(errors.frames_judged, errors.overlay_px.rmse);
      });
  module.def(
      "evaluate",
      [](const types::CameraModel& camera, const Trajectory& estimated, const Trajectory& truth,
         double max_gap_s, double time_offset_s) {
        const Trajectory found = estimated;  // append() may run meanwhile
        const Trajectory true_poses = truth;
        return unlocked([&] {
          return evaluation::evaluate(camera, found.poses, true_poses.poses,
                                      {max_gap_s, time_offset_s});
        });
      },
      py::arg("camera"), py::arg("estimated"), py::arg("truth"), py::kw_only(),
      py::arg("max_gap_s") = 0.1, py::arg("time_offset_s") = 0.0,
      R"(Errors of estimated camera poses against true ones, as `penumbra evaluate` computes them.

In the table frame, without alignment. estimated, truth: Trajectory.
max_gap_s: the truth is interpolated across gaps up to this [s].
time_offset_s: added to the times of the estimate [s].

Returns Errors. Raises Error if a trajectory is empty, a pose is not finite or not a unit quaternion,
times do not increase, or no pose can be compared.)");
}

}  // namespace penumbra::python
