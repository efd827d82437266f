#include "core/camera_file.hpp"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <optional>

#include "core/text.hpp"
#include "core/yaml_fields.hpp"

namespace penumbra {
namespace {

// The first of `keys` that is there; the first of all where none is.
const char* present(const YamlFields& fields, std::initializer_list<const char*> keys) {
  for (const char* key : keys) {
    if (fields.has(key)) return key;
  }
  return *keys.begin();
}

// Coefficients as OpenCV counts them: 4 or 5 of plumb_bob, 8 of rational, more only where they are
// 0.
Result<void> take_opencv_coefficients(const std::vector<double>& d, const std::string& place,
                                      CameraParameters& p) {
  if (d.size() != 4 && d.size() != 5 && d.size() != 8 && d.size() != 12 && d.size() != 14)
    return fail("{}: has {} numbers; give 4, 5 or 8", place, d.size());
  for (std::size_t i = 8; i < d.size(); ++i) {
    if (d[i] != 0.0)
      return fail(
          "{}: holds thin-prism or tilt coefficients, which are not supported; calibrate "
          "with 8 or fewer",
          place);
  }
  bool rational = false;
  for (std::size_t i = 5; i < std::min<std::size_t>(d.size(), 8); ++i)
    rational = rational || d[i] != 0.0;
  p.model = d.size() >= 8 && rational ? DistortionModel::rational : DistortionModel::plumb_bob;
  std::copy(d.begin(), d.begin() + static_cast<std::ptrdiff_t>(std::min<std::size_t>(d.size(), 8)),
            p.distortion.begin());
  return {};
}

double rms(const std::vector<double>& values) {
  double squares = 0.0;
  for (const double value : values) squares += value * value;
  return std::sqrt(squares / static_cast<double>(values.size()));
}

// What the calibration says of itself, as far as it concerns what is drawn. Files without
// overlay_px have the corners it is made of.
Result<void> take_uncertainty(const YamlFields& fields, CameraParameters& p) {
  constexpr const char* kRemedy = "leave out `uncertainty`, or calibrate again";
  const Result<bool> told = fields.has_optional("uncertainty");
  if (!told) return tl::unexpected(told.error());
  if (!*told) return {};
  const Result<YamlFields> uncertainty = fields.fields("uncertainty", kRemedy);
  if (!uncertainty) return tl::unexpected(uncertainty.error());
  const Result<bool> of_overlay = uncertainty->has_optional("overlay_px");
  if (!of_overlay) return tl::unexpected(of_overlay.error());
  if (*of_overlay) {
    const Result<double> overlay = uncertainty->number("overlay_px", kRemedy);
    if (!overlay) return tl::unexpected(overlay.error());
    p.overlay_sigma_px = *overlay;
  } else if (uncertainty->has("table_volume")) {
    const Result<YamlFields> table = uncertainty->fields("table_volume", kRemedy);
    if (!table) return tl::unexpected(table.error());
    const Result<std::vector<double>> corners = table->numbers("tracked_px", kRemedy);
    if (!corners) return tl::unexpected(corners.error());
    if (!corners->empty()) p.overlay_sigma_px = rms(*corners);
  }
  return {};
}

// What readers of other tools ignore.
Result<void> take_optional(const YamlFields& fields, CameraParameters& p) {
  const Result<bool> toned = fields.has_optional("tone_curve");
  if (!toned) return tl::unexpected(toned.error());
  if (*toned) {
    const Result<double> tone =
        fields.number("tone_curve", "give the exponent of the tone curve, or leave it out");
    if (!tone) return tl::unexpected(tone.error());
    p.tone_curve = *tone;
  }
  const Result<bool> rolls = fields.has_optional("rolling_shutter_row_s");
  if (!rolls) return tl::unexpected(rolls.error());
  if (*rolls) {
    const Result<double> row = fields.number(
        "rolling_shutter_row_s", "give the seconds from one row to the next, or leave it out");
    if (!row) return tl::unexpected(row.error());
    p.rolling_shutter_row_s = *row;
  }
  return take_uncertainty(fields, p);
}

Result<CameraParameters> read_opencv(const YamlFields& fields) {
  CameraParameters p;
  if (auto ok = take_optional(fields, p); !ok) return tl::unexpected(ok.error());
  const char* width_key = present(fields, {"image_width", "image_Width", "Image_Width", "width"});
  const Result<int> width = fields.integer(width_key, "give the image's width in pixels");
  if (!width) return tl::unexpected(width.error());
  const char* height_key =
      present(fields, {"image_height", "image_Height", "Image_Height", "height"});
  const Result<int> height = fields.integer(height_key, "give the image's height in pixels");
  if (!height) return tl::unexpected(height.error());
  p.width = *width;
  p.height = *height;
  constexpr const char* kMatrix = "give a 3x3 !!opencv-matrix";
  const char* matrix_key =
      present(fields, {"camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M1"});
  const Result<YamlFields> matrix = fields.fields(matrix_key, kMatrix);
  if (!matrix) return tl::unexpected(matrix.error());
  const Result<std::vector<double>> k = matrix->numbers("data", kMatrix);
  if (!k) return tl::unexpected(k.error());
  if (k->size() != 9)
    return fail("{}: has {} numbers; {}", matrix->place_of("data"), k->size(), kMatrix);
  if ((*k)[1] != 0.0 || (*k)[3] != 0.0 || (*k)[6] != 0.0 || (*k)[7] != 0.0 || (*k)[8] != 1.0)
    return fail("{}: is no camera matrix without skew; {}", matrix->place_of("data"), kMatrix);
  p.fx = (*k)[0];
  p.cx = (*k)[2];
  p.fy = (*k)[4];
  p.cy = (*k)[5];
  constexpr const char* kDistortion = "give an !!opencv-matrix of 4, 5 or 8 coefficients";
  const char* distortion_key =
      present(fields, {"distortion_coefficients", "Distortion_Coefficients", "distCoeffs",
                       "distortionCoefficients", "D", "D1"});
  const Result<YamlFields> distortion = fields.fields(distortion_key, kDistortion);
  if (!distortion) return tl::unexpected(distortion.error());
  const Result<std::vector<double>> d = distortion->numbers("data", kDistortion);
  if (!d) return tl::unexpected(d.error());
  if (fields.has("fisheye_model")) {
    const Result<int> fisheye = fields.integer("fisheye_model", "give 0 or 1");
    if (!fisheye) return tl::unexpected(fisheye.error());
    if (*fisheye != 0) {
      if (d->size() != 4)
        return fail("{}: has {} numbers, but a fisheye lens has 4", distortion->place_of("data"),
                    d->size());
      p.model = DistortionModel::fisheye;
      std::copy(d->begin(), d->end(), p.distortion.begin());
      return p;
    }
  }
  if (auto ok = take_opencv_coefficients(*d, distortion->place_of("data"), p); !ok)
    return tl::unexpected(ok.error());
  return p;
}

Result<CameraParameters> read_kalibr(const YamlFields& chain) {
  CameraParameters p;
  const Result<YamlFields> camera = chain.fields("cam0", "give the camera's map");
  if (!camera) return tl::unexpected(camera.error());
  const Result<std::string> kind = camera->text("camera_model", "name pinhole");
  if (!kind) return tl::unexpected(kind.error());
  if (*kind != "pinhole")
    return fail("{}: '{}' is not supported; calibrate as pinhole-radtan or pinhole-equi",
                camera->place_of("camera_model"), *kind);
  const Result<std::vector<double>> k = camera->numbers("intrinsics", "give [fx, fy, cx, cy]");
  if (!k) return tl::unexpected(k.error());
  if (k->size() != 4)
    return fail("{}: has {} numbers; give [fx, fy, cx, cy]", camera->place_of("intrinsics"),
                k->size());
  const Result<std::vector<double>> size = camera->numbers("resolution", "give [width, height]");
  if (!size) return tl::unexpected(size.error());
  if (size->size() != 2 || !((*size)[0] >= 1.0 && (*size)[0] <= 1e6) ||
      !((*size)[1] >= 1.0 && (*size)[1] <= 1e6))
    return fail("{}: is no size; give [width, height]", camera->place_of("resolution"));
  p.width = static_cast<int>((*size)[0]);
  p.height = static_cast<int>((*size)[1]);
  p.fx = (*k)[0];
  p.fy = (*k)[1];
  p.cx = (*k)[2];
  p.cy = (*k)[3];
  const Result<std::string> model =
      camera->text("distortion_model", "name radtan, equidistant or none");
  if (!model) return tl::unexpected(model.error());
  if (*model == "none") return p;
  const Result<std::vector<double>> d =
      camera->numbers("distortion_coeffs", "give the model's 4 coefficients");
  if (!d) return tl::unexpected(d.error());
  if (*model != "radtan" && *model != "equidistant")
    return fail("{}: the lens model '{}' is not supported; use radtan or equidistant",
                camera->place_of("distortion_model"), *model);
  if (d->size() != 4 && !(*model == "radtan" && d->size() == 5))
    return fail("{}: has {} numbers, but {} has 4", camera->place_of("distortion_coeffs"),
                d->size(), *model);
  p.model = *model == "radtan" ? DistortionModel::plumb_bob : DistortionModel::fisheye;
  std::copy(d->begin(), d->end(), p.distortion.begin());
  return p;
}

Result<CameraParameters> read_mrcal(const YamlFields& fields) {
  CameraParameters p;
  const Result<std::string> model = fields.text("lensmodel", "name LENSMODEL_OPENCV5");
  if (!model) return tl::unexpected(model.error());
  std::size_t count = 0;
  if (*model == "LENSMODEL_OPENCV4") {
    count = 4;
  } else if (*model == "LENSMODEL_OPENCV5") {
    count = 5;
  } else if (*model == "LENSMODEL_OPENCV8") {
    count = 8;
  } else if (*model != "LENSMODEL_PINHOLE") {
    return fail("{}: '{}' is not supported; fit LENSMODEL_OPENCV8 with mrcal-convert-lensmodel",
                fields.place_of("lensmodel"), *model);
  }
  const Result<std::vector<double>> k =
      fields.numbers("intrinsics", "give fx, fy, cx, cy and the model's coefficients");
  if (!k) return tl::unexpected(k.error());
  if (k->size() != 4 + count)
    return fail("{}: has {} numbers, but {} has {}", fields.place_of("intrinsics"), k->size(),
                *model, 4 + count);
  const Result<std::vector<double>> size = fields.numbers("imagersize", "give [width, height]");
  if (!size) return tl::unexpected(size.error());
  if (size->size() != 2 || !((*size)[0] >= 1.0 && (*size)[0] <= 1e6) ||
      !((*size)[1] >= 1.0 && (*size)[1] <= 1e6))
    return fail("{}: is no size; give [width, height]", fields.place_of("imagersize"));
  p.width = static_cast<int>((*size)[0]);
  p.height = static_cast<int>((*size)[1]);
  p.fx = (*k)[0];
  p.fy = (*k)[1];
  p.cx = (*k)[2];
  p.cy = (*k)[3];
  p.model = count == 8 ? DistortionModel::rational : DistortionModel::plumb_bob;
  std::copy(k->begin() + 4, k->end(), p.distortion.begin());
  return p;
}

// What other tools write that is not quite YAML: OpenCV's first line, Python's bytes in mrcal's.
std::string as_yaml(std::string text) {
  if (text.starts_with("%YAML:")) text.erase(0, std::min(text.find('\n'), text.size()));
  if (text.find("lensmodel") != std::string::npos) {
    for (std::size_t at = text.find(" b'"); at != std::string::npos; at = text.find(" b'", at))
      text.erase(at + 1, 1);
  }
  return text;
}

Result<CameraParameters> read_ros(const YamlFields& fields) {
  CameraParameters p;
  const Result<int> width = fields.integer("image_width", "give the image's width in pixels");
  if (!width) return tl::unexpected(width.error());
  p.width = *width;
  const Result<int> height = fields.integer("image_height", "give the image's height in pixels");
  if (!height) return tl::unexpected(height.error());
  p.height = *height;

  constexpr const char* kMatrix = "give data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]";
  const Result<YamlFields> matrix = fields.fields("camera_matrix", kMatrix);
  if (!matrix) return tl::unexpected(matrix.error());
  const Result<std::vector<double>> k = matrix->numbers("data", kMatrix);
  if (!k) return tl::unexpected(k.error());
  if (k->size() != 9)
    return fail("{}: has {} numbers; {}", matrix->place_of("data"), k->size(), kMatrix);
  if ((*k)[1] != 0.0 || (*k)[3] != 0.0 || (*k)[6] != 0.0 || (*k)[7] != 0.0 || (*k)[8] != 1.0) {
    return fail("{}: is no camera matrix without skew; {}", matrix->place_of("data"), kMatrix);
  }
  p.fx = (*k)[0];
  p.cx = (*k)[2];
  p.fy = (*k)[4];
  p.cy = (*k)[5];

  constexpr const char* kModel =
      "name plumb_bob, rational_polynomial or equidistant (also: fisheye)";
  const char* model_key = fields.has("distortion_model") || !fields.has("camera_model")
                              ? "distortion_model"
                              : "camera_model";
  const Result<std::string> model = fields.text(model_key, kModel);
  if (!model) return tl::unexpected(model.error());
  if (*model == "plumb_bob") {
    p.model = DistortionModel::plumb_bob;
  } else if (*model == "rational_polynomial") {
    p.model = DistortionModel::rational;
  } else if (*model == "equidistant" || *model == "fisheye") {
    p.model = DistortionModel::fisheye;
  } else {
    return fail("{}: the lens model '{}' is not supported; {}", fields.place_of(model_key), *model,
                kModel);
  }

  constexpr const char* kDistortion = "give data: [k1, k2, ...]";
  const Result<YamlFields> distortion = fields.fields("distortion_coefficients", kDistortion);
  if (!distortion) return tl::unexpected(distortion.error());
  const Result<std::vector<double>> d = distortion->numbers("data", kDistortion);
  if (!d) return tl::unexpected(d.error());
  const auto expected = static_cast<std::size_t>(coefficient_count(p.model));
  const bool without_k3 = p.model == DistortionModel::plumb_bob && d->size() == 4;
  if (d->size() != expected && !without_k3) {
    return fail("{}: has {} numbers, but {} has {}{}", distortion->place_of("data"), d->size(),
                *model, p.model == DistortionModel::plumb_bob ? "4 or 5" : std::to_string(expected),
                "; give as many as the model has");
  }
  std::copy(d->begin(), d->end(), p.distortion.begin());

  if (fields.has("camera_name")) {
    const Result<std::string> name = fields.text("camera_name", "give a name or leave it out");
    if (!name) return tl::unexpected(name.error());
    p.name = *name;
  }
  if (auto ok = take_optional(fields, p); !ok) return tl::unexpected(ok.error());
  return p;
}

}  // namespace

namespace {

// A lens whose picture folds back onto itself so near its middle, or lies elsewhere, was never
// measured: a sign or a power of ten is wrong, or the coefficients are another model's.
Result<void> check_lens(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const Eigen::Vector2d centre(p.cx, p.cy);
  const double larger = std::max(camera.width(), camera.height());
  if (!((centre - 0.5 * Eigen::Vector2d(p.width, p.height)).norm() < 10.0 * larger)) {
    return fail(
        "camera_matrix: the principal point ({:g}, {:g}) lies far outside {} x {}; correct "
        "it, or image_width and image_height",
        p.cx, p.cy, p.width, p.height);
  }
  // Nor does a lens spread a small part of what a straight one sees over the whole picture.
  const std::optional<Eigen::Vector3d> edge = camera.unproject({p.cx + 0.5 * larger, p.cy});
  const double straight = 0.5 * larger / p.fx;
  if (edge && edge->head<2>().norm() < 0.05 * straight * edge->z()) {
    return fail(
        "distortion: this lens moves the picture's edge {:.0f} times as far out as a straight one; "
        "correct the coefficients or the distortion_model",
        straight * edge->z() / edge->head<2>().norm());
  }
  if (!std::isfinite(camera.max_radius())) return {};
  const double shorter = std::min(camera.width(), camera.height());
  // Just inside, so that rounding does not decide.
  const std::optional<Eigen::Vector2d> fold =
      camera.project({camera.max_radius() * (1.0 - 1e-9), 0.0, 1.0});
  if (fold && (*fold - centre).norm() >= 0.25 * shorter) return {};
  return fail(
      "distortion: this lens folds its picture {:.0f} px from the middle of {} x {}; correct the "
      "coefficients or the distortion_model",
      fold ? (*fold - centre).norm() : 0.0, camera.width(), camera.height());
}

}  // namespace

Result<CameraModel> load_camera(const std::filesystem::path& file) {
  const Result<std::string> text = read_text_file(file, kMaxYamlBytes);
  if (!text) return tl::unexpected(text.error());
  const Result<YAML::Node> root = parse_yaml_map(as_yaml(*text), file.string());
  if (!root) return tl::unexpected(root.error());
  try {
    const YamlFields fields(*root, file.string());
    const bool opencv =
        text->starts_with("%YAML:") || fields.has("Camera_Matrix") || fields.has("cameraMatrix");
    const Result<CameraParameters> parameters = fields.has("lensmodel") ? read_mrcal(fields)
                                                : fields.has("cam0")    ? read_kalibr(fields)
                                                : opencv                ? read_opencv(fields)
                                                                        : read_ros(fields);
    if (!parameters) return tl::unexpected(parameters.error());
    Result<CameraModel> camera = CameraModel::make(*parameters);
    if (!camera) return fail_in(file.string(), camera.error());
    if (auto ok = check_lens(*camera); !ok) return fail_in(file.string(), ok.error());
    return camera;
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as a camera file ({}); correct the file", file.string(),
                error.what());
  }
}

