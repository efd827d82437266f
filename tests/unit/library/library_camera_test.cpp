#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <limits>
#include <penumbra/penumbra.hpp>
#include <tuple>

#include "recorded_frames.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

TEST(LibraryVersion, IsThatOfTheHeaders) {
  EXPECT_EQ(library_version(), std::to_string(PENUMBRA_VERSION_MAJOR) + "." +
                                   std::to_string(PENUMBRA_VERSION_MINOR) + "." +
                                   std::to_string(PENUMBRA_VERSION_PATCH));
}

TEST(LibraryCamera, UnprojectsWhatItProjects) {
  const types::CameraModel camera = camera_of("tabletop");
  for (const types::Vector3& p : {types::Vector3{0.0, 0.0, 1.0}, types::Vector3{0.2, -0.1, 0.7},
                                  types::Vector3{-0.3, 0.2, 1.5}}) {
    const auto pixel = camera.project(p);
    ASSERT_TRUE(pixel);
    const auto ray = camera.unproject(*pixel);
    ASSERT_TRUE(ray);
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR((*ray)[i], p[i] / p[2], 1e-9);
  }
  EXPECT_FALSE(camera.project({0.0, 0.0, -1.0}));
  EXPECT_FALSE(camera.project({0.0, 0.0, 0.0}));
  EXPECT_FALSE(camera.project({std::numeric_limits<double>::quiet_NaN(), 0.0, 1.0}));
  EXPECT_FALSE(camera.unproject({std::numeric_limits<double>::infinity(), 0.0}));
}

TEST(LibraryCamera, RoundTripsThroughItsFile) {
  const TemporaryFolder folder;
  const types::CameraModel camera = camera_of("tabletop");
  for (const auto format : {types::CameraFileFormat::ros, types::CameraFileFormat::opencv}) {
    const std::filesystem::path file = folder.path() / "camera.yaml";
    camera.save(file, format);
    const types::CameraParameters p = types::CameraModel::load(file).parameters();
    EXPECT_EQ(p.fx, camera.parameters().fx);
    EXPECT_EQ(p.cy, camera.parameters().cy);
    EXPECT_EQ(p.distortion, camera.parameters().distortion);
  }
  EXPECT_THAT(
      message_of([&] { std::ignore = types::CameraModel::load(folder.path() / "none.yaml"); }),
      HasSubstr("none.yaml"));
  EXPECT_THAT(message_of([&] { camera.save(folder.path() / "no" / "folder.yaml"); }),
              HasSubstr("folder.yaml"));
}

TEST(LibraryImage, ReportsMissingAndDamagedFiles) {
  const TemporaryFolder folder;
  EXPECT_THAT(message_of([&] { std::ignore = types::Image::load(folder.path() / "none.png"); }),
              HasSubstr("none.png"));
  std::ofstream(folder.path() / "text.png") << "text";
  EXPECT_THAT(message_of([&] { std::ignore = types::Image::load(folder.path() / "text.png"); }),
              HasSubstr("text.png"));
}

RC_GTEST_PROP(LibraryCamera, AcceptsOrRejectsAnyParameters, ()) {
  const auto number = rc::gen::oneOf(rc::gen::arbitrary<double>(),
                                     rc::gen::just(std::numeric_limits<double>::quiet_NaN()),
                                     rc::gen::just(std::numeric_limits<double>::infinity()),
                                     rc::gen::just(0.0), rc::gen::just(500.0));
  types::CameraParameters p;
  p.width = *rc::gen::inRange(-10, 40'000);
  p.height = *rc::gen::inRange(-10, 40'000);
  p.fx = *number;
  p.fy = *number;
  p.cx = *number;
  p.cy = *number;
  p.model = static_cast<types::DistortionModel>(*rc::gen::inRange(-1, 4));
  p.distortion[0] = *number;
  try {
    const types::CameraModel camera(p);
    RC_ASSERT(camera.parameters().width == p.width);
    const auto pixel = camera.project({*number, *number, *number});
    RC_ASSERT(!pixel || !std::isnan((*pixel)[0]));
  } catch (const Exception& error) {
    RC_ASSERT(std::string(error.what()).starts_with("camera: ") ||
              std::string(error.what()).starts_with("model: "));
  }
}

}  // namespace
}  // namespace penumbra::test
