// Damaged files of a recording: opening returns an error of one line, or finite and ordered values.
#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "app/recording/recording_source.hpp"
#include "core/camera/camera_file.hpp"
#include "core/camera/sensor_file.hpp"
#include "support/mutate.hpp"
#include "support/recording_folder.hpp"
#include "support/test_form.hpp"
#include "support/video_file.hpp"

namespace penumbra {
namespace {

using test::mutated;
using test::Random;
using test::write_text;

struct RecordingTally {
  int inputs = 0;
  int accepted = 0;
};

// Returns the number of damaged files to try: all in the nightly form, otherwise a third.
int inputs(int nightly) {
  return test::nightly() ? nightly : nightly / 3;
}

void report(const RecordingTally& tally) {
  testing::Test::RecordProperty("inputs", tally.inputs);
  testing::Test::RecordProperty("accepted", tally.accepted);
  std::printf("%d inputs, %d accepted, the others refused\n", tally.inputs, tally.accepted);
}

// Expects one line of text that names the file.
void check_error(const Error& error, const std::string& name) {
  for (const char c : error.message) {
    ASSERT_TRUE(static_cast<unsigned char>(c) >= 0x20) << error.message;
  }
  ASSERT_NE(error.message.find(name), std::string::npos) << error.message;
}

#define PENUMBRA_HARD_WORDS                                                                        \
  {                                                                                                \
    "nan", "-inf", "1e400", "-0", "1e-320", "99999999999999999999", "2147483648", "-1", "~", "[",  \
        "]", "{", "}", "&a", "*a", "!!binary x", "|", "'", "\"", "0x10", "1_000", "true", "",      \
        "- - - -", "? :", "<<: *a", "\xFF\xFE", "4294967296", "1.7976931348623157e308", "#", "---" \
  }

void expect_finite(const CameraParameters& p) {
  ASSERT_TRUE(std::isfinite(p.fx) && std::isfinite(p.fy) && std::isfinite(p.cx) &&
              std::isfinite(p.cy));
  for (const double k : p.distortion) ASSERT_TRUE(std::isfinite(k));
}

TEST(RecordingFuzz, ReadsOrRejectsDamagedCameraFile) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "camera.yaml";
  Random random(11);
  RecordingTally tally;
  for (int i = 0; i < inputs(4000); ++i, ++tally.inputs) {
    write_text(file, mutated(test::small_camera_yaml(), random, PENUMBRA_HARD_WORDS));
    const auto camera = load_camera(file);
    if (!camera) {
      ASSERT_NO_FATAL_FAILURE(check_error(camera.error(), "camera.yaml"));
      continue;
    }
    ++tally.accepted;
    const CameraParameters& p = camera->parameters();
    ASSERT_TRUE(p.width > 0 && p.height > 0);
    ASSERT_TRUE(std::isfinite(p.fx) && std::isfinite(p.fy) && p.fx > 0.0 && p.fy > 0.0);
    ASSERT_TRUE(std::isfinite(p.cx) && std::isfinite(p.cy));
    for (const double k : p.distortion) ASSERT_TRUE(std::isfinite(k));
    ASSERT_FALSE(std::isnan(camera->max_radius()));
    ASSERT_GT(camera->max_radius(), 0.0);
    const auto pixel = camera->project({0.01, 0.02, 1.0});
    if (pixel) {
      ASSERT_TRUE(pixel->allFinite()) << test::read_bytes(file);
    }
  }
  report(tally);
}

// Camera files of other programs: ROS messages, OpenCV's FileStorage as YAML, JSON and XML, Kalibr.
TEST(RecordingFuzz, ReadsOrRejectsDamagedForeignCameraFiles) {
  const std::array<std::string, 5> layouts = {
      "header:\n  stamp:\n    sec: 17\n    nanosec: 5\n  frame_id: cam\nheight: 480\nwidth: 640\n"
      "distortion_model: plumb_bob\nd:\n- 0.1\n- -0.05\n- 0.001\n- 0.002\n- 0.0\nk: [500, 0, 320, "
      "0, 500, 240, 0, 0, 1]\nbinning_x: 0\nroi:\n  x_offset: 0\n  width: 0\n---\n",
      "# mine\n%YAML:1.0\n---\nimage_size: [ 640, 480 ]\nM1: !!opencv-matrix\n   rows: 3\n   dt: "
      "d\n"
      "   data: [ 500., 0., 320., 0., 500., 240., 0., 0., 1. ]\nD1: !!opencv-matrix\n   dt: d\n"
      "   data: [ 0.1, -0.05, 0.001, 0.002, 0., 0.1, 0., 0. ]\n",
      "{\"image_width\": 640, \"image_height\": 480, \"camera_matrix\": {\"type_id\": "
      "\"opencv-matrix\", \"dt\": \"d\", \"data\": [500, 0, 320, 0, 500, 240, 0, 0, 1]},\n"
      "\"distortion_coefficients\": {\"type_id\": \"opencv-matrix\", \"data\": [0.1, 0, 0, 0]}}",
      "<?xml version=\"1.0\"?>\n<opencv_storage>\n<time>\"a "
      "b\"</time><image_width>640</image_width>\n"
      "<image_height>480</image_height>\n<camera_matrix type_id=\"opencv-matrix\"><rows>3</rows>"
      "<data>500. 0. 320. 0. 500. 240. 0. 0. 1.</data></camera_matrix>\n"
      "<distortion_coefficients type_id=\"opencv-matrix\"><data>0.1 -0.05 0.001 0.002 0.</data>"
      "</distortion_coefficients><list><_>1</_><_><a>2</a></_></list>\n</opencv_storage>\n",
      "left:\n  camera_model: pinhole\n  distortion_coeffs: [0.01, 0.02, -0.003, 0.001]\n"
      "  distortion_model: equidistant\n  intrinsics: [500.0, 500.0, 320.0, 240.0]\n"
      "  resolution: [640, 480]\n"};
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "camera.yaml";
  Random random(18);
  RecordingTally tally;
  for (int i = 0; i < inputs(6000); ++i, ++tally.inputs) {
    const std::string& valid = layouts[static_cast<std::size_t>(i) % layouts.size()];
    if (i < static_cast<int>(layouts.size())) {
      write_text(file, valid);
      ASSERT_TRUE(load_camera(file)) << load_camera(file).error().message;
    }
    write_text(file, mutated(valid, random, PENUMBRA_HARD_WORDS));
    const auto camera = load_camera(file);
    if (!camera) {
      ASSERT_NO_FATAL_FAILURE(check_error(camera.error(), "camera.yaml"));
      continue;
    }
    ++tally.accepted;
    ASSERT_NO_FATAL_FAILURE(expect_finite(camera->parameters()));
  }
  report(tally);
}

TEST(RecordingFuzz, ReadsOrRejectsDamagedSensorFile) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "sensor.yaml";
  const std::string valid =
      "sensor_type: camera\nrate_hz: 20\nresolution: [64, 48]\ncamera_model: pinhole\n"
      "intrinsics: [45.8654, 45.7296, 36.7215, 24.8375] #fu, fv, cu, cv\n"
      "distortion_model: radial-tangential\n"
      "distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]\n";
  Random random(12);
  RecordingTally tally;
  for (int i = 0; i < inputs(2000); ++i, ++tally.inputs) {
    write_text(file, mutated(valid, random, PENUMBRA_HARD_WORDS));
    const auto camera = load_euroc_sensor(file);
    if (!camera) {
      ASSERT_NO_FATAL_FAILURE(check_error(camera.error(), "sensor.yaml"));
      continue;
    }
    ++tally.accepted;
    ASSERT_NO_FATAL_FAILURE(expect_finite(camera->parameters()));
  }
  report(tally);
}