namespace {

bool all_finite(const std::vector<double>& values) {
  return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); });
}

// What is not known is left out: readers of numbers have no use for .nan.
std::string record_text(const CalibrationRecord& record) {
  std::string text = fmt::format("calibrated_on: {}\n", in_quotes(record.calibrated_on));
  if (record.focus_position && std::isfinite(*record.focus_position))
    text += fmt::format("focus_position: {}\n", *record.focus_position);
  text += fmt::format(
      "# one sigma; standard deviations in the order fx fy cx cy k1 ...\n"
      "uncertainty:\n  target: {}\n  views: {}\n",
      in_quotes(record.target), record.views);
  const auto add = [&text](const char* key, double value) {
    if (std::isfinite(value)) text += fmt::format("  {}: {:.4f}\n", key, value);
  };
  add("rms_px", record.rms_px);
  if (record.held_out_px) add("held_out_px", *record.held_out_px);
  if (record.tone_curve_sigma) add("tone_curve", *record.tone_curve_sigma);
  add("projection_mean_px", record.projection_mean_px);
  add("projection_largest_px", record.projection_largest_px);
  if (all_finite(record.standard_deviations)) {
    text +=
        fmt::format("  standard_deviations: [{}]\n", joined(record.standard_deviations, "{:.6g}"));
  }
  if (!record.table_tracked_px.empty() && all_finite(record.table_tracked_px) &&
      all_finite(record.table_known_pose_px)) {
    add("overlay_px", rms(record.table_tracked_px));
    text += fmt::format(
        "  # corners of a 0.2 m cube on the table: pose found with this lens, and pose known\n"
        "  table_volume:\n    distance_m: {:.3f}\n    tracked_px: [{}]\n    known_pose_px: [{}]\n",
        record.table_distance_m, joined(record.table_tracked_px, "{:.4f}"),
        joined(record.table_known_pose_px, "{:.4f}"));
  }
  return text;
}

