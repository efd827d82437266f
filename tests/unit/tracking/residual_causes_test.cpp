// Residuals of tag corners in which only one cause is present, or none.
#include "tracking/evaluation/residual_causes.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "core/units.hpp"
#include "support/synthetic_board.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

// Errors that the simulated sheet and camera have relative to the given map and camera.
struct Errors {
  double paper_m = 0.0;  // 1 sigma of the tags' heights; their tilts move corners by half of it
  double focal_fraction = 0.0;
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();
  double k1 = 0.0;
  double row_time_s = 0.0;
  double noise_px = 0.05;
};

struct Sweep {
  CameraModel camera;  // as given
  std::vector<MappedTag> tags;
  std::vector<FrameCorners> frames;
};

CameraModel true_camera(const CameraModel& given, const Errors& errors) {
  CameraParameters p = given.parameters();
  p.fx *= 1.0 + errors.focal_fraction;
  p.fy *= 1.0 + errors.focal_fraction;
  p.cx += errors.centre_px.x();
  p.cy += errors.centre_px.y();
  p.distortion[0] += errors.k1;
  return CameraModel::make(p).value();
}

// A sheet seen from all sides by a moving camera. The poses are those that a tracker finds: fitted
// to the corners with the given map and camera.
class SweepMaker {
 public:
  SweepMaker(const Errors& errors, std::uint64_t seed) : errors_(errors), random_(seed) {}

  Sweep make(int frames = 60) {
    Sweep sweep{test::wide_camera(), test::board(4, 3, 0.04), {}};
    const CameraModel lens = true_camera(sweep.camera, errors_);
    std::vector<MappedTag> paper = sweep.tags;
    for (MappedTag& tag : paper) {
      const Eigen::Vector3d tilt(normal(), normal(), 0.0);
      tag.T_table_tag = {
          exp_quaternion(errors_.paper_m / tag.size_m * tilt),
          tag.T_table_tag.translation() + Eigen::Vector3d(0.0, 0.0, errors_.paper_m * normal())};
    }
    for (int i = 0; i < frames; ++i) sweep.frames.push_back(frame(sweep, lens, paper));
    return sweep;
  }

 private:
  double normal() { return normal_(random_); }

  FrameCorners frame(const Sweep& given, const CameraModel& lens,
                     const std::vector<MappedTag>& paper) {
    const MapFromCamera pose = as_map_pose(test::looking_at(
        {0.03 * normal(), 0.03 * normal(), 0.0}, 0.45 + 0.03 * normal(),
        radians(60.0 + 10.0 * normal()), radians(40.0 * normal()), radians(10.0 * normal())));
    FrameCorners frame;
    for (int k = 0; k < 3; ++k) {
      frame.velocity[k] = 0.3 * normal();
      frame.velocity[k + 3] = 0.6 * normal();
    }
    std::vector<PointObservation> points;
    for (std::size_t k = 0; k < paper.size(); ++k) {
      TagCorners tag{k, {}, errors_.noise_px};
      for (std::size_t i = 0; i < 4; ++i) {
        tag.corners_px[i] = seen(lens, pose, frame.velocity, paper[k].corners()[i]);
        tag.corners_px[i] += errors_.noise_px * Eigen::Vector2d(normal(), normal());
        points.push_back({given.tags[k].corners()[i], tag.corners_px[i]});
      }
      frame.tags.push_back(tag);
    }
    frame.T_map_camera = refine_pose(given.camera, points, pose).value().T_map_camera;
    return frame;
  }

  // Pixel of a point, at the pose when its row was exposed.
  [[nodiscard]] Eigen::Vector2d seen(const CameraModel& lens, const MapFromCamera& pose,
                                     const Vector6d& velocity, const Eigen::Vector3d& p) const {
    Eigen::Vector2d pixel = lens.project(pose.inverse() * p).value();
    for (int round = 0; round < 3; ++round) {
      const double time_s = (pixel.y() - 0.5 * (lens.height() - 1)) * errors_.row_time_s;
      pixel = lens.project(perturbed(pose, time_s * velocity).inverse() * p).value();
    }
    return pixel;
  }

  Errors errors_;
  std::mt19937_64 random_;
  std::normal_distribution<double> normal_;
};

ResidualCauses causes_of(const Sweep& sweep) {
  return find_residual_causes(sweep.camera, sweep.tags, sweep.frames);
}

