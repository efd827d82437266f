// Tracking at the limits of image quality: exact synthetic frames with one condition varied over
// its range. Results must be finite, no wrong pose may have the status tracked, and a pose must
// exist where one is expected. The nightly form covers the whole ranges.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "core/evaluation/evaluation.hpp"
#include "support/random_session.hpp"
#include "support/test_form.hpp"
#include "support/tracked_session.hpp"
#include "tracking/group_tracker.hpp"

namespace penumbra {
namespace {

using test::easy_session;
using test::ExceededPredictions;
using test::expect_consistent;
using test::Layout;
using test::Lens;
using test::nightly;
using test::RandomNumbers;
using test::Session;

std::vector<RejectedTag> only(const MappedTag& tag) {
  return {{tag.id, TagRejection::inconsistent}};
}

// Returns the distance at which a tag of the session is `side_px` wide in the image [m].
double distance_for(const Session& session, double side_px) {
  return session.camera.parameters().fx * session.tags.front().size_m / side_px;
}

struct StressCase {
  std::string name;
  std::function<void(Session&)> change;
  bool tracked = true;  // at most one frame may be untracked
};

std::vector<StressCase> stress_cases() {
  std::vector<StressCase> list;
  const bool whole = nightly();
  const auto add = [&](const std::string& what, const std::vector<double>& few,
                       const std::vector<double>& all,
                       const std::function<void(Session&, double)>& change,
                       const std::function<bool(double)>& tracked) {
    for (const double value : whole ? all : few) {
      list.push_back({fmt::format("{} {}", what, value),
                      [change, value](Session& s) { change(s, value); }, tracked(value)});
    }
  };
  const auto always = [](double) { return true; };
  add(
      "noise", {0, 12}, {0, 1, 2, 4, 8, 12}, [](Session& s, double v) { s.light.noise_grey = v; },
      always);
  // Cells are about 6 px wide. The exposure is at most the frame interval.
  add(
      "blur cells", {1, 3}, {0.25, 0.5, 1, 1.5, 2, 3},
      [](Session& s, double v) {
        s.exposure_s = s.frame_s;
        const double px =
            test::corner_distance_px(s.camera, s.tags, s.motion.at(0.0), s.motion.at(s.frame_s));
        const double times = 6.0 * v / std::max(px, 0.01);
        for (test::Oscillation* sway :
             {&s.motion.x, &s.motion.y, &s.motion.azimuth, &s.motion.roll})
          sway->amplitude *= std::min(times, 12.0);
      },
      [](double v) { return v <= 1.0; });
  add(
      "side px", {8, 400}, {8, 12, 16, 25, 50, 100, 200, 400},
      [](Session& s, double v) {
        RandomNumbers draw(3);
        s.tags = test::layout_of(Layout::one, draw);
        if (v > 200.0) s.camera = test::lens_camera(Lens::plumb_bob, 1280, 960, 0.85);
        s.motion.distance.middle = distance_for(s, v);
        // The overlay's cube of 0.2 m must stay in front of the camera.
        const double scale = std::max(1.0, 0.5 / s.motion.distance.middle);
        for (MappedTag& tag : s.tags) tag.size_m *= scale;
        s.motion.distance.middle *= scale;
        s.motion.elevation.middle = radians(50.0);
        s.motion.x.middle = s.tags.front().T_table_tag.translation().x();
        s.motion.y.middle = s.tags.front().T_table_tag.translation().y();
      },
      // At 12 px the second pose fits the first images as well as the true one.
      [](double v) { return v >= 16.0; });
  add(
      "tilt deg", {75, 85}, {0, 15, 30, 45, 60, 75, 80, 85},
      [](Session& s, double v) { s.motion.elevation.middle = radians(90.0 - v); },
      [](double v) { return v <= 75.0; });
  add(
      "distance times", {100}, {3, 10, 30, 100},
      [](Session& s, double v) {
        for (MappedTag& tag : s.tags) {
          tag.size_m *= v;
          tag.T_table_tag = {tag.T_table_tag.rotation(), v * tag.T_table_tag.translation()};
        }
        s.motion.distance.middle *= v;
        s.motion.distance.amplitude *= v;
      },
      always);
  add(
      "cover", {0.3, 0.8}, {0.1, 0.3, 0.5, 0.65, 0.8},
      [](Session& s, double v) { s.light.covered_fraction = v; }, [](double v) { return v < 0.6; });
  add(
      "brightness", {0.1, 4}, {0.1, 0.2, 0.5, 1, 2, 4},
      [](Session& s, double v) {
        s.light.gain = v;
        s.light.noise_grey = 1.0;
      },
      always);
  add(
      "gamma", {2.4}, {1, 1.4, 1.8, 2.2, 2.4}, [](Session& s, double v) { s.light.gamma = v; },
      always);
  add(
      "fisheye", {0.4}, {0.6, 0.5, 0.4, 0.35},
      [](Session& s, double v) {
        s.camera = test::lens_camera(Lens::fisheye, 480, 360, v);
        s.motion.distance.middle = 0.36;
      },
      [](double v) { return v > 0.39; });
  add(
      "line tilt deg", {30, 60}, {0, 15, 30, 45, 60, 70},
      [](Session& s, double v) {
        RandomNumbers draw(3);
        s.tags = test::layout_of(Layout::line, draw);
        s.motion.elevation.middle = radians(90.0 - v);
      },
      always);
  add(
      "tags", {1, 196}, {1, 4, 49, 196},
      [](Session& s, double v) {
        const int side = static_cast<int>(std::lround(std::sqrt(v)));
        s.tags = test::board(side, side, 0.30 / side);
        if (side == 1) s.tags.front().size_m = 0.1;
        s.motion.elevation.middle = radians(55.0);
        s.motion.distance.middle = 0.5;
      },
      always);
  return list;
}

TEST(TrackingStress, PredictsErrorInEveryCondition) {
  ExceededPredictions all;
  for (const StressCase& cell : stress_cases()) {
    SCOPED_TRACE(cell.name);
    Session session = easy_session();
    cell.change(session);
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    const int frames = nightly() ? 12 : 3;
    int tracked = 0;
    for (int f = 0; f < frames; ++f) {
      SCOPED_TRACE(f);
      // Detection can't read a covered tag, but a tracked tag may become covered, so the first
      // frame is not covered.
      Session seen = session;
      if (f == 0) seen.light.covered_fraction = 0.0;
      const PoseEstimate pose = tracker.track(seen.image(renderer, f)).pose;
      tracked += pose.status == TrackStatus::tracked ? 1 : 0;
      expect_consistent(session, pose, session.truth(f), nightly() ? &all : nullptr);
    }
    if (cell.tracked) {
      EXPECT_GE(tracked, frames - 1);
    }
  }
  EXPECT_LE(all.exceeded, 0.005 * all.tracked) << "of " << all.tracked;
}

TEST(TrackingStress, PredictsErrorOnRandomSessions) {
  const int sessions = nightly() ? 400 : 4;
  for (int s = 0; s < sessions; ++s) {
    SCOPED_TRACE(s);
    test::SessionKind kind;
    const Session session = test::random_session(5000U + static_cast<std::uint64_t>(s), kind);
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 3; ++f)
      expect_consistent(session, tracker.track(session.image(renderer, f)).pose, session.truth(f));
  }
}

// Statistics of tracked frames.
struct ErrorStatistics {
  int exceeded = 0;                    // error above four times the predicted one
  int wrong = 0;                       // error above 5 px
  std::vector<double> over_predicted;  // actual / predicted error