// Kalibr counts every key of a chain's file as a camera.
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

std::string ros_text(const CameraParameters& p) {
  const int count = coefficient_count(p.model);
  const std::array<double, 9> k = {p.fx, 0.0, p.cx, 0.0, p.fy, p.cy, 0.0, 0.0, 1.0};
  const std::array<double, 9> r = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  const std::array<double, 12> projection = {p.fx, 0.0, p.cx, 0.0, 0.0, p.fy,
                                             p.cy, 0.0, 0.0,  0.0, 1.0, 0.0};
  const std::vector<double> distortion(p.distortion.begin(), p.distortion.begin() + count);
  // {} writes the shortest digits that read back to the same double.
  std::string text = "# ROS camera_info; pixel (0, 0) is the centre of the top-left pixel\n";
  text += fmt::format("image_width: {}\nimage_height: {}\ncamera_name: {}\n", p.width, p.height,
                      in_quotes(p.name.empty() ? "camera" : p.name));
  text += fmt::format("camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{}]\n", joined(k));
  text += fmt::format("distortion_model: {}\n", to_string(p.model));
  text += fmt::format("distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: [{}]\n", count,
                      joined(distortion));
  text += fmt::format("rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [{}]\n", joined(r));
  text +=
      fmt::format("projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{}]\n", joined(projection));
  if (p.tone_curve) text += fmt::format("tone_curve: {}\n", *p.tone_curve);
  if (p.rolling_shutter_row_s)
    text += fmt::format("rolling_shutter_row_s: {}\n", *p.rolling_shutter_row_s);
  if (p.overlay_sigma_px)
    text += fmt::format("uncertainty:\n  overlay_px: {}\n", *p.overlay_sigma_px);
  return text;
}

