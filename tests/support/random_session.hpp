// Short synthetic sessions with exact truth and random lens, tags, hand motion and light. The
// ranges are not tuned to the tracker.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/evaluation/evaluation.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/frame.hpp"
#include "core/units.hpp"
#include "support/synthetic_board.hpp"
#include "tracking/alignment/pattern_renderer.hpp"

namespace penumbra::test {

// Random numbers, the same on every machine. operator() returns a uniform number in [0, 1).
class RandomNumbers {
 public:
  explicit RandomNumbers(std::uint64_t seed) : engine_(seed) {}
  double operator()() { return static_cast<double>(engine_() >> 11U) * 0x1.0p-53; }
  double between(double low, double high) { return low + (high - low) * (*this)(); }
  // Returns a log-uniform number between the bounds.
  double log_between(double low, double high) { return low * std::pow(high / low, (*this)()); }
  int below(int count) { return std::min(count - 1, static_cast<int>(count * (*this)())); }

 private:
  std::mt19937_64 engine_;
};

enum class Lens { none, plumb_bob, rational, fisheye };

// `focal`: focal length divided by the image's width.
inline CameraModel lens_camera(Lens lens, int width, int height, double focal) {
  CameraParameters p;
  p.width = width;
  p.height = height;
  p.fx = focal * width;
  p.fy = 0.997 * p.fx;
  p.cx = 0.503 * width;
  p.cy = 0.492 * height;
  switch (lens) {
    case Lens::none:
      break;
    case Lens::plumb_bob:
      p.distortion = {-0.21, 0.06, 0.0008, -0.0006, -0.004};
      break;
    case Lens::rational:
      p.model = DistortionModel::rational;
      p.distortion = {0.31, -0.05, 0.0006, -0.0004, 0.002, 0.62, -0.02, 0.004};
      break;
    case Lens::fisheye:
      p.model = DistortionModel::fisheye;
      p.distortion = {-0.04, 0.012, -0.006, 0.001};
      break;
  }
  return CameraModel::make(p).value();
}

// A value that oscillates about `middle`; `t`: time [s].
struct Oscillation {
  double middle = 0.0, amplitude = 0.0, hertz = 0.0, phase = 0.0;
  [[nodiscard]] double at(double t) const {
    return middle + amplitude * std::sin(2.0 * std::numbers::pi * hertz * t + phase);
  }
};

// A hand-held camera that looks at a point near the table's centre.
struct HandMotion {
  Oscillation x, y, distance, elevation, azimuth, roll;
  [[nodiscard]] CameraPose at(double t) const {
    return looking_at({x.at(t), y.at(t), 0.0}, distance.at(t),
                      std::clamp(elevation.at(t), 0.03, 1.55), azimuth.at(t), roll.at(t));
  }
};

struct Session {
  CameraModel camera;
  std::vector<MappedTag> tags;
  HandMotion motion;
  double frame_s = 1.0 / 30.0;
  double exposure_s = 0.0;
  PatternRenderOptions light;

  [[nodiscard]] CameraPose truth(int frame) const { return motion.at(frame * frame_s); }
  // Renders a frame. Its timestamp is the middle of the exposure; with a rolling shutter, that of
  // the middle row.
  [[nodiscard]] Frame image(PatternRenderer& renderer, int frame) const {
    const double middle = frame * frame_s;
    PatternRenderOptions options = light;
    options.seed = light.seed * 1000003U + static_cast<std::uint64_t>(frame);
    const double row_s = camera.parameters().rolling_shutter_row_s.value_or(0.0);
    const int height = camera.height();
    const int strip = row_s > 0.0 ? 4 : height;  // rows that are read out together
    GreyImage image;
    for (int row = 0; row < height; row += strip) {
      options.first_row = row;
      options.end_row = row + strip;
      const double read_out = row_s * (row + 0.5 * (strip - 1) - 0.5 * (height - 1));
      const GreyImage part =
          renderer.render(path_about(row_s > 0.0 ? middle + read_out : middle), options);
      if (row == 0) image = part;
      const auto begin = static_cast<std::size_t>(row) * static_cast<std::size_t>(image.width);
      const auto end = static_cast<std::size_t>(std::min(row + strip, height)) *
                       static_cast<std::size_t>(image.width);
      std::copy(part.pixels.begin() + static_cast<std::ptrdiff_t>(begin),
                part.pixels.begin() + static_cast<std::ptrdiff_t>(end),
                image.pixels.begin() + static_cast<std::ptrdiff_t>(begin));
    }
    FrameBuffer buffer = allocate_frame(PixelFormat::grey8, image.width, image.height);
    for (int y = 0; y < image.height; ++y) {
      std::copy_n(image.view().row(y), image.width,
                  buffer.plane_data[0] + y * buffer.frame.planes[0].stride);
    }
    buffer.frame.sequence = static_cast<std::uint64_t>(frame);
    buffer.frame.timestamp_ns = nanoseconds(1.0 + middle);
    return buffer.frame;
  }