  [[nodiscard]] int tracked() const { return static_cast<int>(over_predicted.size()); }
  [[nodiscard]] double spread() const { return statistics_of(over_predicted).rmse; }
  [[nodiscard]] std::string summary() const {
    return fmt::format("{} tracked, {} beyond 4 sigma, {} wrong, {:.2f} of the predicted error RMS",
                       tracked(), exceeded, wrong, spread());
  }
};

// A shaking hand blurs the tags over several cells. One tracker gets the exposure time, one does
// not. The predicted error must match the actual error, even if many similar poses fit the image.
TEST(TrackingStress, PredictsErrorUnderStrongMotionBlur) {
  int frames = 0;
  int blurred = 0;           // blurred by more than three cells
  ErrorStatistics followed;  // frames of both trackers
  ErrorStatistics first;     // frames of a new tracker, without a previous frame
  const int sessions = nightly() ? 40 : 8;
  for (int k = 0; k < sessions; ++k) {
    RandomNumbers draw(900U + static_cast<std::uint64_t>(k));
    Session session = easy_session();
    session.light.seed = static_cast<std::uint64_t>(k) + 1;
    session.light.lens_blur_px = draw.between(0.4, 0.8);
    // Most sessions have 12 tags, some 7 or 48.
    const Layout layout = k % 8 == 7 ? Layout::many : k % 3 == 2 ? Layout::loose : Layout::sheet;
    session.tags = test::layout_of(layout, draw);
    session.motion =
        test::hand_motion(3, draw.between(0.38, 0.5), radians(draw.between(35.0, 75.0)), draw);
    const double times = draw.between(2.0, 6.0);
    for (test::Oscillation* sway : {&session.motion.x, &session.motion.y, &session.motion.azimuth})
      sway->amplitude *= times;
    session.exposure_s = draw.between(0.010, 0.025);
    const double cell_px = session.camera.parameters().fx * session.tags.front().size_m /
                           (8.0 * session.motion.distance.middle);
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    const TagMap map = TagMap::make(session.tags).value();
    auto with_exposure = GroupTracker::create(session.camera, map).value();
    auto without_exposure = GroupTracker::create(session.camera, map).value();
    for (int f = 0; f < (nightly() ? 20 : 6); ++f) {
      SCOPED_TRACE(testing::Message() << "session " << k << ", frame " << f);
      Frame frame = session.image(renderer, f);
      const double middle = f * session.frame_s;
      const double blur_px = test::corner_distance_px(
          session.camera, session.tags, session.motion.at(middle - 0.5 * session.exposure_s),
          session.motion.at(middle + 0.5 * session.exposure_s));
      blurred += blur_px > 3.0 * cell_px ? 1 : 0;
      ++frames;
      const auto track = [&](GroupTracker& tracker, ErrorStatistics& all) {
        const PoseEstimate pose = tracker.track(frame).pose;
        if (!pose.has_pose()) return;
        EXPECT_TRUE(pose.T_table_camera.is_finite());
        EXPECT_TRUE(pose.covariance.allFinite());
        if (pose.status != TrackStatus::tracked) return;
        const double error =
            overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px();
        all.over_predicted.push_back(error / pose.predicted_overlay_error_px);
        all.exceeded += error > std::max(1.0, 4.0 * pose.predicted_overlay_error_px) ? 1 : 0;
        all.wrong += error > 5.0 ? 1 : 0;
      };
      track(without_exposure, followed);
      auto fresh = GroupTracker::create(session.camera, map).value();
      track(fresh, first);
      frame.exposure_s = session.exposure_s;
      track(with_exposure, followed);
    }
  }
  RecordProperty("blurred", fmt::format("{} of {} frames", blurred, frames));
  RecordProperty("followed", followed.summary());
  RecordProperty("first", first.summary());
  EXPECT_GT(6 * blurred, frames) << "of " << frames;
  EXPECT_GT(followed.tracked(), (nightly() ? 1.1 : 0.9) * frames)
      << "tracked frames of both trackers";
  EXPECT_LT(followed.spread(), 1.0);
  EXPECT_GT(followed.spread(), 0.5);
  EXPECT_LE(followed.exceeded, 0.01 * followed.tracked()) << "of " << followed.tracked();
  const int tracked = followed.tracked() + first.tracked();
  EXPECT_LE(followed.wrong + first.wrong, 0.001 * tracked) << "of " << tracked;
  EXPECT_GT(4 * first.tracked(), frames);
  EXPECT_LT(first.spread(), 1.2);
  EXPECT_GT(first.spread(), 0.5);
  EXPECT_LE(first.exceeded, 0.01 * first.tracked()) << "of " << first.tracked();
}

// The camera moves to and fro over the same images, so that any drift would accumulate.
TEST(TrackingStress, TracksTenThousandFramesWithoutDrift) {
  Session session = easy_session();
  session.camera = test::lens_camera(Lens::plumb_bob, 320, 240, 0.85);
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  constexpr int kViews = 8;
  std::vector<Frame> views;
  for (int f = 0; f < kViews; ++f) views.push_back(session.image(renderer, f));
  TrackerOptions options;
  options.mode = nightly() ? TrackingMode::automatic : TrackingMode::fast;
  auto tracker =
      GroupTracker::create(session.camera, TagMap::make(session.tags).value(), options).value();
  double first = 0.0;
  double last = 0.0;
  int tracked = 0;
  constexpr int kFrames = 10'000;
  constexpr int kPeriod = 2 * (kViews - 1);
  for (int i = 0; i < kFrames; ++i) {
    const int phase = i % kPeriod;
    const int view = phase < kViews ? phase : kPeriod - phase;
    Frame frame = views[static_cast<std::size_t>(view)];
    frame.timestamp_ns = 1'000'000'000 + i * std::int64_t{33'333'333};
    const PoseEstimate pose = tracker.track(frame).pose;
    ASSERT_TRUE(pose.has_pose()) << "frame " << i << ": " << text_of(pose.reason);
    tracked += pose.status == TrackStatus::tracked ? 1 : 0;
    const double error =
        overlay_difference(session.camera, pose.T_table_camera, session.truth(view)).rms_px();
    ASSERT_LT(error, 0.5) << "frame " << i;
    if (i < 2 * kPeriod) first = std::max(first, error);
    if (i >= kFrames - 2 * kPeriod) last = std::max(last, error);
  }
  EXPECT_EQ(tracked, kFrames);
  EXPECT_LT(last, first + 0.02);
}

// A second print of a mapped tag lies on the table.
TEST(TrackingStress, IgnoresCopyOfMappedTag) {
  const Session session = easy_session();
  std::vector<MappedTag> drawn = session.tags;
  MappedTag copy = drawn[5];
  copy.T_table_tag = {copy.T_table_tag.rotation(), Eigen::Vector3d(0.14, 0.0, 0.0)};
  drawn.push_back(copy);
  auto renderer = PatternRenderer::create(session.camera, drawn).value();
  auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
  for (int f = 0; f < 4; ++f) {
    const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
    EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
    expect_consistent(session, pose, session.truth(f));
  }
}

Session moved(Session session, std::size_t tag, const Eigen::Vector3d& by) {
  session.tags[tag].T_table_tag = {session.tags[tag].T_table_tag.rotation(),
                                   session.tags[tag].T_table_tag.translation() + by};
  return session;
}

// Tags of two families may share ids. Only the moved tag may be rejected; the tag with the same id
// in the other family must still be used.
TEST(TrackingStress, KeepsTagThatSharesIdWithMovedTagOfOtherFamily) {
  Session session = easy_session();
  const auto half = session.tags.size() / 2;
  for (std::size_t k = 0; k < half; ++k) {
    session.tags[half + k].family = TagFamily::tag36h10;
    session.tags[half + k].id = session.tags[k].id;
  }
  for (const std::size_t culprit : {std::size_t{2}, half + 2}) {
    SCOPED_TRACE(culprit);
    const std::vector<MappedTag> drawn = moved(session, culprit, {0.006, 0.0, 0.0}).tags;
    auto renderer = PatternRenderer::create(session.camera, drawn).value();
    for (const TrackingMode mode : {TrackingMode::automatic, TrackingMode::detect}) {
      TrackerOptions options;
      options.mode = mode;
      auto tracker =
          GroupTracker::create(session.camera, TagMap::make(session.tags).value(), options).value();
      for (int f = 0; f < 4; ++f) {
        const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
        EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
        expect_consistent(session, pose, session.truth(f));
        EXPECT_EQ(pose.tags_rejected, only(session.tags[2]));
        EXPECT_EQ(pose.tags_used, 11);
        EXPECT_LT(
            overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px(),
            mode == TrackingMode::detect ? 2.0 : 0.6);
      }
    }
  }
}

// A tag is displaced from its mapped position, by less than a cell up to more than the tag's size.
TEST(TrackingStress, RejectsMovedTag) {
  for (const double moved_m : {0.002, 0.004, 0.012, 0.1}) {
    SCOPED_TRACE(moved_m);
    const Session session = easy_session();
    const std::vector<MappedTag> drawn = moved(session, 3, {moved_m, 0.0, 0.0}).tags;
    auto renderer = PatternRenderer::create(session.camera, drawn).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 4; ++f) {
      const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
      EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
      expect_consistent(session, pose, session.truth(f));
      EXPECT_LT(overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px(),
                0.6);
      // A tag displaced by a quarter of a cell only loses weight, and a tag beyond the aligner's
      // search range is not read. Their rejection is optional, but no other tag may be rejected.
      for (const RejectedTag& tag : pose.tags_rejected) EXPECT_EQ(tag.id, session.tags[3].id);
      if (moved_m == 0.004) {
        EXPECT_EQ(pose.tags_rejected, only(session.tags[3]));
      }
    }
  }
}