// OpenCV reads a number without a point as an integer, and `.` as part of one: always with one.
std::string with_point(double value) {
  std::string digits = fmt::format("{}", value);
  if (digits.find_first_of(".e") == std::string::npos) digits += ".";
  return digits;
}
template <class Range>
std::string with_points(const Range& values) {
  std::string text = "[";
  for (const double value : values) text += (text.size() > 1 ? ", " : "") + with_point(value);
  return text + "]";
}

std::string opencv_text(const CameraParameters& p) {
  const int count = coefficient_count(p.model);
  const std::array<double, 9> k = {p.fx, 0.0, p.cx, 0.0, p.fy, p.cy, 0.0, 0.0, 1.0};
  const std::vector<double> distortion(p.distortion.begin(), p.distortion.begin() + count);
  std::string text = "%YAML:1.0\n---\n";
  text += fmt::format("image_width: {}\nimage_height: {}\n", p.width, p.height);
  text +=
      fmt::format("camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: {}\n",
                  with_points(k));
  text += fmt::format(
      "distortion_coefficients: !!opencv-matrix\n   rows: {}\n   cols: 1\n   dt: d\n   data: {}\n",
      count, with_points(distortion));
  text += fmt::format("fisheye_model: {}\n", p.model == DistortionModel::fisheye ? 1 : 0);
  if (p.tone_curve) text += fmt::format("tone_curve: {}\n", with_point(*p.tone_curve));
  if (p.rolling_shutter_row_s)
    text += fmt::format("rolling_shutter_row_s: {}\n", with_point(*p.rolling_shutter_row_s));
  if (p.overlay_sigma_px)
    text += fmt::format("uncertainty:\n   overlay_px: {}\n", with_point(*p.overlay_sigma_px));
  return text;
}

