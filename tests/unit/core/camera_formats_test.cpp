// Camera files of other tools.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <yaml-cpp/yaml.h>

#include <fstream>
#include <limits>
#include <string>

#include "core/camera/camera_file.hpp"
#include "core/text/text.hpp"
#include "support/cameras.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;
using testing::Not;

// Kalibr's format has no k3.
CameraModel without_k3() {
  CameraParameters p = test::desk_camera().parameters();
  p.distortion[4] = 0.0;
  return CameraModel::make(p).value();
}

Result<CameraModel> read(const std::string& text) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "camera") << text;
  return load_camera(folder.path() / "camera");
}

TEST(CameraFormats, RoundTripEveryFormatAndModel) {
  const test::TemporaryFolder folder;
  for (const auto format :
       {CameraFileFormat::ros, CameraFileFormat::opencv, CameraFileFormat::kalibr}) {
    for (const DistortionModel model : kDistortionModels) {
      SCOPED_TRACE(testing::Message() << to_string(format) << ' ' << to_string(model));
      const CameraModel camera =
          model == DistortionModel::plumb_bob ? without_k3() : test::lens_of(model);
      CalibrationRecord record;
      record.calibrated_on = "2026-03-01";
      record.target = "tags: \"30 mm\"";
      record.standard_deviations = {0.1, 0.1};
      record.held_out_px = 0.2;
      const auto saved = save_camera(folder.path() / "camera", camera, format, &record);
      if (!model_name(model, format)) {
        ASSERT_FALSE(saved);
        EXPECT_THAT(saved.error().message,
                    HasSubstr(fmt::format("{}'s files have no {} lens", to_string(format),
                                          short_name(model))));
        continue;
      }
      ASSERT_TRUE(saved) << saved.error().message;
      const auto loaded = load_camera(folder.path() / "camera");
      ASSERT_TRUE(loaded) << loaded.error().message;
      EXPECT_EQ(loaded->parameters().model, model);
      EXPECT_EQ(loaded->parameters().fx, camera.parameters().fx);
      EXPECT_EQ(loaded->parameters().cy, camera.parameters().cy);
      EXPECT_EQ(loaded->parameters().distortion, camera.parameters().distortion);
      EXPECT_EQ(loaded->width(), 640);
    }
  }
}

TEST(CameraFormats, RejectRationalLensInKalibr) {
  EXPECT_FALSE(model_name(DistortionModel::rational, CameraFileFormat::kalibr));
}

TEST(CameraFormats, LimitKalibrToFourCoefficients) {
  const test::TemporaryFolder folder;
  const CameraModel camera = without_k3();
  CameraParameters p = camera.parameters();
  const auto saved = save_camera(folder.path() / "chain", camera, CameraFileFormat::kalibr);
  ASSERT_TRUE(saved) << saved.error().message;
  const auto chain = YAML::LoadFile((folder.path() / "chain").string())["cam0"];
  EXPECT_EQ(chain["distortion_model"].as<std::string>(), "radtan");
  EXPECT_EQ(chain["distortion_coeffs"].size(), 4U);
  const auto loaded = load_camera(folder.path() / "chain");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->parameters().distortion, p.distortion);
  EXPECT_EQ(loaded->parameters().model, DistortionModel::plumb_bob);
  p.distortion[4] = -0.004;  // Kalibr's format can't store it
  const auto refused =
      save_camera(folder.path() / "other", CameraModel::make(p).value(), CameraFileFormat::kalibr);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("no k3"));
  EXPECT_FALSE(std::filesystem::exists(folder.path() / "other"));
}

// Kalibr interprets every top-level key as a camera.
TEST(CameraFormats, WriteKalibrChainOfOneCamera) {
  const test::TemporaryFolder folder;
  CalibrationRecord record;
  record.calibrated_on = "2024-05-06";
  record.target = "a board";
  record.focus_position = std::numeric_limits<double>::infinity();
  ASSERT_TRUE(
      save_camera(folder.path() / "chain", without_k3(), CameraFileFormat::kalibr, &record));
  const auto root = YAML::LoadFile((folder.path() / "chain").string());
  ASSERT_EQ(root.size(), 1U);
  EXPECT_TRUE(root["cam0"].IsMap());
  const std::string text = read_text_file(folder.path() / "chain", 1 << 20).value();
  EXPECT_THAT(text, HasSubstr("\n# calibrated_on: "));
  EXPECT_THAT(text, Not(HasSubstr("focus_position")));
}

