// Camera files of other tools.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "core/camera_file.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

CameraModel camera_of(DistortionModel model) {
  CameraParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = 531.7;
  p.fy = 530.0;
  p.cx = 322.3;
  p.cy = 237.6;
  p.model = model;
  p.distortion = {-0.2, 0.06, 0.0008, -0.0006};
  if (model == DistortionModel::rational) p.distortion[7] = 0.01;
  return CameraModel::make(p).value();
}

Result<CameraModel> read(const std::string& text) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "camera") << text;
  return load_camera(folder.path() / "camera");
}

TEST(CameraFormats, EachIsReadBackAsItWasWritten) {
  const test::TemporaryFolder folder;
  for (const auto format :
       {CameraFileFormat::ros, CameraFileFormat::opencv, CameraFileFormat::kalibr}) {
    for (const auto model :
         {DistortionModel::plumb_bob, DistortionModel::rational, DistortionModel::fisheye}) {
      const CameraModel camera = camera_of(model);
      CalibrationRecord record;
      record.calibrated_on = "2026-03-01";
      record.target = "tags: \"30 mm\"";
      record.standard_deviations = {0.1, 0.1};
      record.held_out_px = 0.2;
      const auto saved = save_camera(folder.path() / "camera", camera, format, &record);
      if (format == CameraFileFormat::kalibr && model == DistortionModel::rational) {
        ASSERT_FALSE(saved);
        EXPECT_THAT(saved.error().message, HasSubstr("no rational lens"));
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

TEST(CameraFormats, ReadsMrcalsModels) {
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

TEST(CameraFormats, ReadsWhatOpenCvWrites) {
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

TEST(CameraFormats, ReadsKalibrsChains) {
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