// With few tags in a grazing view, a pose that compromises between all of them is wrong by many
// pixels. For each moved tag and direction, no frame may be tracked with such a pose, and only the
// moved tag may be rejected.
TEST(TrackingStress, NeverTracksWrongPoseWhenOneOfFewTagsMoved) {
  struct Board {
    const char* name;
    std::vector<MappedTag> tags;
    double elevation_deg, distance_m;
  };
  std::vector<MappedTag> five = test::board(3, 2, 0.11);
  five.erase(five.begin() + 1);
  const std::vector<MappedTag> four = test::board(2, 2, 0.1);
  const std::vector<Board> boards = {{"five, grazing", five, 24.0, 0.6},
                                     {"four", four, 45.0, 0.5},
                                     {"three", {four.begin(), four.begin() + 3}, 45.0, 0.5},
                                     {"two", test::board(2, 1, 0.1), 50.0, 0.45}};
  const std::vector<double> few = {0.0, 0.004, 0.008};
  const std::vector<double> all = {0.0, -0.005, 0.003, 0.005, 0.01};
  int named = 0;
  int reported = 0;
  int cases_of_fewer = 0;
  int cases = 0;
  for (const Board& board : boards) {
    Session session = easy_session();
    session.tags = board.tags;
    session.motion.elevation.middle = radians(board.elevation_deg);
    session.motion.distance.middle = board.distance_m;
    for (std::size_t tag = 0; tag < board.tags.size(); tag += nightly() ? 1 : 2) {
      for (const bool sideways : {false, true}) {
        for (const double by : nightly() ? all : few) {
          if (by == 0.0 && (sideways || tag > 0)) continue;  // the same images as before
          SCOPED_TRACE(fmt::format("{}: tag {} by {} m {}", board.name, board.tags[tag].id, by,
                                   sideways ? "sideways" : "away"));
          const Session drawn = moved(session, tag, {sideways ? by : 0.0, sideways ? 0.0 : by, 0});
          auto renderer = PatternRenderer::create(session.camera, drawn.tags).value();
          auto tracker =
              GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
          bool right = false;
          for (int f = 0; f < (nightly() ? 4 : 3); ++f) {
            const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
            expect_consistent(session, pose, session.truth(f));
            right = pose.tags_rejected == only(board.tags[tag]);
            if (by == 0.0) {
              EXPECT_EQ(pose.status, TrackStatus::tracked) << text_of(pose.reason);
            }
            // With two or three tags, it is ambiguous which tag moved. Many frames must report
            // that. A moved tag outside the search range is not read.
            if (board.tags.size() > 3 || std::abs(by) < 0.004) continue;
            ++cases_of_fewer;
            reported += pose.reason.cause == PoseCause::uncertain_map ? 1 : 0;
          }
          if (std::abs(by) < 0.005 || board.tags.size() < 4) continue;  // no rejection is required
          ++cases;
          named += right ? 1 : 0;
        }
      }
    }
  }
  EXPECT_GE(named, 0.75 * cases) << "of " << cases;
  EXPECT_GE(reported, 0.4 * cases_of_fewer) << "of " << cases_of_fewer;
}

