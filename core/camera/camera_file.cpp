#include "core/camera/camera_file.hpp"

#include <algorithm>
#include <cmath>

#include "core/statistics.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

// Indexed by DistortionModel, then by CameraFileFormat. Empty: not representable.
constexpr std::array<std::array<std::string_view, 3>, kDistortionModels.size()> kModelNames = {{
    {to_string(DistortionModel::plumb_bob), "0", "radtan"},
    {to_string(DistortionModel::rational), "0", ""},
    {to_string(DistortionModel::fisheye), "1", "equidistant"},
}};
static_assert(!kModelNames.back().front().empty());

bool all_finite(const std::vector<double>& values) {
  return std::ranges::all_of(values, [](double x) { return std::isfinite(x); });
}

// Omits unknown values, because other programs can't read .nan. `given_overlay_px`: if the record
// does not have it.
std::string record_text(const CalibrationRecord& record, std::optional<double> given_overlay_px) {
  std::string text;
  if (!record.calibrated_on.empty())
    text += fmt::format("calibrated_on: {}\n", in_quotes(record.calibrated_on));
  if (record.focus_position && std::isfinite(*record.focus_position))
    text += fmt::format("focus_position: {}\n", *record.focus_position);
  text +=
      "# one sigma; standard deviations in the order fx fy cx cy k1 ...\n"
      "uncertainty:\n";
  if (!record.target.empty()) text += fmt::format("  target: {}\n", in_quotes(record.target));
  text += fmt::format("  views: {}\n", record.views);
  const auto add = [&text](const char* key, std::optional<double> value) {
    if (value && std::isfinite(*value)) text += fmt::format("  {}: {:.4f}\n", key, *value);
  };
  add("rms_px", record.rms_px);
  add("held_out_px", record.held_out_px);
  add("tone_curve", record.tone_curve_sigma);
  add("projection_mean_px", record.projection_mean_px);
  add("projection_largest_px", record.projection_largest_px);
  if (record.row_time_sigma_s && std::isfinite(*record.row_time_sigma_s))
    text += fmt::format("  rolling_shutter_row_s: {:.3g}\n", *record.row_time_sigma_s);
  if (!record.standard_deviations.empty() && all_finite(record.standard_deviations)) {
    text +=
        fmt::format("  standard_deviations: [{}]\n", joined(record.standard_deviations, "{:.6g}"));
  }
  if (!record.table_tracked_px.empty() && all_finite(record.table_tracked_px) &&
      all_finite(record.table_known_pose_px)) {
    add("overlay_px", root_mean_square(record.table_tracked_px));
    text += fmt::format(
        "  # corners of a 0.2 m cube on the table: pose found with this lens, and pose known\n"
        "  table_volume:\n    distance_m: {:.3f}\n    tracked_px: [{}]\n    known_pose_px: [{}]\n",
        record.table_distance_m, joined(record.table_tracked_px, "{:.4f}"),
        joined(record.table_known_pose_px, "{:.4f}"));
  } else {
    add("overlay_px", given_overlay_px);
  }
  return text;
}

// Writes the record as comments: Kalibr takes each key of a camchain file for a camera.
std::string as_comments(std::string_view text) {
  std::string comments;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size() - 1) + 1;
    const std::string_view line = text.substr(0, end);
    comments += line.starts_with("#") ? std::string(line) : "# " + std::string(line);
    text.remove_prefix(end);
  }
  return comments;
}

std::array<double, 9> camera_matrix(const CameraParameters& p) {
  return {p.fx, 0.0, p.cx, 0.0, p.fy, p.cy, 0.0, 0.0, 1.0};
}

std::span<const double> coefficients(const CameraParameters& p, int count) {
  return std::span(p.distortion).first(static_cast<std::size_t>(count));
}

// Returns the shortest decimal that reads back to the same double.
std::string shortest(double value) {
  return fmt::format("{}", value);
}
// Adds a decimal point if there is none, because OpenCV would read an integer. No blank may follow.
std::string with_point(double value) {
  std::string digits = shortest(value);
  if (digits.find_first_of(".e") == std::string::npos) digits += ".";
  return digits;
}
std::string with_points(std::span<const double> values) {
  std::string text = "[";
  for (const double value : values) text += (text.size() > 1 ? ", " : "") + with_point(value);
  return text + "]";
}

std::string optional_keys(const CameraParameters& p, std::string_view indent,
                          std::string (*number)(double)) {
  std::string text;
  if (p.tone_curve) text += fmt::format("tone_curve: {}\n", number(*p.tone_curve));
  if (p.rolling_shutter_row_s)
    text += fmt::format("rolling_shutter_row_s: {}\n", number(*p.rolling_shutter_row_s));
  if (p.overlay_sigma_px)
    text += fmt::format("uncertainty:\n{}overlay_px: {}\n", indent, number(*p.overlay_sigma_px));
  return text;
}

