#include "core/camera_file.hpp"

#include <algorithm>

#include "core/text.hpp"
#include "core/yaml_fields.hpp"

namespace penumbra {
namespace {

template <class Range>
std::string joined(const Range& values) {
  return fmt::format("[{}]", fmt::join(values, ", "));
}

Result<CameraParameters> read_camera(const YamlFields& fields) {
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
  if (fields.has("tone_curve")) {
    const Result<double> tone =
        fields.number("tone_curve", "give the exponent of the tone curve, or leave it out");
    if (!tone) return tl::unexpected(tone.error());
    p.tone_curve = *tone;
  }
  if (fields.has("rolling_shutter_row_s")) {
    const Result<double> row = fields.number(
        "rolling_shutter_row_s", "give the seconds from one row to the next, or leave it out");
    if (!row) return tl::unexpected(row.error());
    p.rolling_shutter_row_s = *row;
  }
  return p;
}

}  // namespace

Result<CameraModel> load_camera(const std::filesystem::path& file) {
  const Result<YAML::Node> root = load_yaml_map(file);
  if (!root) return tl::unexpected(root.error());
  try {
    const Result<CameraParameters> parameters = read_camera(YamlFields(*root, file.string()));
    if (!parameters) return tl::unexpected(parameters.error());
    Result<CameraModel> camera = CameraModel::make(*parameters);
    if (!camera) return fail_in(file.string(), camera.error());
    return camera;
  } catch (const std::exception& error) {  // yaml-cpp's own, should one get past the checks
    return fail("{}: is not readable as a camera file ({}); correct the file", file.string(),
                error.what());
  }
}

Result<void> save_camera(const std::filesystem::path& file, const CameraModel& camera) {
  const CameraParameters& p = camera.parameters();
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
  text += fmt::format("camera_matrix:\n  rows: 3\n  cols: 3\n  data: {}\n", joined(k));
  text += fmt::format("distortion_model: {}\n", to_string(p.model));
  text += fmt::format("distortion_coefficients:\n  rows: 1\n  cols: {}\n  data: {}\n", count,
                      joined(distortion));
  text += fmt::format("rectification_matrix:\n  rows: 3\n  cols: 3\n  data: {}\n", joined(r));
  text += fmt::format("projection_matrix:\n  rows: 3\n  cols: 4\n  data: {}\n", joined(projection));
  if (p.tone_curve) text += fmt::format("tone_curve: {}\n", *p.tone_curve);
  if (p.rolling_shutter_row_s)
    text += fmt::format("rolling_shutter_row_s: {}\n", *p.rolling_shutter_row_s);
  return write_text_file(file, text);
}

}  // namespace penumbra