std::vector<std::string> significant(const ResidualCauses& causes) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < kErrorCauses; ++i) {
    if (causes.evidence[i].significant || causes.evidence[i].possible)
      names.emplace_back(to_string(static_cast<ErrorCause>(i)));
  }
  return names;
}

constexpr int kSeeds = 12;

TEST(ResidualCauses, FindNothingInNoise) {
  for (int seed = 0; seed < kSeeds; ++seed) {
    Errors errors;
    errors.noise_px = 0.02 * std::pow(1.4, seed);  // up to 0.8 px
    const ResidualCauses causes = causes_of(SweepMaker(errors, seed).make());
    EXPECT_THAT(significant(causes), IsEmpty()) << "seed " << seed;
    EXPECT_LT(causes.explained, 0.03) << "seed " << seed;
    EXPECT_EQ(causes.frames, 60);
    EXPECT_NEAR(causes.rms_px, std::sqrt(2.0) * errors.noise_px, 0.1 * errors.noise_px);
    EXPECT_EQ(causes.outliers, 0);
  }
}

TEST(ResidualCauses, RecognisePaper) {
  for (int seed = 0; seed < kSeeds; ++seed) {
    Errors errors;
    errors.paper_m = 2e-4 * std::pow(1.35, seed);  // up to 5 mm
    const ResidualCauses causes = causes_of(SweepMaker(errors, seed).make());
    EXPECT_THAT(significant(causes), ElementsAre("paper")) << "seed " << seed;
    EXPECT_GT(causes.of(ErrorCause::paper).unique, 0.3) << "seed " << seed;
    // Heights and tilts add up to sqrt(1 + 1/2) sigma; the poses absorb a part of them.
    EXPECT_NEAR(causes.sizes.off_flat_m, 1.1 * errors.paper_m, 0.45 * errors.paper_m)
        << "seed " << seed;
    EXPECT_LT(causes.noise_px, 0.1 + 0.2 * causes.rms_px) << "seed " << seed;
  }
}

TEST(ResidualCauses, RecogniseWrongLens) {
  for (int seed = 0; seed < kSeeds; ++seed) {
    Errors errors;
    errors.focal_fraction = 0.002 * (1 + seed);
    errors.centre_px = {2.4, -1.8};
    errors.k1 = 0.02;
    const ResidualCauses causes = causes_of(SweepMaker(errors, seed).make());
    EXPECT_THAT(significant(causes), ElementsAre("lens")) << "seed " << seed;
    EXPECT_NEAR(causes.sizes.focal_fraction, errors.focal_fraction,
                0.1 * errors.focal_fraction + 5e-4)
        << "seed " << seed;
    EXPECT_LT((causes.sizes.centre_px - errors.centre_px).norm(), 0.7) << "seed " << seed;
    EXPECT_GT(causes.sizes.radial_px, 0.0) << "seed " << seed;
  }
}

TEST(ResidualCauses, RecogniseRollingShutter) {
  for (int seed = 0; seed < kSeeds; ++seed) {
    Errors errors;
    errors.row_time_s = (seed % 2 == 0 ? 1.0 : -1.0) * (10e-6 + 3e-6 * seed);
    const ResidualCauses causes = causes_of(SweepMaker(errors, seed).make());
    EXPECT_THAT(significant(causes), ElementsAre("shutter")) << "seed " << seed;
    EXPECT_NEAR(causes.sizes.row_time_s, errors.row_time_s, 0.06 * std::abs(errors.row_time_s))
        << "seed " << seed;
  }
}

TEST(ResidualCauses, SeparateAllThree) {
  Errors errors;
  errors.paper_m = 1e-3;
  errors.focal_fraction = 0.006;
  errors.k1 = 0.02;
  errors.row_time_s = 30e-6;
  const ResidualCauses causes = causes_of(SweepMaker(errors, 1).make());
  EXPECT_THAT(significant(causes), ElementsAre("paper", "lens", "shutter"));
  EXPECT_NEAR(causes.sizes.row_time_s, errors.row_time_s, 3e-6);
  EXPECT_NEAR(causes.sizes.focal_fraction, errors.focal_fraction, 3e-3);
}

