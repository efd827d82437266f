// Target, Calibrator, Calibration and calibrate_corners().
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <cmath>
#include <memory>
#include <penumbra/calibration.hpp>

#include "bindings.hpp"
#include "names.hpp"

namespace penumbra::python {
namespace {

using calibration::Calibration;
using calibration::CornerView;
using calibration::Target;
using calibration::ViewResult;

constexpr Names<calibration::Grade, 3> kGrades = {{
    {"good", calibration::Grade::good},
    {"usable", calibration::Grade::usable},
    {"poor", calibration::Grade::poor},
}};

// A calibrator and whether a call uses it.
struct Calibrator {
  calibration::Calibrator calibrator;
  std::atomic<bool> busy = false;
};

calibration::Options options_of(const std::optional<std::string>& model, int max_views) {
  calibration::Options options;
  if (model) options.model = value_of(kDistortionModels, "model", *model);
  options.max_views = max_views;
  return options;
}

// Returns the corners of a view: a row for each point of the board, NaN if it is not seen.
CornerView view_of(const py::object& pixels, std::size_t index, std::size_t points) {
  CornerView view;
  view.name = "views[" + std::to_string(index) + "]";
  const std::vector<types::Vector2> given = rows<2>(pixels, view.name);
  if (given.size() != points) {
    throw ArgumentError(view.name + ": has " + std::to_string(given.size()) +
                        " rows; give one for each of the " + std::to_string(points) +
                        " points, NaN if it is not seen");
  }
  for (std::size_t i = 0; i < given.size(); ++i) {
    if (std::isnan(given[i][0]) && std::isnan(given[i][1])) continue;
    view.corners.push_back({static_cast<int>(i), given[i]});
  }
  return view;
}

Calibration calibrate_corners(int width, int height, const py::object& points,
                              const py::object& views, const std::optional<std::string>& model) {
  const std::vector<types::Vector3> board = rows<3>(points, "points");
  if (!py::isinstance<py::iterable>(views)) {
    throw py::type_error("views: is a " + describe(views) + "; give an array for each view");
  }
  std::vector<CornerView> given;
  for (const py::handle view : views) {
    given.push_back(view_of(py::reinterpret_borrow<py::object>(view), given.size(), board.size()));
  }
  calibration::Options options;
  if (model) options.model = value_of(kDistortionModels, "model", *model);
  return unlocked([&] { return calibration::calibrate(width, height, board, given, options); });
}

py::array_t<double> covariance_of(const Calibration& calibration) {
  const std::vector<double> values = calibration.covariance();
  const std::size_t count = calibration.parameter_names().size();
  return matrix_of(values.data(), count, count);
}

void bind_results(py::module_& module) {
  py::class_<ViewResult>(module, "ViewResult", "What became of an image of a calibration.")
      .def_readonly("name", &ViewResult::name, "Name of the image.")
      .def_readonly("used", &ViewResult::used, "True if the image was used.")
      .def_readonly("reason", &ViewResult::reason, "Why it is not used; '' if it is.")
      .def_readonly("rms_px", &ViewResult::rms_px,
                    "Reprojection error, 2-D, without outliers [px].")
      .def("__repr__", [](const ViewResult& view) {
        return py::str("<penumbra.ViewResult '{}': {}>")
            .format(view.name, view.used ? "used" : view.reason.c_str());
      });

  py::class_<Calibration>(module, "Calibration", "A solved camera. Immutable.")
      .def_property_readonly("camera", &Calibration::camera, "The CameraModel.")
      .def(
          "save",
          [](const Calibration& self, const std::filesystem::path& file, const std::string& date,
             const std::string& format) {
            const auto chosen = value_of(kCameraFormats, "format", format);
            unlocked([&] { self.save(file, date, chosen); });
          },
          py::arg("file"), py::arg("date") = "", py::arg("format") = "ros",
          R"(Writes the camera with its uncertainty, as `penumbra calibrate` does.

date: '2026-03-01', or ''. format: 'ros', 'opencv' or 'kalibr'. Raises Error.)")
      .def_property_readonly("parameter_names", &Calibration::parameter_names,
                             "Names of the lens parameters: fx fy cx cy k1 ...")
      .def_property_readonly(
          "covariance", &covariance_of,
          "Covariance of these parameters, shape (N, N). Includes the correlation of a view's "
          "residuals.")
      .def_property_readonly("rms_px", &Calibration::rms_px,
                             "Reprojection error, 2-D, without outliers [px].")
      .def_property_readonly("held_out_px", &Calibration::held_out_px,
                             "rms_px of cross-validation, or None.")
      .def_property_readonly("projection_mean_px", &Calibration::projection_mean_px,
                             "Standard deviation of the projection along its worst direction: mean "
                             "over the image [px].")
      .def_property_readonly("projection_largest_px", &Calibration::projection_largest_px,
                             "The same, maximum over the image [px].")
      .def_property_readonly(
          "grade", [](const Calibration& self) { return name_of(kGrades, self.grade()); },
          "'good', 'usable' or 'poor'.")
      .def_property_readonly("verdict", &Calibration::verdict,
                             "One line: grade, why, and what to do.")
      .def_property_readonly("advice", &Calibration::advice, "What more images should show.")
      .def_property_readonly("views", &Calibration::views, "A ViewResult for each image.")
      .def("__repr__", [](const Calibration& self) {
        return "<penumbra.Calibration: " + self.verdict() + ">";
      });
}

}  // namespace

void bind_calibration(py::module_& module) {
  py::class_<Target>(module, "Target", "A calibration target. Immutable; threads may share it.")
      .def_static("load", &Target::load, py::arg("file"), py::call_guard<Unlocked>(),
                  R"(Reads what `penumbra target` writes.

A tags.yaml, or a target.yaml of a chessboard, a ChArUco board or an AprilGrid (Kalibr's format).
Raises Error.)")
      .def_static("chessboard", &Target::chessboard, py::arg("columns"), py::arg("rows"),
                  py::arg("square_m"),
                  "A chessboard. columns, rows: inner corners. square_m: edge of a square [m]. "
                  "Raises Error.")
      .def_property_readonly("description", &Target::description, "'6 x 6 tags of 30 mm'.")
      .def_property_readonly(
          "points", [](const Target& target) { return array_of(target.points()); },
          "Corners in the board frame [m], shape (N, 3): x right, y up on the sheet, z out of it.")
      .def("__repr__",
           [](const Target& target) { return "<penumbra.Target: " + target.description() + ">"; });
  bind_results(module);

  py::class_<Calibrator>(module, "Calibrator", R"(Calibrates a camera from images, one by one.

calibrate() does this with a list of images. Other Python threads run while it computes. One thread
at a time may use an object; a second one gets an Error.)")
      .def(py::init(
               [](const Target& target, const std::optional<std::string>& model, int max_views) {
                 const calibration::Options options = options_of(model, max_views);
                 return std::unique_ptr<Calibrator>(
                     new Calibrator{calibration::Calibrator(target, options)});
               }),
           py::arg("target"), py::kw_only(), py::arg("model") = py::none(),
           py::arg("max_views") = 60,
           R"(model: 'plumb_bob', 'rational' or 'fisheye'; None: chosen by cross-validation.
max_views: solves this number of the most different views; memory holds twice as many images.)")
      .def(
          "add",
          [](Calibrator& self, const std::string& name, const py::object& image,
             const std::optional<std::string>& format) {
            const types::ImageView view = image_view(image, format.value_or(""));
            const Busy busy(self.busy, "calibrator");
            unlocked([&] { self.calibrator.add(name, view); });
          },
          py::arg("name"), py::arg("image"), py::kw_only(), py::arg("format") = py::none(),
          R"(Searches an image for the target.

name: in messages. image, format: as for Tracker.track(). An image that cannot be used is listed in
Calibration.views. Raises Error if its size is not that of the first image.)")
      .def(
          "solve",
          [](Calibrator& self) {
            const Busy busy(self.busy, "calibrator");
            return unlocked([&] { return self.calibrator.solve(); });
          },
          R"(Solves and returns a Calibration. Takes seconds to minutes.

Raises Error with what the images lack. The object is empty afterwards, also then.)");

  module.def("calibrate_corners", &calibrate_corners, py::arg("width"), py::arg("height"),
             py::arg("points"), py::arg("views"), py::kw_only(), py::arg("model") = py::none(),
             R"(Calibrates a camera from corners that another program detected.

width, height: size of the images [px].
points: of the target, in the board frame [m], shape (N, 3); at least four, in a plane or not.
views: for each image the pixels of these points, shape (N, 2), NaN where a point is not seen.
model: 'plumb_bob', 'rational' or 'fisheye'; None: chosen by cross-validation.

Returns a Calibration. Raises Error for fewer than 3 views, a corner outside the image, and views
that determine no camera. Other Python threads run meanwhile.)");
}

}  // namespace penumbra::python
