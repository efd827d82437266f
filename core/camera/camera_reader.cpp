// Reads camera files of ROS, OpenCV, Kalibr and mrcal.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "core/camera/camera_file.hpp"
#include "core/camera/camera_plausibility.hpp"
#include "core/camera/opencv_xml.hpp"
#include "core/evaluation/running_statistics.hpp"
#include "core/propagate.hpp"
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
// How files of two cameras tell their keys apart.
constexpr std::array kPairSuffixes = {"1", "2", "_1", "_2", "_left", "_right", "Left", "Right"};

// The order of ROS and OpenCV.
constexpr std::array<std::string_view, 14> kCoefficientNames = {
    "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y"};

// The first of `keys` with the suffix that is there; the first of all where none is.
std::string key_present(const YamlFields& fields, std::span<const char* const> keys,
                        const std::string& suffix = {}) {
  for (const char* key : keys) {
    if (fields.has((key + suffix).c_str())) return key + suffix;
  }
  return keys.front() + suffix;
}

bool has_any(const YamlFields& fields, std::span<const char* const> keys,
             const std::string& suffix = {}) {
  return fields.has(key_present(fields, keys, suffix).c_str());
}

// A list of numbers, and where it stands.
struct PlacedNumbers {
  std::vector<double> values;
  std::string place;
};

// A list, or a matrix with the list `data`; none for an empty value.
Result<PlacedNumbers> matrix_numbers(const YamlFields& fields, const std::string& key,
                                     const char* remedy) {
  const Result<YAML::Node> node = fields.node(key.c_str(), remedy);
  if (!node) return tl::unexpected(node.error());
  if (!node->IsMap()) {
    if (node->IsNull()) return PlacedNumbers{{}, fields.place_of(key.c_str())};
    PENUMBRA_TRY(const std::vector<double> values, fields.numbers(key.c_str(), remedy));
    return PlacedNumbers{values, fields.place_of(key.c_str())};
  }
  PENUMBRA_TRY(const YamlFields matrix, fields.fields(key.c_str(), remedy));
  PENUMBRA_TRY(const YAML::Node data, matrix.node("data", remedy));
  if (data.IsNull()) return PlacedNumbers{{}, matrix.place_of("data")};
  PENUMBRA_TRY(const std::vector<double> values, matrix.numbers("data", remedy));
  return PlacedNumbers{values, matrix.place_of("data")};
}

Result<void> take_size(const YamlFields& fields, CameraParameters& p) {
  if (!has_any(fields, kWidthKeys) && has_any(fields, kSizeKeys)) {
    const std::string key = key_present(fields, kSizeKeys);
    PENUMBRA_TRY(const std::vector<double> size,
                 fields.numbers(key.c_str(), "give [width, height]"));
    if (size.size() != 2 || !(size[0] >= 1.0 && size[0] <= 1e6) ||
        !(size[1] >= 1.0 && size[1] <= 1e6))
      return fail("{}: is not a size; give [width, height]", fields.place_of(key.c_str()));
    p.width = static_cast<int>(size[0]);
    p.height = static_cast<int>(size[1]);
    return {};
  }
  PENUMBRA_TRY(const int width, fields.integer(key_present(fields, kWidthKeys).c_str(),
                                               "give the image's width in pixels"));
  PENUMBRA_TRY(const int height, fields.integer(key_present(fields, kHeightKeys).c_str(),
                                                "give the image's height in pixels"));
  p.width = width;
  p.height = height;
  return {};
}