 private:
  // Returns camera poses during the exposure, evenly spaced about the time `middle` [s].
  [[nodiscard]] std::vector<CameraPose> path_about(double middle) const {
    const CameraPose begin = motion.at(middle - 0.5 * exposure_s);
    const double moved_px =
        exposure_s > 0.0
            ? corner_distance_px(camera, tags, begin, motion.at(middle + 0.5 * exposure_s))
            : 0.0;
    const int steps = moved_px > 0.05 && moved_px < 1e8
                          ? std::clamp(static_cast<int>(4.0 * moved_px) + 2, 2, 64)
                          : 1;
    std::vector<CameraPose> path;
    for (int k = 0; k < steps; ++k)
      path.push_back(motion.at(middle + exposure_s * ((k + 0.5) / steps - 0.5)));
    return path;
  }
};

enum class Layout { one, two, line, sheet, loose, many };
inline constexpr std::array<const char*, 6> kLayoutNames = {"one",   "two",   "line",
                                                            "sheet", "loose", "many"};

inline std::vector<MappedTag> layout_of(Layout layout, RandomNumbers& draw) {
  std::vector<MappedTag> tags;
  const int first_id = draw.below(300);
  const auto add = [&](double x, double y, double size, double turn) {
    MappedTag tag;
    tag.id = first_id + static_cast<int>(tags.size());
    tag.size_m = size;
    tag.T_table_tag = {Eigen::Quaterniond(Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ())),
                       Eigen::Vector3d(x, y, 0.0)};
    tags.push_back(tag);
  };
  const auto grid = [&](int columns, int rows, double size) {
    for (int j = 0; j < rows; ++j) {
      for (int i = 0; i < columns; ++i)
        add(1.4 * size * (i - 0.5 * (columns - 1)), 1.4 * size * (0.5 * (rows - 1) - j), size, 0.0);
    }
  };
  switch (layout) {
    case Layout::one:
      add(draw.between(-0.03, 0.03), draw.between(-0.03, 0.03), 0.08, draw.between(0.0, 6.28));
      break;
    case Layout::two:
      add(-0.07, draw.between(-0.03, 0.03), 0.05, draw.between(0.0, 6.28));
      add(0.07, draw.between(-0.03, 0.03), 0.05, draw.between(0.0, 6.28));
      break;
    case Layout::line:
      grid(6, 1, 0.035);
      break;
    case Layout::sheet:
      grid(4, 3, 0.04);
      break;
    case Layout::loose:
      for (int k = 0; k < 7; ++k) {
        const double angle = 2.0 * std::numbers::pi * (k + draw.between(-0.2, 0.2)) / 7.0;
        const double radius = draw.between(0.09, 0.16);
        add(radius * std::cos(angle), radius * std::sin(angle), draw.between(0.03, 0.05),
            draw.between(0.0, 6.28));
      }
      break;
    case Layout::many:
      grid(8, 6, 0.025);
      break;
  }
  return tags;
}

// Returns the random motion of a hand-held camera. `haste`: 0 at rest, 1 slow, 2 fast, 3 shaking.
// `elevation` [rad].
inline HandMotion hand_motion(int haste, double distance_m, double elevation, RandomNumbers& draw) {
  constexpr std::array<double, 4> kTurn = {0.0002, 0.02, 0.06, 0.022};     // [rad]
  constexpr std::array<double, 4> kShift = {0.0002, 0.015, 0.035, 0.010};  // [m]
  constexpr std::array<double, 4> kHertz = {0.7, 0.6, 1.1, 4.0};
  const auto h = static_cast<std::size_t>(haste);
  const auto sway = [&](double middle, double amplitude) {
    return Oscillation{middle, amplitude * draw.between(0.4, 1.0),
                       kHertz[h] * draw.between(0.6, 1.4), draw.between(0.0, 6.28)};
  };
  return {sway(draw.between(-0.02, 0.02), kShift[h]), sway(draw.between(-0.02, 0.02), kShift[h]),
          sway(distance_m, 0.5 * kShift[h]),          sway(elevation, kTurn[h]),
          sway(draw.between(0.0, 6.28), kTurn[h]),    sway(draw.between(-0.6, 0.6), kTurn[h])};
}