// Half of the board is moved as one piece, so it is ambiguous which half is right.
TEST(TrackingStress, NeverTracksWrongPoseWhenHalfOfBoardMoved) {
  for (const double by : {0.003, 0.006}) {
    SCOPED_TRACE(by);
    const Session session = easy_session();
    Session drawn = session;
    for (std::size_t tag = 0; tag < session.tags.size(); tag += 2)
      drawn = moved(drawn, tag, {by, 0.0, 0.0});
    auto renderer = PatternRenderer::create(session.camera, drawn.tags).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 6; ++f) {
      const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
      expect_consistent(session, pose, session.truth(f));
      if (by > 0.004) {
        EXPECT_NE(pose.status, TrackStatus::tracked);
      }
    }
  }
}

// After inconsistent frames, some of the tags must suffice for tracking while the others stay
// hidden.
TEST(TrackingStress, RecoversAfterInconsistentFrames) {
  const Session session = easy_session();
  Session wrong = session;
  for (std::size_t tag = 0; tag < session.tags.size(); tag += 2)
    wrong = moved(wrong, tag, {0.006, 0.0, 0.0});
  std::vector<MappedTag> part;
  for (std::size_t tag = 0; tag < session.tags.size(); ++tag) {
    if (tag % 2 == 0 || tag == 1) part.push_back(session.tags[tag]);
  }
  ASSERT_LT(3 * part.size(), 2 * session.tags.size()) << "too few tags for an immediate recovery";
  auto contradicting = PatternRenderer::create(session.camera, wrong.tags).value();
  auto right = PatternRenderer::create(session.camera, part).value();
  auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
  for (int f = 0; f < 4; ++f) {
    ASSERT_NE(tracker.track(session.image(contradicting, f)).pose.status, TrackStatus::tracked);
  }
  for (int f = 4; f < 16; ++f) {
    const PoseEstimate pose = tracker.track(session.image(right, f)).pose;
    expect_consistent(session, pose, session.truth(f));
    if (f >= 10) {
      EXPECT_EQ(pose.status, TrackStatus::tracked) << f << ": " << text_of(pose.reason);
    }
  }
}