std::string kalibr_text(const CameraParameters& p) {
  const std::vector<double> k = {p.fx, p.fy, p.cx, p.cy};
  const std::vector<double> distortion(p.distortion.begin(), p.distortion.begin() + 4);
  return fmt::format(
      "cam0:\n  camera_model: pinhole\n  intrinsics: [{}]\n  distortion_model: {}\n"
      "  distortion_coeffs: [{}]\n  resolution: [{}, {}]\n  rostopic: /camera/image_raw\n",
      joined(k), p.model == DistortionModel::fisheye ? "equidistant" : "radtan", joined(distortion),
      p.width, p.height);
}

}  // namespace

Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera,
                         CameraFileFormat format, const CalibrationRecord* record) {
  CameraParameters p = camera.parameters();
  if (record != nullptr) p.overlay_sigma_px.reset();  // it has its own
  std::string text;
  switch (format) {
    case CameraFileFormat::ros:
      text = ros_text(p);
      break;
    case CameraFileFormat::opencv:
      text = opencv_text(p);
      break;
    case CameraFileFormat::kalibr:
      if (p.model == DistortionModel::rational) {
        return fail(
            "{}: Kalibr's files have no rational lens; write another format or calibrate "
            "with --model plumb_bob",
            file.string());
      }
      if (p.model == DistortionModel::plumb_bob && p.distortion[4] != 0.0) {
        return fail(
            "{}: Kalibr's radtan lens has no k3, and this one's is {}; without it the lens would "
            "be "
            "another: write another format, or calibrate with --format kalibr, which solves for a "
            "lens without k3",
            file.string(), p.distortion[4]);
      }
      text = kalibr_text(p);
      break;
  }
  if (record != nullptr) {
    const std::string told = record_text(*record);
    text += format == CameraFileFormat::kalibr ? as_comments(told) : told;
  }
  return write_text_file(file, text);
}

std::string ros_camera_text(const CameraModel& camera) {
  return ros_text(camera.parameters());
}

Result<CameraModel> scaled_to(const CameraModel& camera, int width, int height) {
  const auto times = [](int larger, int smaller) {
    return smaller > 0 && larger % smaller == 0 ? larger / smaller : 0;
  };
  CameraParameters p = camera.parameters();
  const int down = times(p.width, width);
  const int up = times(width, p.width);
  double scale = 0.0;
  if (down > 0 && down == times(p.height, height)) {
    scale = 1.0 / down;
  } else if (up > 0 && up == times(height, p.height)) {
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
