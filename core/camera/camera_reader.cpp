// Reads camera files of ROS, OpenCV, Kalibr and mrcal.
#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>

#include "core/camera/camera_file.hpp"
#include "core/camera/camera_plausibility.hpp"
#include "core/camera/opencv_xml.hpp"
#include "core/propagate.hpp"
#include "core/statistics.hpp"
#include "core/text/text.hpp"
#include "core/text/yaml_fields.hpp"

namespace penumbra {
namespace {

constexpr std::array kWidthKeys = {"image_width", "image_Width", "Image_Width", "width"};
constexpr std::array kHeightKeys = {"image_height", "image_Height", "Image_Height", "height"};
constexpr std::array kSizeKeys = {"image_size", "imageSize", "Image_Size", "size"};
constexpr std::array kMatrixKeys = {
    "camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "k", "M"};
constexpr std::array kDistortionKeys = {"distortion_coefficients",
                                        "Distortion_Coefficients",
                                        "distCoeffs",
                                        "dist_coeffs",
                                        "distortionCoefficients",
                                        "D",
                                        "d"};
// Suffixes of keys in stereo files.
constexpr std::array kPairSuffixes = {"1", "2", "_1", "_2", "_left", "_right", "Left", "Right"};

// Names of the coefficients, in the order of ROS and OpenCV.
constexpr std::array<std::string_view, 14> kCoefficientNames = {
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"};

// Returns the first of `keys` that is present with the suffix, or keys.front() if none is.
std::string key_present(const YamlFields& fields, std::span<const char* const> keys,
                        const std::string& suffix = {}) {
  for (const char* key : keys) {
    if (fields.has(key + suffix)) return key + suffix;
  }
  return keys.front() + suffix;
}

bool has_any(const YamlFields& fields, std::span<const char* const> keys) {
  return fields.has(key_present(fields, keys));
}

// A list of numbers and its location in the file, for errors.
struct PlacedNumbers {
  std::vector<double> values;
  std::string place;
};

// Reads a list; an empty value is an empty list.
Result<PlacedNumbers> list_at(const YamlFields& fields, const std::string& key,
                              const char* remedy) {
  PlacedNumbers list{{}, fields.place_of(key)};
  PENUMBRA_TRY(const YAML::Node node, fields.node(key, remedy));
  if (node.IsNull()) return list;
  PENUMBRA_TRY(list.values, fields.numbers(key, remedy));
  return list;
}

// Reads a list, or the list `data` of a matrix.
Result<PlacedNumbers> matrix_numbers(const YamlFields& fields, const std::string& key,
                                     const char* remedy) {
  PENUMBRA_TRY(const YAML::Node node, fields.node(key, remedy));
  if (!node.IsMap()) return list_at(fields, key, remedy);
  PENUMBRA_TRY(const YamlFields matrix, fields.fields(key, remedy));
  return list_at(matrix, "data", remedy);
}

// Reads the image size from a list [width, height].
Result<void> read_size_list(const YamlFields& fields, const std::string& key, CameraParameters& p) {
  PENUMBRA_TRY(const std::vector<double> size, fields.numbers(key, "give [width, height]"));
  const auto is_side = [](double side) { return side >= 1.0 && side <= 1e6; };
  if (size.size() != 2 || !is_side(size[0]) || !is_side(size[1]))
    return fail("{}: is not a size; give [width, height]", fields.place_of(key));
  p.width = static_cast<int>(size[0]);
  p.height = static_cast<int>(size[1]);
  return {};
}

Result<void> read_image_size(const YamlFields& fields, CameraParameters& p) {
  if (!has_any(fields, kWidthKeys) && has_any(fields, kSizeKeys))
    return read_size_list(fields, key_present(fields, kSizeKeys), p);
  PENUMBRA_TRY(p.width,
               fields.integer(key_present(fields, kWidthKeys), "give the image's width in pixels"));
  PENUMBRA_TRY(p.height, fields.integer(key_present(fields, kHeightKeys),
                                        "give the image's height in pixels"));
  return {};
}

Result<void> read_matrix(const YamlFields& fields, const std::string& key, CameraParameters& p) {
  constexpr const char* kMatrix = "give data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]";
  PENUMBRA_TRY(const PlacedNumbers matrix, matrix_numbers(fields, key, kMatrix));
  const std::vector<double>& k = matrix.values;
  if (k.size() != 9) return fail("{}: has {} numbers; {}", matrix.place, k.size(), kMatrix);
  if (std::ranges::all_of(k, [](double value) { return value == 0.0; })) {
    return fail("{}: holds zeros: the camera is not calibrated; calibrate it (penumbra calibrate)",
                matrix.place);
  }
  if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0)
    return fail("{}: has skew or is not a camera matrix; {}", matrix.place, kMatrix);
  p.fx = k[0];
  p.cx = k[2];
  p.fy = k[4];
  p.cy = k[5];
  return {};
}

// Lists the models of a file format: "plumb_bob, rational_polynomial or equidistant".
std::string model_names(CameraFileFormat format, const char* last = nullptr) {
  std::vector<std::string_view> names;
  for (const DistortionModel model : kDistortionModels) {
    if (const auto name = model_name(model, format)) names.push_back(*name);
  }
  if (last != nullptr) names.emplace_back(last);
  const std::string_view final_name = names.back();
  names.pop_back();
  return fmt::format("{} or {}", fmt::join(names, ", "), final_name);
}

std::optional<DistortionModel> model_from_name(std::string_view name, CameraFileFormat format) {
  const auto found = std::ranges::find_if(
      kDistortionModels, [&](DistortionModel model) { return model_name(model, format) == name; });
  return found != kDistortionModels.end() ? std::optional(*found) : std::nullopt;
}

// Sets the coefficients of p.model from a list in the order of ROS and OpenCV; missing ones are 0.
Result<void> set_coefficients(const PlacedNumbers& given, CameraParameters& p) {
  const std::vector<double>& d = given.values;
  constexpr std::array<std::size_t, 6> kCounts = {0, 4, 5, 8, 12, 14};
  if (std::ranges::count(kCounts, d.size()) == 0) {
    return fail("{}: has {} numbers; ROS and OpenCV have 0, 4, 5, 8, 12 or 14", given.place,
                d.size());
  }
  const auto count = static_cast<std::size_t>(coefficient_count(p.model));
  for (std::size_t i = count; i < d.size(); ++i) {
    if (d[i] == 0.0) continue;
    if (!is_polynomial(p.model)) {
      return fail("{}: number {} is {}, but {} has {}; is it another distortion_model?",
                  given.place, i + 1, d[i], to_string(p.model), count);
    }
    if (i >= 8) {
      return fail(
          "{}: number {} ({}, of {}) is {}; thin prisms and tilt are not supported: calibrate with "
          "8 coefficients or fewer",
          given.place, i + 1, kCoefficientNames[i], i < 12 ? "a thin prism" : "a tilted sensor",
          d[i]);
    }
    return fail(
        "{}: number {} ({}) is {}, but plumb_bob has 5; name rational_polynomial as the "
        "distortion_model if it is one",
        given.place, i + 1, kCoefficientNames[i], d[i]);
  }
  std::copy_n(d.begin(), std::min(d.size(), count), p.distortion.begin());
  return {};
}

// Reads overlay_px. Older files have a value per corner instead; the result is their RMS.
Result<void> read_uncertainty(const YamlFields& fields, CameraParameters& p) {
  constexpr const char* kRemedy = "leave out `uncertainty`, or calibrate again";
  PENUMBRA_TRY(const bool present, fields.has_optional("uncertainty"));
  if (!present) return {};
  PENUMBRA_TRY(const YamlFields uncertainty, fields.fields("uncertainty", kRemedy));
  PENUMBRA_TRY(p.overlay_sigma_px, uncertainty.optional_number("overlay_px", kRemedy));
  if (p.overlay_sigma_px || !uncertainty.has("table_volume")) return {};
  PENUMBRA_TRY(const YamlFields table, uncertainty.fields("table_volume", kRemedy));
  PENUMBRA_TRY(const std::vector<double> corners, table.numbers("tracked_px", kRemedy));
  if (!corners.empty()) p.overlay_sigma_px = root_mean_square(corners);
  return {};
}

// Reads the optional keys, which other programs ignore.
Result<void> read_optional_fields(const YamlFields& fields, CameraParameters& p) {
  PENUMBRA_TRY(
      p.tone_curve,
      fields.optional_number("tone_curve", "give the exponent of the tone curve, or leave it out"));
  PENUMBRA_TRY(
      p.rolling_shutter_row_s,
      fields.optional_number("rolling_shutter_row_s",
                             "give the seconds from one row to the next, or leave it out"));
  return read_uncertainty(fields, p);
}

// Recognises a matrix of OpenCV's FileStorage by its YAML tag or its keys.
bool is_opencv_matrix(const YAML::Node& node) {
  if (!node.IsMap()) return false;
  const YAML::Node type = node["type_id"];
  return node.Tag().ends_with("opencv-matrix") || node["dt"].IsDefined() ||
         (type.IsDefined() && type.IsScalar() && type.Scalar() == "opencv-matrix");
}

// Returns the lens model that the file specifies, or nullopt if it specifies none.
Result<std::optional<DistortionModel>> specified_model(const YamlFields& fields) {
  const std::string remedy =
      fmt::format("name {} (also: fisheye)", model_names(CameraFileFormat::ros));
  PENUMBRA_TRY(const bool named, fields.has_optional("distortion_model"));
  const std::string key =
      named || !fields.has("camera_model") ? "distortion_model" : "camera_model";
  if (fields.has(key)) {
    PENUMBRA_TRY(const YAML::Node node, fields.node(key, remedy.c_str()));
    if (!node.IsNull() && !(node.IsScalar() && node.Scalar().empty())) {
      PENUMBRA_TRY(const std::string model, fields.text(key, remedy.c_str()));
      if (const auto known = model_from_name(model, CameraFileFormat::ros)) return known;
      if (model == "fisheye") return DistortionModel::fisheye;
      const bool projection = key == "camera_model" && model == "pinhole";
      if (!projection)
        return fail("{}: the lens model '{}' is not supported; {}", fields.place_of(key), model,
                    remedy);
    }
  }
  if (fields.has("fisheye_model")) {
    PENUMBRA_TRY(const int fisheye, fields.integer("fisheye_model", "give 0 or 1"));
    if (fisheye != 0) return DistortionModel::fisheye;
  }
  return std::nullopt;
}

// Guesses the model from the coefficients, as OpenCV does.
DistortionModel model_by_count(const std::vector<double>& d) {
  for (std::size_t i = 5; i < std::min<std::size_t>(d.size(), 8); ++i) {
    if (d[i] != 0.0) return DistortionModel::rational;
  }
  return DistortionModel::plumb_bob;
}

// Fails for a ROS message of a camera that crops or bins, because its matrix is for full images.
Result<void> check_whole_image(const YamlFields& fields, const CameraParameters& p) {
  for (const char* key : {"binning_x", "binning_y"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(const int binning, fields.integer(key, "give 0 or 1"));
    if (binning > 1) {
      return fail(
          "{}: is {}: images are smaller than the calibration; set the camera to whole "
          "images and take its camera_info again",
          fields.place_of(key), binning);
    }
  }
  if (!fields.has("roi")) return {};
  PENUMBRA_TRY(const YamlFields roi, fields.fields("roi", "leave it out for whole images"));
  for (const auto& [key, whole] : {std::pair("x_offset", 0), std::pair("y_offset", 0),
                                   std::pair("width", p.width), std::pair("height", p.height)}) {
    if (!roi.has(key)) continue;
    PENUMBRA_TRY(const int value, roi.integer(key, "give pixels"));
    if (value != 0 && value != whole) {
      return fail(
          "{}: is {}: images are a part of what is calibrated; set the camera to whole "
          "images and take its camera_info again",
          roi.place_of(key), value);
    }
  }
  return {};
}

// Fails if the file has the mirror parameter of OpenCV's omnidir, a model that is not supported.
Result<void> check_no_mirror(const YamlFields& fields, const std::string& suffix) {
  constexpr const char* kRemedy = "give one number";
  const std::string key = "xi" + suffix;
  if (!fields.has(key)) return {};
  PENUMBRA_TRY(const YAML::Node node, fields.node(key, kRemedy));
  PENUMBRA_TRY(const YamlFields holder,
               node.IsMap() ? fields.fields(key, kRemedy) : Result<YamlFields>(fields));
  const std::string list_key = node.IsMap() ? "data" : key;
  PENUMBRA_TRY(const YAML::Node list, holder.node(list_key, kRemedy));
  std::vector<double> values;
  if (list.IsScalar()) {  // OpenCV's XML has a scalar for a 1 x 1 matrix
    PENUMBRA_TRY(values.emplace_back(), holder.number(list_key, kRemedy));
  } else {
    PENUMBRA_TRY(const PlacedNumbers numbers, list_at(holder, list_key, kRemedy));
    values = numbers.values;
  }
  const auto mirror = std::ranges::find_if(values, [](double value) { return value != 0.0; });
  if (mirror == values.end()) return {};
  return fail(
      "{}: is {}: the omnidirectional camera model (cv::omnidir) is not supported; calibrate as "
      "{} (penumbra calibrate)",
      fields.place_of(key), *mirror, model_names(CameraFileFormat::ros));
}

// Returns a warning if the file specifies no lens model and its coefficients fit more than one.
std::optional<std::string> assumed_model_text(const YamlFields& fields,
                                              const std::string& matrix_key,
                                              const std::vector<double>& coefficients,
                                              DistortionModel assumed) {
  if (std::ranges::all_of(coefficients, [](double d) { return d == 0.0; })) return std::nullopt;
  // ROS files must specify a model; OpenCV files have no such key.
  const bool ros = matrix_key == "camera_matrix" || matrix_key == "K" || matrix_key == "k";
  if (ros && !is_opencv_matrix(*fields.node(matrix_key, ""))) {
    return fmt::format("{}: distortion_model: is missing; {} is assumed", fields.place(),
                       to_string(assumed));
  }
  if (coefficients.size() != 4 || fields.has("fisheye_model")) return std::nullopt;
  return fmt::format(
      "{}: has 4 distortion coefficients and names no model; {} is assumed. If they are of "
      "cv::fisheye, add the line `distortion_model: equidistant`",
      fields.place(), to_string(assumed));
}

struct ReadCamera {
  CameraParameters parameters;
  std::vector<std::string> warnings;
};

// Reads ROS camera_info files and messages, and OpenCV files. `suffix` selects a stereo camera.
Result<ReadCamera> read_ros_or_opencv(const YamlFields& fields, const std::string& suffix = {}) {
  ReadCamera read;
  CameraParameters& p = read.parameters;
  PENUMBRA_TRY_VOID(read_image_size(fields, p));
  const std::string matrix_key = key_present(fields, kMatrixKeys, suffix);
  PENUMBRA_TRY_VOID(read_matrix(fields, matrix_key, p));
  PENUMBRA_TRY_VOID(check_whole_image(fields, p));
  PENUMBRA_TRY_VOID(check_no_mirror(fields, suffix));

  PENUMBRA_TRY(const std::optional<DistortionModel> model, specified_model(fields));
  PENUMBRA_TRY(
      const PlacedNumbers coefficients,
      matrix_numbers(fields, key_present(fields, kDistortionKeys, suffix),
                     "give data: [k1, k2, ...], or data: [] for a lens without distortion"));
  p.model = model.value_or(model_by_count(coefficients.values));
  if (!model) {
    auto text = assumed_model_text(fields, matrix_key, coefficients.values, p.model);
    if (text) read.warnings.push_back(std::move(*text));
  }
  PENUMBRA_TRY_VOID(set_coefficients(coefficients, p));

  if (fields.has("camera_name")) {
    PENUMBRA_TRY(const YAML::Node name, fields.node("camera_name", ""));
    if (!name.IsScalar() && !name.IsNull())
      return fail("{}: is not text; give a name or leave it out", fields.place_of("camera_name"));
    p.name = name.IsScalar() ? name.Scalar() : "";
  }
  PENUMBRA_TRY_VOID(read_optional_fields(fields, p));
  return read;
}

// Sets fx, fy, cx, cy from the first four numbers.
void set_pinhole(const std::vector<double>& k, CameraParameters& p) {
  p.fx = k[0];
  p.fy = k[1];
  p.cx = k[2];
  p.cy = k[3];
}

Result<ReadCamera> read_kalibr(const YamlFields& camera) {
  ReadCamera read;
  CameraParameters& p = read.parameters;
  PENUMBRA_TRY(const std::string kind, camera.text("camera_model", "name pinhole"));
  if (kind != "pinhole")
    return fail("{}: '{}' is not supported; calibrate as pinhole-radtan or pinhole-equi",
                camera.place_of("camera_model"), kind);
  PENUMBRA_TRY(const std::vector<double> k,
               camera.numbers("intrinsics", 4, "give [fx, fy, cx, cy]"));
  PENUMBRA_TRY_VOID(read_size_list(camera, "resolution", p));
  set_pinhole(k, p);
  PENUMBRA_TRY(const std::string model,
               camera.text("distortion_model",
                           ("name " + model_names(CameraFileFormat::kalibr, "none")).c_str()));
  if (model == "none") return read;
  PENUMBRA_TRY(const std::vector<double> d,
               camera.numbers("distortion_coeffs", "give the model's 4 coefficients"));
  const std::optional<DistortionModel> lens = model_from_name(model, CameraFileFormat::kalibr);
  if (!lens)
    return fail("{}: the lens model '{}' is not supported; use {}",
                camera.place_of("distortion_model"), model, model_names(CameraFileFormat::kalibr));
  if (d.size() != 4 && !(model == "radtan" && d.size() == 5))
    return fail("{}: has {} numbers, but {} has 4", camera.place_of("distortion_coeffs"), d.size(),
                model);
  p.model = *lens;
  std::copy(d.begin(), d.end(), p.distortion.begin());
  return read;
}

Result<ReadCamera> read_mrcal(const YamlFields& fields) {
  ReadCamera read;
  CameraParameters& p = read.parameters;
  PENUMBRA_TRY(const std::string model, fields.text("lensmodel", "name LENSMODEL_OPENCV5"));
  constexpr std::array<std::pair<std::string_view, std::size_t>, 4> kCoefficientCounts = {
      {{"LENSMODEL_PINHOLE", 0},
       {"LENSMODEL_OPENCV4", 4},
       {"LENSMODEL_OPENCV5", 5},
       {"LENSMODEL_OPENCV8", 8}}};
  const auto known = std::ranges::find(kCoefficientCounts, model,
                                       &std::pair<std::string_view, std::size_t>::first);
  if (known == kCoefficientCounts.end()) {
    return fail("{}: '{}' is not supported; fit LENSMODEL_OPENCV8 with mrcal-convert-lensmodel",
                fields.place_of("lensmodel"), model);
  }
  const std::size_t count = known->second;
  PENUMBRA_TRY(const std::vector<double> k,
               fields.numbers("intrinsics", "give fx, fy, cx, cy and the model's coefficients"));
  if (k.size() != 4 + count)
    return fail("{}: has {} numbers, but {} has {}", fields.place_of("intrinsics"), k.size(), model,
                4 + count);
  PENUMBRA_TRY_VOID(read_size_list(fields, "imagersize", p));
  set_pinhole(k, p);
  p.model = count == 8 ? DistortionModel::rational : DistortionModel::plumb_bob;
  std::copy(k.begin() + 4, k.end(), p.distortion.begin());
  return read;
}

// Removes the prefix b of Python bytes literals (b'...'), which mrcal writes.
std::string without_bytes_literals(std::string text) {
  if (text.find("lensmodel") == std::string::npos) return text;
  for (std::size_t at = text.find(" b'"); at != std::string::npos; at = text.find(" b'", at))
    text.erase(at + 1, 1);
  return text;
}

bool is_camera(const YamlFields& fields) {
  return has_any(fields, kMatrixKeys) || fields.has("lensmodel");
}

// Returns the names of the top-level maps that contain a camera, as in Kalibr's files.
std::vector<std::string> wrapped_cameras(const YAML::Node& root) {
  std::vector<std::string> names;
  for (const auto& entry : root) {
    if (!entry.first.IsScalar() || !entry.second.IsMap()) continue;
    const YamlFields fields(entry.second, "");
    if (fields.has("camera_model") || fields.has("intrinsics") || is_camera(fields))
      names.push_back(entry.first.Scalar());
  }
  return names;
}

// Returns the suffixes of a stereo file's keys: "1" and "2" for M1 and M2.
std::vector<std::string> pair_suffixes(const YamlFields& fields) {
  std::vector<std::string> suffixes;
  for (const char* suffix : kPairSuffixes) {
    const std::string key = key_present(fields, kMatrixKeys, suffix);
    const Result<YAML::Node> node = fields.node(key, "");
    // A scalar k1 is a coefficient, not a camera matrix.
    if (node && (node->IsMap() || node->IsSequence())) suffixes.emplace_back(suffix);
  }
  return suffixes;
}

// Returns the index of the camera `wanted`; it may be empty if there is only one.
Result<std::size_t> choose_camera(const std::vector<std::string>& names, const std::string& wanted,
                                  const std::string& file) {
  if (wanted.empty()) {
    if (names.size() == 1) return 0;
    return fail("{}: holds several cameras: {}; name one of them (--camera-name)", file,
                fmt::join(names, ", "));
  }
  const auto found = std::ranges::find(names, wanted);
  if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
  return fail("{}: has no camera '{}' (--camera-name); it holds {}", file, wanted,
              fmt::join(names, ", "));
}

Result<ReadCamera> read_any(const YAML::Node& root, const std::string& file,
                            const std::string& wanted) {
  const YamlFields fields(root, file);
  if (!is_camera(fields)) {
    if (const std::vector<std::string> names = wrapped_cameras(root); !names.empty()) {
      PENUMBRA_TRY(const std::size_t chosen, choose_camera(names, wanted, file));
      PENUMBRA_TRY(const YamlFields camera, fields.fields(names[chosen], "give the camera's map"));
      return is_camera(camera) ? read_ros_or_opencv(camera) : read_kalibr(camera);
    }
    if (const std::vector<std::string> suffixes = pair_suffixes(fields); !suffixes.empty()) {
      std::vector<std::string> names;
      for (const std::string& suffix : suffixes)
        names.push_back(key_present(fields, kMatrixKeys, suffix));
      PENUMBRA_TRY(const std::size_t chosen, choose_camera(names, wanted, file));
      return read_ros_or_opencv(fields, suffixes[chosen]);
    }
  }
  Result<ReadCamera> read =
      fields.has("lensmodel") ? read_mrcal(fields) : read_ros_or_opencv(fields);
  if (read && !wanted.empty() && read->parameters.name != wanted) {
    return fail("{}: holds one camera{}; leave out --camera-name", file,
                read->parameters.name.empty() ? "" : fmt::format(", '{}'", read->parameters.name));
  }
  return read;
}

// Fails if the principal point is far outside the image, or if the distortion is huge at the
// image's edge or non-monotonic near its centre: then a sign, an exponent or the model is wrong.
Result<void> check_lens(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const Eigen::Vector2d centre(p.cx, p.cy);
  const double larger = std::max(p.width, p.height);
  if (!((centre - 0.5 * Eigen::Vector2d(p.width, p.height)).norm() < 10.0 * larger)) {
    return fail(
        "camera_matrix: the principal point ({:g}, {:g}) lies far outside the {} x {} image; "
        "correct it, or image_width and image_height",
        p.cx, p.cy, p.width, p.height);
  }
  // No real lens has a distortion this large at the image's edge.
  const std::optional<Eigen::Vector3d> edge = camera.unproject({p.cx + 0.5 * larger, p.cy});
  const double undistorted = 0.5 * larger / p.fx;
  if (edge && edge->head<2>().norm() < 0.05 * undistorted * edge->z()) {
    return fail(
        "distortion coefficients: they move the image's edge {:.0f} times as far out as a lens "
        "without distortion; correct them or the distortion_model",
        undistorted * edge->z() / edge->head<2>().norm());
  }
  const double limit_px = monotonic_radius_px(camera);
  if (limit_px >= 0.25 * std::min(p.width, p.height)) return {};
  return fail(
      "distortion coefficients: they are non-monotonic from {:.0f} px off the principal point on, "
      "in an image of {} x {} px; correct them or the distortion_model",
      limit_px, p.width, p.height);
}

}  // namespace

Result<LoadedCamera> load_camera_file(const std::filesystem::path& file, const std::string& name) {
  PENUMBRA_TRY(const std::string text, read_text_file(file, kMaxYamlBytes));
  PENUMBRA_TRY(const YAML::Node root,
               is_xml(text) ? parse_opencv_xml(text, file.string())
                            : parse_yaml_map(without_bytes_literals(text), file.string()));
  try {
    PENUMBRA_TRY(ReadCamera read, read_any(root, file.string(), name));
    PENUMBRA_TRY(CameraModel camera, with_place(file.string(), CameraModel::make(read.parameters)));
    PENUMBRA_TRY_VOID(with_place(file.string(), check_lens(camera)));
    if (const auto implausible = implausible_parameter(camera))
      read.warnings.push_back(fmt::format("{}: {}", file.string(), *implausible));
    return LoadedCamera{std::move(camera), std::move(read.warnings)};
  } catch (const std::exception& error) {  // thrown by yaml-cpp
    return fail("{}: is not readable as a camera file ({}); correct the file", file.string(),
                error.what());
  }
}

namespace {

struct StoredCameras {
  std::size_t count = 0;
  std::optional<CameraFileFormat> format;  // nullopt: one that is not written
};

CameraFileFormat format_of(const YamlFields& camera) {
  const auto matrix = camera.node(key_present(camera, kMatrixKeys, {}), "");
  return matrix && is_opencv_matrix(*matrix) ? CameraFileFormat::opencv : CameraFileFormat::ros;
}

StoredCameras stored_cameras(const YAML::Node& root, const std::string& file) {
  const YamlFields fields(root, file);
  if (fields.has("lensmodel")) return {1, std::nullopt};
  if (is_camera(fields)) return {1, format_of(fields)};
  if (const auto names = wrapped_cameras(root); !names.empty()) {
    const auto first = fields.fields(names.front(), "");
    const bool is_wrapped = first && is_camera(*first);
    return {names.size(), is_wrapped ? format_of(*first) : CameraFileFormat::kalibr};
  }
  return {pair_suffixes(fields).size(), CameraFileFormat::opencv};
}

StoredCameras stored_cameras(const std::filesystem::path& file) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(file, ignored)) return {};
  const auto text = read_text_file(file, kMaxYamlBytes);
  if (!text || is_xml(*text)) return {};
  const auto root = parse_yaml_map(without_bytes_literals(*text), file.string());
  if (!root) return {};
  try {
    return stored_cameras(*root, file.string());
  } catch (const std::exception&) {  // thrown by yaml-cpp
    return {};
  }
}

}  // namespace

std::size_t camera_count(const std::filesystem::path& file) {
  return stored_cameras(file).count;
}

CameraFileFormat output_format_of(const std::filesystem::path& file) {
  if (const StoredCameras stored = stored_cameras(file); stored.count > 0 && stored.format)
    return *stored.format;
  if (file.filename().string().find("camchain") != std::string::npos)
    return CameraFileFormat::kalibr;
  return file.extension() == ".yml" ? CameraFileFormat::opencv : CameraFileFormat::ros;
}

Result<CameraModel> load_camera(const std::filesystem::path& file) {
  PENUMBRA_TRY(LoadedCamera loaded, load_camera_file(file));
  return std::move(loaded.camera);
}

std::optional<double> load_focus_position(const std::filesystem::path& camera_file) {
  const auto position =
      read_yaml_map(camera_file, "a camera file", [&](const YAML::Node& root) -> Result<double> {
        return YamlFields(root, camera_file.string()).number("focus_position", "");
      });
  return position ? std::optional(*position) : std::nullopt;
}

}  // namespace penumbra