// A rejected tag must be used again after it is put back, and not before.
TEST(TrackingStress, UsesMovedTagAgainAfterItIsPutBack) {
  Session session = easy_session();
  session.motion.x.amplitude = session.motion.y.amplitude = 0.0;
  const Session elsewhere = moved(session, 3, {0.004, 0.0, 0.0});
  auto wrong = PatternRenderer::create(session.camera, elsewhere.tags).value();
  auto right = PatternRenderer::create(session.camera, session.tags).value();
  const Frame moved_image = session.image(wrong, 0);
  const Frame image = session.image(right, 0);
  auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
  for (int f = 0; f < 260; ++f) {
    Frame frame = f < 130 ? moved_image : image;
    frame.timestamp_ns = 1'000'000'000 + f * std::int64_t{33'333'333};
    const PoseEstimate pose = tracker.track(frame).pose;
    ASSERT_EQ(pose.status, TrackStatus::tracked) << f << ": " << text_of(pose.reason);
    EXPECT_LT(overlay_difference(session.camera, pose.T_table_camera, session.truth(0)).rms_px(),
              0.3);
    if (f < 130) {
      ASSERT_EQ(pose.tags_rejected, only(session.tags[3])) << f;
    }
    if (f >= 200) {
      ASSERT_TRUE(pose.tags_rejected.empty()) << f;
    }
  }
}