TEST(RecordingFuzz, ReadsOrRejectsDamagedTagMap) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "tags.yaml";
  Random random(13);
  RecordingTally tally;
  for (int i = 0; i < inputs(4000); ++i, ++tally.inputs) {
    write_text(file, mutated(test::small_tags_yaml(), random, PENUMBRA_HARD_WORDS));
    const auto map = load_tag_map(file);
    if (!map) {
      ASSERT_NO_FATAL_FAILURE(check_error(map.error(), "tags.yaml"));
      continue;
    }
    ++tally.accepted;
    ASSERT_FALSE(map->tags().empty());
    for (const MappedTag& tag : map->tags()) {
      ASSERT_TRUE(std::isfinite(tag.size_m) && tag.size_m > 0.0);
      ASSERT_TRUE(tag.T_table_tag.is_finite());
      ASSERT_NEAR(tag.T_table_tag.rotation().norm(), 1.0, 1e-9);
      for (const Eigen::Vector3d& corner : tag.corners()) ASSERT_TRUE(corner.allFinite());
    }
  }
  report(tally);
}

TEST(RecordingFuzz, RejectsDeeplyNestedYaml) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "tags.yaml";
  for (const char* open : {"[", "{", "- ", "{a: ", "? "}) {
    std::string text = "tags: ";
    for (int i = 0; i < 20000; ++i) text += open;
    write_text(file, text);
    EXPECT_FALSE(load_tag_map(file)) << open;
    EXPECT_FALSE(load_camera(file)) << open;
  }
}