TEST(ResidualCauses, UseGivenRowTime) {
  Errors errors;
  errors.row_time_s = 30e-6;
  Sweep sweep = SweepMaker(errors, 2).make();
  CameraParameters p = sweep.camera.parameters();
  p.rolling_shutter_row_s = errors.row_time_s;
  sweep.camera = CameraModel::make(p).value();
  const ResidualCauses causes = causes_of(sweep);
  EXPECT_THAT(significant(causes), IsEmpty());
  EXPECT_NEAR(causes.sizes.row_time_s, 0.0, 1e-6);
}

TEST(ResidualCauses, RejectCoveredTags) {
  Errors errors;
  Sweep sweep = SweepMaker(errors, 3).make();
  for (std::size_t i = 0; i < sweep.frames.size(); i += 4) {
    for (Eigen::Vector2d& corner : sweep.frames[i].tags[i % 12].corners_px)
      corner += Eigen::Vector2d(3.0, -2.0);
  }
  const ResidualCauses causes = causes_of(sweep);
  EXPECT_EQ(causes.outliers, 15);
  EXPECT_THAT(significant(causes), IsEmpty());
}

TEST(ResidualCauses, RequireEightFramesAndThreeTags) {
  EXPECT_EQ(causes_of(SweepMaker({}, 4).make(kMinResidualFrames - 1)).frames, 0);
  Sweep sweep = SweepMaker({}, 4).make();
  for (FrameCorners& frame : sweep.frames) frame.tags.resize(2);
  EXPECT_EQ(causes_of(sweep).frames, 0);
  EXPECT_EQ(find_residual_causes(sweep.camera, sweep.tags, {}).frames, 0);
}

TEST(ResidualCauses, DoNotDependOnRotationOfTable) {
  // The same sweep in a table frame that is moved and rotated.
  Errors errors;
  errors.paper_m = 1e-3;
  const Sweep sweep = SweepMaker(errors, 5).make();
  Sweep moved = sweep;
  const Transform<frame::Table, frame::Table> T(exp_quaternion({0.3, -0.8, 1.1}),
                                                Eigen::Vector3d(0.4, -0.2, 0.7));
  for (MappedTag& tag : moved.tags) tag.T_table_tag = T * tag.T_table_tag;
  for (FrameCorners& frame : moved.frames)
    frame.T_map_camera = as_map_pose(T * as_table_pose(frame.T_map_camera));
  const ResidualCauses a = causes_of(sweep);
  const ResidualCauses b = causes_of(moved);
  EXPECT_NEAR(a.explained, b.explained, 1e-6);
  EXPECT_NEAR(a.sizes.off_flat_m, b.sizes.off_flat_m, 1e-7);
}

TEST(ResidualAdvice, NamesSizeAndRemedy) {
  CauseSizes sizes;
  sizes.off_flat_m = 1.78e-3;
  EXPECT_THAT(advice(ErrorCause::paper, sizes, 0.0), HasSubstr("displaced by about 2 mm"));
  sizes.off_flat_m = 12.3e-3;
  EXPECT_THAT(advice(ErrorCause::paper, sizes, 0.0), HasSubstr("displaced by about 12 mm"));
  sizes.focal_fraction = -0.006;
  sizes.focal_sigma = 0.001;
  EXPECT_THAT(advice(ErrorCause::lens, sizes, 0.0), HasSubstr("0.6 % smaller"));
  sizes.focal_sigma = 0.01;
  EXPECT_THAT(advice(ErrorCause::lens, sizes, 0.0), HasSubstr("the distortion or"));
  for (const ErrorCause cause : {ErrorCause::paper, ErrorCause::lens, ErrorCause::shutter}) {
    EXPECT_THAT(advice(cause, sizes, 30e-6),
                AllOf(HasSubstr("--refine-map"), HasSubstr("of replay or live"),
                      HasSubstr("penumbra map")));
  }
  sizes.row_time_s = 10e-6;
  EXPECT_THAT(advice(ErrorCause::shutter, sizes, 30e-6),
              AllOf(HasSubstr("seems to be 40.0 us"), HasSubstr("rolling_shutter_row_s: 4e-05")));
  // A camera that is mounted upside down; its row time can't be written into a camera file.
  sizes.row_time_s = -40e-6;
  EXPECT_THAT(advice(ErrorCause::shutter, sizes, 0.0),
              AllOf(HasSubstr("from the bottom up"), Not(HasSubstr("rolling_shutter_row_s"))));
}

}  // namespace
}  // namespace penumbra