// After a jerk, the tracker searches for the pattern in a larger range, then for tags near their
// previous positions, then in the whole frame. It stops at the first success.
TEST(TrackingStress, FindsTableAfterJumpAwayFromPrediction) {
  int found_by_pattern = 0;
  int found_in_box = 0;
  // The pattern search is translational, so it can't find the table after the rotation.
  for (const auto& [jump_m, turn_deg] :
       {std::pair(0.05, 0.0), std::pair(0.09, 0.0), std::pair(0.13, 0.0), std::pair(0.0, 40.0)}) {
    SCOPED_TRACE(testing::Message() << jump_m << " m, " << turn_deg << " degrees");
    Session session = easy_session();
    session.motion.distance.middle = 0.6;
    Session later = session;
    later.motion.x.middle += jump_m;
    later.motion.roll.middle += radians(turn_deg);
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 3; ++f) {
      ASSERT_EQ(tracker.track(session.image(renderer, f)).pose.status, TrackStatus::tracked);
    }
    const TrackedFrame jumped = tracker.track(later.image(renderer, 3));
    EXPECT_EQ(jumped.pose.status, TrackStatus::tracked) << text_of(jumped.pose.reason);
    expect_consistent(session, jumped.pose, later.truth(3));
    const bool by_pattern = jumped.times.pyramid_search;
    const bool in_box = jumped.times.roi_detection;
    EXPECT_FALSE(by_pattern && in_box);
    EXPECT_EQ(jumped.times.full_detection, !by_pattern && !in_box);
    if (by_pattern) {
      EXPECT_EQ(jumped.times.detect_ms, 0.0) << "the recovery must need no detection";
    }
    found_by_pattern += by_pattern ? 1 : 0;
    found_in_box += in_box ? 1 : 0;
    EXPECT_EQ(tracker.track(later.image(renderer, 4)).pose.status, TrackStatus::tracked);
  }
  EXPECT_GE(found_by_pattern, 2);
  EXPECT_GE(found_in_box, 1);
}