TEST(CameraFormats, RejectSelfReferencingDocuments) {
  const test::TemporaryFolder folder;
  std::string bomb = "a0: &a0 [1, 1]\n";
  for (int i = 1; i < 28; ++i) {
    bomb += fmt::format("a{}: &a{} [*a{}, *a{}]\n", i, i, i - 1, i - 1);
  }
  for (const std::string& text : {std::string("a: &a [*a]\n"), std::string("cam0: &a {x: *a}\n"),
                                  std::string("a: &a {b: [1, *a]}\n"), bomb}) {
    std::ofstream(folder.path() / "camera.yaml") << text;
    const auto loaded = load_camera(folder.path() / "camera.yaml");
    ASSERT_FALSE(loaded);
    EXPECT_THAT(loaded.error().message, HasSubstr("holds itself")) << text;
  }
  // YAML aliases are resolved.
  std::ofstream(folder.path() / "camera.yaml")
      << "cam0: {camera_model: pinhole, intrinsics: &i [500.0, 500.0, 320.0, 240.0], again: *i,\n"
         "  distortion_model: radtan, distortion_coeffs: [0.1, 0.0, 0.0, 0.0],\n"
         "  resolution: [640, 480]}\n";
  const auto loaded = load_camera(folder.path() / "camera.yaml");
  EXPECT_TRUE(loaded) << loaded.error().message;
}

TEST(CameraFormats, ReadMrcalModels) {
  const auto camera = read(
      "{\n    'lensmodel':  'LENSMODEL_OPENCV5',\n\n    # extrinsics are rt_fromref\n"
      "    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n\n    # focal lengths, centre\n"
      "    'intrinsics': [ 531.7, 530.0, 322.3, 237.6, -0.2, 0.06, 0.0008, -0.0006, 0.01,],\n\n"
      "    'valid_intrinsics_region': [\n    [ 1, 2 ],\n    ],\n\n    'imagersize': [ 640, 480,],\n"
      "    'icam_intrinsics': 0,\n    'optimization_inputs': b'P;*Ek0TQG'\n}\n");
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_EQ(camera->parameters().fx, 531.7);
  EXPECT_EQ(camera->parameters().distortion[4], 0.01);
  const auto splined = read(
      "{ 'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=18_fov_x_deg=150', "
      "'intrinsics': [1], 'imagersize': [640, 480] }");
  ASSERT_FALSE(splined);
  EXPECT_THAT(splined.error().message, HasSubstr("LENSMODEL_OPENCV8"));
}

TEST(CameraFormats, ReadOpenCvFiles) {
  const auto camera = read(
      "%YAML:1.0\n---\ncalibration_time: \"Tue\"\nimage_width: 640\nimage_height: 480\n"
      "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
      "   data: [ 5.3e+02, 0., 3.2e+02, 0., 5.31e+02,\n       2.4e+02, 0., 0., 1. ]\n"
      "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n"
      "   data: [ -2.0e-01, 6.0e-02, 0., 0., 0. ]\n");
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_EQ(camera->parameters().fx, 530.0);
  EXPECT_EQ(camera->parameters().fy, 531.0);
  const auto tilted = read(
      "%YAML:1.0\nimage_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   data: "
      "[500, 0, 320, 0, 500, 240, 0, 0, 1]\ndistortion_coefficients: !!opencv-matrix\n   data: "
      "[0,0,0,0,0,0,0,0,0,0,0,0,0.1,0]\n");
  ASSERT_FALSE(tilted);
  EXPECT_THAT(tilted.error().message, HasSubstr("tilt"));
}

TEST(CameraFormats, ReadKalibrChains) {
  const auto camera = read(
      "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [-0.2, 0.06, "
      "0.0008, -0.0006]\n  distortion_model: radtan\n  intrinsics: [531.7, 530.0, 322.3, 237.6]\n"
      "  resolution: [640, 480]\n  rostopic: /cam0/image_raw\n");
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_EQ(camera->parameters().fy, 530.0);
  const auto omni = read("cam0:\n  camera_model: omni\n  intrinsics: [1, 2, 3, 4, 5]\n");
  ASSERT_FALSE(omni);
  EXPECT_THAT(omni.error().message, HasSubstr("pinhole-radtan"));
}

}  // namespace
}  // namespace penumbra