std::string ros_text(const CameraParameters& p) {
  const int count = coefficient_count(p.model);
  return fmt::format(
      "# ROS camera_info; pixel (0, 0) is the centre of the top-left pixel\n"
      "image_width: {}\nimage_height: {}\ncamera_name: {}\n"
      "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{}]\n"
      "distortion_model: {}\n"
      "distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: [{}]\n"
      "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
      "projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{}, 0, {}, 0, 0, {}, {}, 0, 0, 0, 1, 0]\n"
      "{}",
      p.width, p.height, in_quotes(p.name.empty() ? "camera" : p.name), joined(camera_matrix(p)),
      to_string(p.model), count, joined(coefficients(p, count)), p.fx, p.cx, p.fy, p.cy,
      optional_keys(p, "  ", shortest));
}

std::string opencv_text(const CameraParameters& p) {
  const int count = coefficient_count(p.model);
  return fmt::format(
      "%YAML:1.0\n---\n"
      "image_width: {}\nimage_height: {}\n"
      "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {}\n"
      "distortion_coefficients: !!opencv-matrix\n   rows: {}\n   cols: 1\n   dt: d\n   data: {}\n"
      "fisheye_model: {}\n"
      "{}",
      p.width, p.height, with_points(camera_matrix(p)), count, with_points(coefficients(p, count)),
      model_name(p.model, CameraFileFormat::opencv).value(), optional_keys(p, "   ", with_point));
}

std::string kalibr_text(const CameraParameters& p) {
  return fmt::format(
      "cam0:\n  camera_model: pinhole\n  intrinsics: [{}, {}, {}, {}]\n  distortion_model: {}\n"
      "  distortion_coeffs: [{}]\n  resolution: [{}, {}]\n  rostopic: /camera/image_raw\n",
      p.fx, p.fy, p.cx, p.cy, model_name(p.model, CameraFileFormat::kalibr).value(),
      joined(coefficients(p, 4)), p.width, p.height);
}

}  // namespace

std::string_view to_string(CameraFileFormat format) {
  constexpr std::array<std::string_view, 3> kNames = {"ROS", "OpenCV", "Kalibr"};
  return kNames[static_cast<std::size_t>(format)];
}

std::optional<std::string_view> model_name(DistortionModel model, CameraFileFormat format) {
  const std::string_view name =
      kModelNames[static_cast<std::size_t>(model)][static_cast<std::size_t>(format)];
  return name.empty() ? std::nullopt : std::optional(name);
}

bool can_hold(CameraFileFormat format, const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const bool has_k3 = p.model == DistortionModel::plumb_bob && p.distortion[4] != 0.0;
  return model_name(p.model, format) && !(format == CameraFileFormat::kalibr && has_k3);
}

Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera,
                         CameraFileFormat format, const CalibrationRecord* record) {
  CameraParameters p = camera.parameters();
  const std::optional<double> given_overlay_px = p.overlay_sigma_px;
  if (record != nullptr) p.overlay_sigma_px.reset();  // record_text() writes it
  if (!model_name(p.model, format)) {
    return fail(
        "{}: {}'s files have no {} lens; write another format or calibrate with --model plumb_bob",
        file.string(), to_string(format), short_name(p.model));
  }
  if (!can_hold(format, camera)) {
    return fail(
        "{}: Kalibr's radtan lens has no k3, and this one has {}; without it the lens differs: "
        "write another format, or calibrate with --format kalibr, which solves for a "
        "lens without k3",
        file.string(), p.distortion[4]);
  }
  std::string text = format == CameraFileFormat::ros      ? ros_text(p)
                     : format == CameraFileFormat::opencv ? opencv_text(p)
                                                          : kalibr_text(p);
  if (record != nullptr) {
    const std::string keys = record_text(*record, given_overlay_px);
    text += format == CameraFileFormat::kalibr ? as_comments(keys) : keys;
  }
  return write_text_file(file, text);
}

std::string ros_camera_text(const CameraModel& camera) {
  return ros_text(camera.parameters());
}

Result<CameraModel> scaled_to(const CameraModel& camera, int width, int height) {
  const auto integer_ratio = [](int larger, int smaller) {
    return smaller > 0 && larger % smaller == 0 ? larger / smaller : 0;
  };
  CameraParameters p = camera.parameters();
  const int down = integer_ratio(p.width, width);
  const int up = integer_ratio(width, p.width);
  double scale = 0.0;
  if (down > 0 && down == integer_ratio(p.height, height)) {
    scale = 1.0 / down;
  } else if (up > 0 && up == integer_ratio(height, p.height)) {
    scale = up;
  } else {
    return fail(
        "is a calibration of {}x{} px and can't be scaled to {}x{} px, for no whole number of "
        "pixels becomes one; calibrate at this size (penumbra calibrate)",
        p.width, p.height, width, height);
  }
  p.width = width;
  p.height = height;
  p.fx *= scale;
  p.fy *= scale;
  p.cx = (p.cx + 0.5) * scale - 0.5;
  p.cy = (p.cy + 0.5) * scale - 0.5;
  if (scale != 1.0) p.rolling_shutter_row_s.reset();
  if (p.overlay_sigma_px) *p.overlay_sigma_px *= scale;
  return CameraModel::make(p);
}

}  // namespace penumbra