// A part of every tag becomes covered during tracking. No frame may be lost.
TEST(TrackingStress, KeepsTagsThatBecomeCovered) {
  const std::vector<double> few = {0.3};
  const std::vector<double> all = {0.1, 0.2, 0.3};
  for (const double fraction : nightly() ? all : few) {
    SCOPED_TRACE(fraction);
    Session session = easy_session();
    auto renderer = PatternRenderer::create(session.camera, session.tags).value();
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < (nightly() ? 30 : 8); ++f) {
      session.light.covered_fraction = f < 2 ? 0.0 : fraction;
      const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
      EXPECT_EQ(pose.status, TrackStatus::tracked) << f << ": " << text_of(pose.reason);
      expect_consistent(session, pose, session.truth(f));
      EXPECT_LT(overlay_difference(session.camera, pose.T_table_camera, session.truth(f)).rms_px(),
                0.3);
    }
  }
}

// Like a blurred tag, a partly covered tag has cells that the pattern does not explain. The cover
// must not be mistaken for motion blur.
TEST(TrackingStress, KeepsCoveredTagsInFastMotion) {
  for (const double light : {0.3, 0.8}) {
    for (const double times : {6.0, 12.0}) {
      SCOPED_TRACE(testing::Message() << "cover of light " << light << ", motion x " << times);
      Session session = easy_session();
      for (test::Oscillation* sway :
           {&session.motion.x, &session.motion.y, &session.motion.azimuth})
        sway->amplitude *= times;
      session.light.cover = light;
      auto renderer = PatternRenderer::create(session.camera, session.tags).value();
      auto tracker =
          GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
      for (int f = 0; f < (nightly() ? 16 : 9); ++f) {
        session.light.covered_fraction = f < 4 ? 0.0 : 0.3;
        const PoseEstimate pose = tracker.track(session.image(renderer, f)).pose;
        EXPECT_EQ(pose.status, TrackStatus::tracked) << f << ": " << text_of(pose.reason);
        EXPECT_LT(pose.predicted_overlay_error_px, 0.8);
        expect_consistent(session, pose, session.truth(f));
      }
    }
  }
}

// A camera that jumped between two sharp frames did not move during them, for any length of the
// exposure.
TEST(TrackingStress, AssumesNoMotionBlurForJumpBetweenSharpFrames) {
  Session session = easy_session();
  for (test::Oscillation* sway :
       {&session.motion.x, &session.motion.y, &session.motion.distance, &session.motion.elevation,
        &session.motion.azimuth, &session.motion.roll})
    sway->amplitude = 0.0;
  auto renderer = PatternRenderer::create(session.camera, session.tags).value();
  for (const bool with_exposure : {false, true}) {
    SCOPED_TRACE(with_exposure);
    auto tracker = GroupTracker::create(session.camera, TagMap::make(session.tags).value()).value();
    for (int f = 0; f < 12; ++f) {
      Session there = session;
      there.motion.x.middle += f / 3 % 2 == 0 ? 0.0 : 0.03;
      Frame frame = there.image(renderer, f);
      if (with_exposure) frame.exposure_s = 0.02;
      const PoseEstimate pose = tracker.track(frame).pose;
      EXPECT_EQ(pose.status, TrackStatus::tracked) << f << ": " << text_of(pose.reason);
      expect_consistent(there, pose, there.truth(f));
    }
  }
}

}  // namespace
}  // namespace penumbra