// Properties of a random session, to group results by.
struct SessionKind {
  Lens lens = Lens::none;
  Layout layout = Layout::sheet;
  int haste = 0;
  bool tone_known = false;
};

inline Session random_session(std::uint64_t seed, SessionKind& kind) {
  RandomNumbers draw(seed * 7919U + 17U);
  Session session;
  kind.lens = static_cast<Lens>(draw.below(4));
  kind.layout = static_cast<Layout>(draw.below(6));
  kind.haste = draw.below(4);
  const double focal =
      kind.lens == Lens::fisheye ? draw.between(0.45, 0.6) : draw.between(0.75, 1.0);
  CameraParameters p = lens_camera(kind.lens, 640, 480, focal).parameters();
  session.light.gamma = draw() < 0.3 ? 1.0 : draw.between(1.0, 2.4);
  kind.tone_known = draw() < 0.4;
  if (kind.tone_known) p.tone_curve = session.light.gamma;
  session.camera = CameraModel::make(p).value();
  session.tags = layout_of(kind.layout, draw);
  const double reach_m = kind.layout == Layout::one ? 0.12 : 0.25;
  // The camera stays farther from the table than the overlay's cube extends.
  const double distance_m = std::max(0.34, focal * draw.log_between(1.2, 4.5) * reach_m);
  session.motion = hand_motion(kind.haste, distance_m, radians(draw.between(20.0, 88.0)), draw);
  session.exposure_s = draw() < 0.3 ? 0.0 : draw.between(0.002, 0.025);
  session.light.lens_blur_px = draw.between(0.3, 0.9);
  session.light.gain = draw.log_between(0.35, 1.2);
  session.light.black = draw.between(0.03, 0.10);
  session.light.white = draw.between(0.6, 0.95);
  session.light.background = draw.between(0.1, 0.6);
  session.light.noise_grey = draw() < 0.15 ? 0.0 : draw.between(0.5, 8.0);
  session.light.samples = 128;
  session.light.seed = seed;
  return session;
}

// Moves the camera into the overlay's cube or close to it.
inline void move_near_table(std::uint64_t seed, Session& session) {
  RandomNumbers draw(seed * 6151U + 3U);
  session.motion.distance.middle = draw.log_between(0.06, 0.32);
  session.motion.distance.amplitude =
      std::min(session.motion.distance.amplitude, 0.1 * session.motion.distance.middle);
}

// Displaces `fraction` of the tags together along the table, by 1/20 to 1 of a tag's side, and
// rotates them slightly.
inline std::vector<MappedTag> with_displaced_tags(std::uint64_t seed, std::vector<MappedTag> tags,
                                                  double fraction) {
  RandomNumbers draw(seed * 3571U + 11U);
  const auto count =
      static_cast<std::size_t>(std::lround(fraction * static_cast<double>(tags.size())));
  const double side = tags.front().size_m;
  const double by = side * draw.log_between(0.05, 1.0);
  const double towards = draw.between(0.0, 2.0 * std::numbers::pi);
  const double turn = draw.between(-1.0, 1.0) * by / 0.2;
  const Transform<frame::Table, frame::Table> push(
      Eigen::Quaterniond(Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ())),
      by * Eigen::Vector3d(std::cos(towards), std::sin(towards), 0.0));
  // The displaced tags are neighbours in the list, from a random index on.
  const auto first = static_cast<std::size_t>(draw.below(static_cast<int>(tags.size())));
  for (std::size_t k = 0; k < count; ++k) {
    MappedTag& tag = tags[(first + k) % tags.size()];
    tag.T_table_tag = push * tag.T_table_tag;
  }
  return tags;
}

}  // namespace penumbra::test