Result<void> take_matrix(const YamlFields& fields, const std::string& key, CameraParameters& p) {
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

// Coefficients as ROS and OpenCV count them, for p.model: missing ones are 0.
Result<void> take_coefficients(const PlacedNumbers& given, CameraParameters& p) {
  const std::vector<double>& d = given.values;
  constexpr std::array<std::size_t, 6> kCounts = {0, 4, 5, 8, 12, 14};
  if (std::ranges::count(kCounts, d.size()) == 0) {
    return fail("{}: has {} numbers; ROS and OpenCV have 0, 4, 5, 8, 12 or 14", given.place,
                d.size());
  }
  const auto count = static_cast<std::size_t>(coefficient_count(p.model));
  for (std::size_t i = count; i < d.size(); ++i) {
    if (d[i] == 0.0) continue;
    if (p.model == DistortionModel::fisheye) {
      return fail("{}: number {} is {}, but equidistant has 4; is it another distortion_model?",
                  given.place, i + 1, d[i]);
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

// Reads the calibration's own uncertainty of the overlay. Files without overlay_px have the corners
// it is made of.
Result<void> take_uncertainty(const YamlFields& fields, CameraParameters& p) {
  constexpr const char* kRemedy = "leave out `uncertainty`, or calibrate again";
  PENUMBRA_TRY(const bool present, fields.has_optional("uncertainty"));
  if (!present) return {};
  PENUMBRA_TRY(const YamlFields uncertainty, fields.fields("uncertainty", kRemedy));
  PENUMBRA_TRY(const bool of_overlay, uncertainty.has_optional("overlay_px"));
  if (of_overlay) {
    PENUMBRA_TRY(const double overlay, uncertainty.number("overlay_px", kRemedy));
    p.overlay_sigma_px = overlay;
  } else if (uncertainty.has("table_volume")) {
    PENUMBRA_TRY(const YamlFields table, uncertainty.fields("table_volume", kRemedy));
    const Result<std::vector<double>> corners = table.numbers("tracked_px", kRemedy);
    if (!corners) return tl::unexpected(corners.error());
    if (!corners->empty()) p.overlay_sigma_px = root_mean_square(*corners);
  }
  return {};
}

// Reads the optional keys that other tools ignore.
Result<void> take_optional(const YamlFields& fields, CameraParameters& p) {
  PENUMBRA_TRY(const bool toned, fields.has_optional("tone_curve"));
  if (toned) {
    PENUMBRA_TRY(
        const double tone,
        fields.number("tone_curve", "give the exponent of the tone curve, or leave it out"));
    p.tone_curve = tone;
  }
  PENUMBRA_TRY(const bool rolls, fields.has_optional("rolling_shutter_row_s"));
  if (rolls) {
    PENUMBRA_TRY(const double row,
                 fields.number("rolling_shutter_row_s",
                               "give the seconds from one row to the next, or leave it out"));
    p.rolling_shutter_row_s = row;
  }
  return take_uncertainty(fields, p);
}

// A matrix that OpenCV's FileStorage wrote: !!opencv-matrix, or its keys.
bool is_opencv_matrix(const YAML::Node& node) {
  if (!node.IsMap()) return false;
  const YAML::Node type = node["type_id"];
  return node.Tag().ends_with("opencv-matrix") || node["dt"].IsDefined() ||
         (type.IsDefined() && type.IsScalar() && type.Scalar() == "opencv-matrix");
}

// The lens model that the file names, if it names one.
Result<std::optional<DistortionModel>> named_model(const YamlFields& fields) {
  constexpr const char* kModel =
      "name plumb_bob, rational_polynomial or equidistant (also: fisheye)";
  const Result<bool> named = fields.has_optional("distortion_model");
  if (!named) return tl::unexpected(named.error());
  const char* key = *named || !fields.has("camera_model") ? "distortion_model" : "camera_model";
  if (fields.has(key)) {
    const Result<YAML::Node> node = fields.node(key, kModel);
    if (!node) return tl::unexpected(node.error());
    if (!node->IsNull() && !(node->IsScalar() && node->Scalar().empty())) {
      PENUMBRA_TRY(const std::string model, fields.text(key, kModel));
      if (model == "plumb_bob") return DistortionModel::plumb_bob;
      if (model == "rational_polynomial") return DistortionModel::rational;
      if (model == "equidistant" || model == "fisheye") return DistortionModel::fisheye;
      const bool projection = key == std::string_view("camera_model") && model == "pinhole";
      if (!projection)
        return fail("{}: the lens model '{}' is not supported; {}", fields.place_of(key), model,
                    kModel);
    }
  }
  if (fields.has("fisheye_model")) {
    PENUMBRA_TRY(const int fisheye, fields.integer("fisheye_model", "give 0 or 1"));
    if (fisheye != 0) return DistortionModel::fisheye;
  }
  return std::nullopt;
}

// By the coefficients alone, as OpenCV does.
DistortionModel model_by_count(const std::vector<double>& d) {
  for (std::size_t i = 5; i < std::min<std::size_t>(d.size(), 8); ++i) {
    if (d[i] != 0.0) return DistortionModel::rational;
  }
  return DistortionModel::plumb_bob;
}

// A message of a camera that crops or bins its images has the matrix of the whole ones.
Result<void> check_whole_image(const YamlFields& fields, const CameraParameters& p) {
  constexpr const char* kRemedy = "give 0 or 1";
  for (const char* key : {"binning_x", "binning_y"}) {
    if (!fields.has(key)) continue;
    PENUMBRA_TRY(const int binning, fields.integer(key, kRemedy));
    if (binning > 1) {
      return fail(
          "{}: is {}: images are smaller than the calibration; set the camera to whole "
          "images and take its camera_info again",
          fields.place_of(key), binning);
    }
  }
  if (!fields.has("roi")) return {};
  const Result<YamlFields> roi = fields.fields("roi", "leave it out for whole images");
  if (!roi) return tl::unexpected(roi.error());
  struct Part {
    const char* key;
    int whole;
  };
  for (const auto& [key, whole] : {Part{"x_offset", 0}, Part{"y_offset", 0}, Part{"width", p.width},
                                   Part{"height", p.height}}) {
    if (!roi->has(key)) continue;
    PENUMBRA_TRY(const int value, roi->integer(key, "give pixels"));
    if (value != 0 && value != whole) {
      return fail(
          "{}: is {}: images are a part of what is calibrated; set the camera to whole "
          "images and take its camera_info again",
          roi->place_of(key), value);
    }
  }
  return {};
}

// Fails for the mirror parameter of OpenCV's omnidir, whose coefficients are no pinhole camera's.
Result<void> check_no_mirror(const YamlFields& fields, const std::string& suffix) {
  constexpr const char* kRemedy = "give one number";
  const std::string key = "xi" + suffix;
  if (!fields.has(key.c_str())) return {};
  PENUMBRA_TRY(const YAML::Node node, fields.node(key.c_str(), kRemedy));
  std::vector<double> values;
  // A matrix of one number in XML has a scalar as its data.
  const YAML::Node data = node.IsMap() ? node["data"] : YAML::Node();
  const bool scalar_data = data.IsDefined() && data.IsScalar();
  if (node.IsScalar() || scalar_data) {
    PENUMBRA_TRY(const double value,
                 scalar_data
                     ? fields.fields(key.c_str(), kRemedy).and_then([&](const YamlFields& matrix) {
                         return matrix.number("data", kRemedy);
                       })
                     : fields.number(key.c_str(), kRemedy));
    values.push_back(value);
  } else {
    PENUMBRA_TRY(const PlacedNumbers numbers, matrix_numbers(fields, key, kRemedy));
    values = numbers.values;
  }
  const auto mirror = std::ranges::find_if(values, [](double value) { return value != 0.0; });
  if (mirror == values.end()) return {};
  return fail(
      "{}: is {}: the omnidirectional camera model (cv::omnidir) is not supported; calibrate as "
      "plumb_bob, rational_polynomial or equidistant (penumbra calibrate)",
      fields.place_of(key.c_str()), *mirror);
}

// Warning where the file names no lens model and its coefficients may be of more than one.
std::optional<std::string> assumed_model_text(const YamlFields& fields,
                                              const std::string& matrix_key,
                                              const std::vector<double>& coefficients,
                                              DistortionModel assumed) {
  if (std::ranges::all_of(coefficients, [](double d) { return d == 0.0; })) return std::nullopt;
  // In ROS's files the model is needed, and their readers assume one. OpenCV's files name none.
  const bool ros = matrix_key == "camera_matrix" || matrix_key == "K" || matrix_key == "k";
  if (ros && !is_opencv_matrix(*fields.node(matrix_key.c_str(), ""))) {
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

// ROS camera_info files and messages, and OpenCV's files. `suffix`: of the keys of one camera of
// two.
Result<ReadCamera> read_ros_or_opencv(const YamlFields& fields, const std::string& suffix = {}) {
  ReadCamera read;
  CameraParameters& p = read.parameters;
  PENUMBRA_TRY_VOID(take_size(fields, p));
  const std::string matrix_key = key_present(fields, kMatrixKeys, suffix);
  PENUMBRA_TRY_VOID(take_matrix(fields, matrix_key, p));
  PENUMBRA_TRY_VOID(check_whole_image(fields, p));
  PENUMBRA_TRY_VOID(check_no_mirror(fields, suffix));

  PENUMBRA_TRY(const std::optional<DistortionModel> model, named_model(fields));
  PENUMBRA_TRY(
      const PlacedNumbers coefficients,
      matrix_numbers(fields, key_present(fields, kDistortionKeys, suffix),
                     "give data: [k1, k2, ...], or data: [] for a lens without distortion"));
  p.model = model.value_or(model_by_count(coefficients.values));
  if (!model) {
    auto text = assumed_model_text(fields, matrix_key, coefficients.values, p.model);
    if (text) read.warnings.push_back(std::move(*text));
  }
  PENUMBRA_TRY_VOID(take_coefficients(coefficients, p));

  if (fields.has("camera_name")) {
    const Result<YAML::Node> name = fields.node("camera_name", "");
    if (!name) return tl::unexpected(name.error());
    if (!name->IsScalar() && !name->IsNull())
      return fail("{}: is not text; give a name or leave it out", fields.place_of("camera_name"));
    p.name = name->IsScalar() ? name->Scalar() : "";
  }
  PENUMBRA_TRY_VOID(take_optional(fields, p));
  return read;
}

// Reads the image size from a list [width, height].
Result<void> read_size(const YamlFields& fields, const char* key, CameraParameters& p) {
  PENUMBRA_TRY(const std::vector<double> size, fields.numbers(key, "give [width, height]"));
  const auto is_side = [](double side) { return side >= 1.0 && side <= 1e6; };
  if (size.size() != 2 || !is_side(size[0]) || !is_side(size[1]))
    return fail("{}: is not a size; give [width, height]", fields.place_of(key));
  p.width = static_cast<int>(size[0]);
  p.height = static_cast<int>(size[1]);
  return {};
}

// `k`: fx, fy, cx, cy, and what may follow.
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
  PENUMBRA_TRY(const std::vector<double> k, camera.numbers("intrinsics", "give [fx, fy, cx, cy]"));
  if (k.size() != 4)
    return fail("{}: has {} numbers; give [fx, fy, cx, cy]", camera.place_of("intrinsics"),
                k.size());
  PENUMBRA_TRY_VOID(read_size(camera, "resolution", p));
  set_pinhole(k, p);
  PENUMBRA_TRY(const std::string model,
               camera.text("distortion_model", "name radtan, equidistant or none"));
  if (model == "none") return read;
  PENUMBRA_TRY(const std::vector<double> d,
               camera.numbers("distortion_coeffs", "give the model's 4 coefficients"));
  if (model != "radtan" && model != "equidistant")
    return fail("{}: the lens model '{}' is not supported; use radtan or equidistant",
                camera.place_of("distortion_model"), model);
  if (d.size() != 4 && !(model == "radtan" && d.size() == 5))
    return fail("{}: has {} numbers, but {} has 4", camera.place_of("distortion_coeffs"), d.size(),
                model);
  p.model = model == "radtan" ? DistortionModel::plumb_bob : DistortionModel::fisheye;
  std::copy(d.begin(), d.end(), p.distortion.begin());
  return read;
}

Result<ReadCamera> read_mrcal(const YamlFields& fields) {
  ReadCamera read;
  CameraParameters& p = read.parameters;
  PENUMBRA_TRY(const std::string model, fields.text("lensmodel", "name LENSMODEL_OPENCV5"));
  std::size_t count = 0;
  if (model == "LENSMODEL_OPENCV4") {
    count = 4;
  } else if (model == "LENSMODEL_OPENCV5") {
    count = 5;
  } else if (model == "LENSMODEL_OPENCV8") {
    count = 8;
  } else if (model != "LENSMODEL_PINHOLE") {
    return fail("{}: '{}' is not supported; fit LENSMODEL_OPENCV8 with mrcal-convert-lensmodel",
                fields.place_of("lensmodel"), model);
  }
  PENUMBRA_TRY(const std::vector<double> k,
               fields.numbers("intrinsics", "give fx, fy, cx, cy and the model's coefficients"));
  if (k.size() != 4 + count)
    return fail("{}: has {} numbers, but {} has {}", fields.place_of("intrinsics"), k.size(), model,
                4 + count);
  PENUMBRA_TRY_VOID(read_size(fields, "imagersize", p));
  set_pinhole(k, p);
  p.model = count == 8 ? DistortionModel::rational : DistortionModel::plumb_bob;
  std::copy(k.begin() + 4, k.end(), p.distortion.begin());
  return read;
}

// mrcal writes Python's bytes, b'...', which are no YAML.
std::string without_bytes_literals(std::string text) {
  if (text.find("lensmodel") == std::string::npos) return text;
  for (std::size_t at = text.find(" b'"); at != std::string::npos; at = text.find(" b'", at))
    text.erase(at + 1, 1);
  return text;
}

bool is_camera(const YamlFields& fields) {
  return has_any(fields, kMatrixKeys) || fields.has("lensmodel");
}

// Names of the cameras that are maps of their own: Kalibr's, and others that are wrapped.
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

// Suffixes of the keys of a file of two cameras, as M1 and M2.
std::vector<std::string> pair_suffixes(const YamlFields& fields) {
  std::vector<std::string> suffixes;
  for (const char* suffix : kPairSuffixes) {
    const std::string key = key_present(fields, kMatrixKeys, suffix);
    const Result<YAML::Node> node = fields.node(key.c_str(), "");
    // k1 alone is a coefficient.
    if (node && (node->IsMap() || node->IsSequence())) suffixes.emplace_back(suffix);
  }
  return suffixes;
}

std::string joined_names(const std::vector<std::string>& names) {
  std::string text;
  for (const std::string& name : names) text += (text.empty() ? "" : ", ") + name;
  return text;
}

// Position of the camera that is meant.
Result<std::size_t> choose_camera(const std::vector<std::string>& names, const std::string& wanted,
                                  const std::string& file) {
  if (wanted.empty()) {
    if (names.size() == 1) return 0;
    return fail("{}: holds several cameras: {}; name one of them (--camera-name)", file,
                joined_names(names));
  }
  const auto found = std::ranges::find(names, wanted);
  if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
  return fail("{}: has no camera '{}' (--camera-name); it holds {}", file, wanted,
              joined_names(names));
}

Result<ReadCamera> read_any(const YAML::Node& root, const std::string& file,
                            const std::string& wanted) {
  const YamlFields fields(root, file);
  if (!is_camera(fields)) {
    if (const std::vector<std::string> names = wrapped_cameras(root); !names.empty()) {
      PENUMBRA_TRY(const std::size_t chosen, choose_camera(names, wanted, file));
      PENUMBRA_TRY(const YamlFields camera,
                   fields.fields(names[chosen].c_str(), "give the camera's map"));
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

// Fails for a lens that can't be used: its distortion is non-monotonic near the image's centre, or
// the image lies elsewhere. A sign or a power of ten is wrong, or the coefficients are another
// model's.
Result<void> check_lens(const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
  const Eigen::Vector2d centre(p.cx, p.cy);
  const double larger = std::max(camera.width(), camera.height());
  if (!((centre - 0.5 * Eigen::Vector2d(p.width, p.height)).norm() < 10.0 * larger)) {
    return fail(
        "camera_matrix: the principal point ({:g}, {:g}) lies far outside the {} x {} image; "
        "correct it, or image_width and image_height",
        p.cx, p.cy, p.width, p.height);
  }
  // Nor does a lens spread a small part of what a straight one sees over the whole image.
  const std::optional<Eigen::Vector3d> edge = camera.unproject({p.cx + 0.5 * larger, p.cy});
  const double straight = 0.5 * larger / p.fx;
  if (edge && edge->head<2>().norm() < 0.05 * straight * edge->z()) {
    return fail(
        "distortion coefficients: they move the image's edge {:.0f} times as far out as a lens "
        "without distortion; correct them or the distortion_model",
        straight * edge->z() / edge->head<2>().norm());
  }
  if (!std::isfinite(camera.max_radius())) return {};
  const double shorter = std::min(camera.width(), camera.height());
  // Just inside, so that rounding does not decide.
  const std::optional<Eigen::Vector2d> limit =
      camera.project({camera.max_radius() * (1.0 - 1e-9), 0.0, 1.0});
  if (limit && (*limit - centre).norm() >= 0.25 * shorter) return {};
  return fail(
      "distortion coefficients: they are non-monotonic from {:.0f} px off the principal point on, "
      "in an image of {} x {} px; correct them or the distortion_model",
      limit ? (*limit - centre).norm() : 0.0, camera.width(), camera.height());
}

}  // namespace

Result<LoadedCamera> load_camera_file(const std::filesystem::path& file, const std::string& name) {
  const Result<std::string> text = read_text_file(file, kMaxYamlBytes);
  if (!text) return tl::unexpected(text.error());
  PENUMBRA_TRY(const YAML::Node root,
               is_xml(*text) ? parse_opencv_xml(*text, file.string())
                             : parse_yaml_map(without_bytes_literals(*text), file.string()));
  try {
    PENUMBRA_TRY(ReadCamera read, read_any(root, file.string(), name));
    Result<CameraModel> camera = CameraModel::make(read.parameters);
    if (!camera) return fail_in(file.string(), camera.error());
    if (auto ok = check_lens(*camera); !ok) return fail_in(file.string(), ok.error());
    if (const auto implausible = implausible_parameter(*camera))
      read.warnings.push_back(fmt::format("{}: {}", file.string(), *implausible));
    return LoadedCamera{std::move(*camera), std::move(read.warnings)};
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as a camera file ({}); correct the file", file.string(),
                error.what());
  }
}

Result<CameraModel> load_camera(const std::filesystem::path& file) {
  PENUMBRA_TRY(LoadedCamera loaded, load_camera_file(file));
  return std::move(loaded.camera);
}

}  // namespace penumbra