TEST(RecordingFuzz, ReadsOrRejectsDamagedTrajectory) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "groundtruth.tum";
  std::string euroc = "#timestamp, p_x [m], p_y [m], p_z [m], q_w [], q_x [], q_y [], q_z []\n";
  for (int i = 0; i < 12; ++i)
    euroc +=
        std::to_string(1403636580838555648 + i * 5'000'000LL) + ",4.5,-1.8,0.7,0.6,0.8,0,0,1\n";
  std::string log = "frame,timestamp_s,group,state,reason,tx,ty,tz,qx,qy,qz,qw,predicted_px\n";
  for (int i = 0; i < 6; ++i) {
    log += std::to_string(i) + "," + std::to_string(0.04 * i) +
           ",table,tracked,,0.1,-0.3,0.4,0.6,0.8,0,0,0.25\n" + std::to_string(i) +
           ",0.5,\"wall, \"\"left\"\"\",lost,\"none, found\",,,,,,,,\n";
  }
  const std::array<std::string, 3> formats = {test::truth(12), euroc, log};
  Random random(14);
  RecordingTally tally;
  for (int i = 0; i < inputs(9000); ++i, ++tally.inputs) {
    const std::string& valid = formats[static_cast<std::size_t>(i) % formats.size()];
    if (i < static_cast<int>(formats.size())) {
      write_text(file, valid);
      ASSERT_TRUE(load_trajectory(file)) << load_trajectory(file).error().message;
    }
    write_text(file, mutated(valid, random, PENUMBRA_HARD_WORDS));
    const auto trajectory = load_trajectory(file);
    if (!trajectory) {
      ASSERT_NO_FATAL_FAILURE(check_error(trajectory.error(), "groundtruth.tum"));
      continue;
    }
    ++tally.accepted;
    for (std::size_t k = 0; k < trajectory->poses.size(); ++k) {
      const StampedPose& pose = trajectory->poses[k];
      ASSERT_TRUE(pose.T_table_camera.is_finite());
      ASSERT_NEAR(pose.T_table_camera.rotation().norm(), 1.0, 1e-9);
      if (k > 0) {
        ASSERT_GT(pose.timestamp_ns, trajectory->poses[k - 1].timestamp_ns);
      }
    }
  }
  report(tally);
}

// Adds the columns of exposures and wall-clock times to a listing.
std::string with_wall_clock(const std::string& listing) {
  std::string text;
  int line = 0;
  for (const char c : listing) {
    if (c == '\n') {
      text += line == 0 ? ",exposure_s,wall_time_ns"
                        : ",0.0125,179000000000000000" + std::to_string(line);
      ++line;
    }
    text += c;
  }
  return text;
}

TEST(RecordingFuzz, OpensOrRejectsDamagedFrameList) {
  const test::TemporaryFolder root;
  const auto folder = root.path() / "small";
  test::write_recording(folder, 6);
  const std::array<std::string, 2> formats = {test::listing(6), with_wall_clock(test::listing(6))};
  Random random(15);
  RecordingTally tally;
  for (int i = 0; i < inputs(4000); ++i, ++tally.inputs) {
    const std::string& valid = formats[static_cast<std::size_t>(i) % formats.size()];
    write_text(folder / "timestamps.csv", mutated(valid, random, PENUMBRA_HARD_WORDS));
    const auto recording = open_recording(folder);
    if (!recording) {
      ASSERT_NO_FATAL_FAILURE(check_error(recording.error(), folder.string()));
      continue;
    }
    ++tally.accepted;
    ASSERT_FALSE(recording->frames.empty());
    for (std::size_t k = 1; k < recording->frames.size(); ++k) {
      ASSERT_GT(recording->frames[k].timestamp_ns, recording->frames[k - 1].timestamp_ns);
      ASSERT_GT(recording->frames[k].number, recording->frames[k - 1].number);
    }
  }
  report(tally);
}

TEST(RecordingFuzz, OpensOrRejectsDamagedVideo) {
  const test::TemporaryFolder root;
  const auto folder = root.path() / "filmed";
  test::write_recording(folder, 6, "");
  const auto fill = [](AVFrame& frame, int index) {
    for (int plane = 0; plane < 3; ++plane) {
      for (int i = 0; i < frame.linesize[plane] * (plane > 0 ? 24 : 48); ++i) {
        frame.data[plane][i] = static_cast<std::uint8_t>(i * (index + 3) + plane);
      }
    }
  };
  Random random(16);
  RecordingTally tally;
  for (const int gop : {1, 6}) {
    test::VideoSpec spec;
    spec.frames = 6;
    spec.gop = gop;
    test::write_video(folder / "video.mkv", spec, fill);
    const std::string valid = test::read_bytes(folder / "video.mkv");
    for (int i = 0; i < inputs(1000); ++i, ++tally.inputs) {
      // Half of the changes are in the headers.
      const std::size_t head = i % 2 == 0 ? std::min<std::size_t>(900, valid.size()) : 0;
      write_text(folder / "video.mkv",
                 head > 0 ? mutated(valid.substr(0, head), random) + valid.substr(head)
                          : mutated(valid, random));
      const auto recording = open_recording(folder);
      if (!recording) {
        ASSERT_NO_FATAL_FAILURE(check_error(recording.error(), "video.mkv"));
        continue;
      }
      auto source = open_recording_source(*recording);
      if (!source) {
        ASSERT_NO_FATAL_FAILURE(check_error(source.error(), "video.mkv"));
        continue;
      }
      std::size_t frames = 0;
      while (true) {
        const auto frame = (*source)->next();
        if (!frame) {
          ASSERT_NO_FATAL_FAILURE(check_error(frame.error(), "video.mkv"));
          break;
        }
        if (!*frame) {
          ASSERT_EQ(frames, recording->frames.size());
          ++tally.accepted;
          break;
        }
        ASSERT_EQ((*frame)->width, 64);
        ASSERT_EQ((*frame)->height, 48);
        ++frames;
        ASSERT_LE(frames, recording->frames.size());
      }
    }
  }
  report(tally);
}

}  // namespace
}  // namespace penumbra
