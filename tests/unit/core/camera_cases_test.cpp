// Camera files in the formats of other programs.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <string>
#include <vector>

#include "core/camera/camera_file.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

Result<LoadedCamera> read_camera(const std::string& text, const std::string& name = {}) {
  const test::TemporaryFolder folder;
  EXPECT_TRUE(write_text_file(folder.path() / "camera", text));
  return load_camera_file(folder.path() / "camera", name);
}

std::string error_of(const std::string& text, const std::string& name = {}) {
  const auto camera = read_camera(text, name);
  return camera ? "" : camera.error().message;
}

// Text of a file as camera_calibration_parsers writes it.
std::string ros_text(const std::string& model, const std::string& coefficients) {
  return "image_width: 640\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n"
         "  cols: 3\n  data: [500, 0, 320, 0, 501, 240, 0, 0, 1]\n" +
         model + "distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: " + coefficients + "\n";
}

// Text of an OpenCV file. `head` precedes the keys; `coefficients` are numbers with commas.
std::string opencv_text(const std::string& head, const std::string& coefficients) {
  return head +
         "image_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n"
         "   cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 501., 240., 0., 0., 1. ]\n"
         "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ " +
         coefficients + " ]\n";
}

void expect_pinhole(const Result<LoadedCamera>& camera) {
  ASSERT_TRUE(camera) << camera.error().message;
  const CameraParameters& p = camera->camera.parameters();
  EXPECT_EQ(p.width, 640);
  EXPECT_EQ(p.height, 480);
  EXPECT_EQ(p.fx, 500.0);
  EXPECT_EQ(p.cx, 320.0);
  EXPECT_EQ(p.cy, 240.0);
}

TEST(RosCameraInfo, FillsMissingCoefficientsAndIgnoresZerosBeyondModel) {
  struct Case {
    const char* model;
    const char* coefficients;
    DistortionModel expected;
    std::array<double, 8> distortion;
  };
  using enum DistortionModel;
  for (const Case& c :
       std::vector<Case>{{"distortion_model: plumb_bob\n", "[]", plumb_bob, {}},
                         {"distortion_model: plumb_bob\n", "", plumb_bob, {}},
                         {"distortion_model: ''\n", "[]", plumb_bob, {}},
                         {"distortion_model:\n", "[0, 0, 0, 0, 0]", plumb_bob, {}},
                         {"", "[]", plumb_bob, {}},
                         {"distortion_model: plumb_bob\n",
                          "[0.1, 0.2, 0.003, 0.004]",
                          plumb_bob,
                          {0.1, 0.2, 0.003, 0.004}},
                         {"distortion_model: plumb_bob\n",
                          "[0.1, 0.2, 0.003, 0.004, 0.05, 0, 0, 0]",
                          plumb_bob,
                          {0.1, 0.2, 0.003, 0.004, 0.05}},
                         {"distortion_model: rational_polynomial\n", "[]", rational, {}},
                         {"distortion_model: rational_polynomial\n",
                          "[0.1, 0, 0, 0, 0.05]",
                          rational,
                          {0.1, 0, 0, 0, 0.05}},
                         {"distortion_model: rational_polynomial\n",
                          "[0.1, 0, 0, 0, 0.05, 0.2, 0.02, 0.003, 0, 0, 0, 0]",
                          rational,
                          {0.1, 0, 0, 0, 0.05, 0.2, 0.02, 0.003}},
                         {"distortion_model: rational_polynomial\n",
                          "[0.1, 0, 0, 0, 0.05, 0.2, 0.02, 0.003, 0, 0, 0, 0, 0, 0]",
                          rational,
                          {0.1, 0, 0, 0, 0.05, 0.2, 0.02, 0.003}},
                         {"distortion_model: equidistant\n", "[]", fisheye, {}},
                         {"distortion_model: equidistant\n",
                          "[0.01, 0.02, -0.003, 0.001, 0]",
                          fisheye,
                          {0.01, 0.02, -0.003, 0.001}},
                         {"distortion_model: fisheye\n",
                          "[0.01, 0.02, -0.003, 0.001, 0, 0, 0, 0]",
                          fisheye,
                          {0.01, 0.02, -0.003, 0.001}}}) {
    const auto camera = read_camera(ros_text(c.model, c.coefficients));
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().model, c.expected) << c.model << c.coefficients;
    EXPECT_EQ(camera->camera.parameters().distortion, c.distortion) << c.coefficients;
    EXPECT_THAT(camera->warnings, IsEmpty()) << c.model << c.coefficients;
  }
}

TEST(RosCameraInfo, AssumesMissingModelWithWarning) {
  for (const char* model : {"", "distortion_model: ''\n", "camera_model: pinhole\n"}) {
    const auto camera = read_camera(ros_text(model, "[0.1, -0.05, 0.001, 0.002, 0.0]"));
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().model, DistortionModel::plumb_bob);
    EXPECT_EQ(camera->camera.parameters().distortion[1], -0.05);
    EXPECT_THAT(camera->warnings,
                ElementsAre(AllOf(HasSubstr("camera: "), HasSubstr("plumb_bob is assumed"))));
  }
  EXPECT_THAT(error_of(ros_text("distortion_modle: equidistant\n", "[0.1, 0, 0, 0]")),
              HasSubstr("did you mean `distortion_model`?"));
}

TEST(RosCameraInfo, RejectsAndReportsCoefficientsOfOtherModels) {
  const std::string rational = "distortion_model: rational_polynomial\n";
  EXPECT_THAT(error_of(ros_text(rational, "[0,0,0,0,0,0,0,0,0.01,0,0,0]")),
              AllOf(HasSubstr("number 9 (s1, of a thin prism) is 0.01"), HasSubstr("line")));
  EXPECT_THAT(error_of(ros_text(rational, "[0,0,0,0,0,0,0,0,0,0,0,0,0,0.02]")),
              HasSubstr("number 14 (tau_y, of a tilted sensor)"));
  EXPECT_THAT(error_of(ros_text("distortion_model: plumb_bob\n", "[0,0,0,0,0,0.3,0,0]")),
              AllOf(HasSubstr("number 6 (k4) is 0.3"), HasSubstr("rational_polynomial")));
  EXPECT_THAT(error_of(ros_text("distortion_model: equidistant\n", "[0,0,0,0,0.1]")),
              HasSubstr("equidistant has 4"));
  EXPECT_THAT(error_of(ros_text("distortion_model: plumb_bob\n", "[1, 2]")),
              HasSubstr("0, 4, 5, 8, 12 or 14"));
  EXPECT_THAT(error_of(ros_text("distortion_model: plumb_bob\n", "[.nan, 0, 0, 0, 0]")),
              HasSubstr("not a finite number"));
}

constexpr const char* kMessageEnd =
    "binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n"
    "  do_rectify: false\n---\n";

TEST(RosMessage, IsReadAsPrintedByTopicEcho) {
  const std::string ros2 =
      std::string(
          "header:\n  stamp:\n    sec: 1700000000\n    nanosec: 5\n  frame_id: cam\n"
          "height: 480\nwidth: 640\ndistortion_model: plumb_bob\n"
          "d:\n- 0.1\n- -0.05\n- 0.001\n- 0.002\n- 0.0\n"
          "k:\n- 500.0\n- 0.0\n- 320.0\n- 0.0\n- 501.0\n- 240.0\n- 0.0\n- 0.0\n- 1.0\n"
          "r:\n- 1.0\n- 0.0\np:\n- 500.0\n") +
      kMessageEnd;
  const std::string ros1 =
      std::string(
          "header: \n  seq: 12\n  stamp: \n    secs: 1\n    nsecs: 2\n"
          "  frame_id: \"cam\"\nheight: 480\nwidth: 640\n"
          "distortion_model: \"plumb_bob\"\nD: [0.1, -0.05, 0.001, 0.002, 0.0]\n"
          "K: [500.0, 0.0, 320.0, 0.0, 501.0, 240.0, 0.0, 0.0, 1.0]\n"
          "R: [1.0, 0.0]\nP: [500.0]\n") +
      kMessageEnd;
  for (const std::string& text : {ros2, ros1, "camera_info:\n  " + [&] {
                                    std::string nested;
                                    for (const char c : ros1.substr(0, ros1.find("---")))
                                      nested += c == '\n' ? "\n  " : std::string(1, c);
                                    return nested;
                                  }()}) {
    const auto camera = read_camera(text);
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().fy, 501.0);
    EXPECT_EQ(camera->camera.parameters().distortion[1], -0.05);
    EXPECT_THAT(camera->warnings, IsEmpty());
  }
  std::string empty = ros1;
  empty.replace(empty.find("D: ["), std::string("D: [0.1, -0.05, 0.001, 0.002, 0.0]").size(),
                "D: []");
  const auto straight = read_camera(empty);
  expect_pinhole(straight);
  EXPECT_FALSE(straight->camera.has_distortion());
}

TEST(RosMessage, IsRejectedForPartialImageOrMissingCalibration) {
  const std::string head =
      "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd: []\n"
      "k: [500, 0, 320, 0, 501, 240, 0, 0, 1]\n";
  EXPECT_EQ(error_of(head + "roi: {x_offset: 0, y_offset: 0, height: 480, width: 640}\n"), "");
  EXPECT_THAT(error_of(head + "binning_x: 2\nbinning_y: 2\n"), HasSubstr("binning_x"));
  EXPECT_THAT(error_of(head + "roi: {x_offset: 20, y_offset: 0, height: 100, width: 100}\n"),
              HasSubstr("x_offset"));
  EXPECT_THAT(error_of("height: 480\nwidth: 640\nd: []\nk: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n"),
              HasSubstr("not calibrated"));
}

TEST(OpenCvFile, IsRecognisedByContentNotByFirstLine) {
  for (const char* head :
       {"%YAML:1.0\n---\n", "\xEF\xBB\xBF%YAML:1.0\n---\n", "# calibrated by me\n%YAML:1.0\n---\n",
        "\n\n%YAML:1.0\n", "%YAML 1.2\n---\n", "%YAML 1.1\n---\n", "---\n", ""}) {
    const auto camera = read_camera(opencv_text(head, "1.0e-01, -5.0e-02, 1.0e-03, 2.0e-03, 0."));
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().model, DistortionModel::plumb_bob);
    EXPECT_EQ(camera->camera.parameters().distortion[1], -0.05);
    EXPECT_THAT(camera->warnings, IsEmpty()) << head;
  }
  const auto rational = read_camera(opencv_text("", "0.1, 0, 0, 0, 0, 0.2, 0, 0, 0, 0, 0, 0"));
  ASSERT_TRUE(rational) << rational.error().message;
  EXPECT_EQ(rational->camera.parameters().model, DistortionModel::rational);
  const auto fisheye =
      read_camera(opencv_text("%YAML:1.0\n", "0.1, 0, 0, 0") + "distortion_model: fisheye\n");
  ASSERT_TRUE(fisheye) << fisheye.error().message;
  EXPECT_EQ(fisheye->camera.parameters().model, DistortionModel::fisheye);
  EXPECT_THAT(error_of(opencv_text("%YAML:1.0\n---\n", "1, 2, nan, 4")), HasSubstr("line 14"));
}

std::string opencv_json(const std::string& coefficients) {
  return "{\n\t\"image_width\": 640,\n\t\"image_height\":480,\n\t\"camera_matrix\": {\n"
         "\t\t\"type_id\": \"opencv-matrix\",\n\t\t\"rows\": 3, \"cols\": 3, \"dt\": \"d\",\n"
         "\t\t\"data\": [ 500.0, 0, 320, 0, 501.0, 240, 0, 0, 1.0 ]\n\t},\n"
         "\t\"distortion_coefficients\": {\"type_id\":\"opencv-matrix\",\"rows\":5,\"cols\":1,"
         "\"dt\":\"d\",\"data\":[" +
         coefficients + "]}\n}";
}

std::string opencv_xml(const std::string& coefficients) {
  return "<?xml version=\"1.0\"?>\n<opencv_storage>\n"
         "<calibration_time>\"Tue 03 Mar 2026\"</calibration_time>\n<flags>0</flags>\n"
         "<image_width>640</image_width>\n<image_height>480</image_height>\n"
         "<camera_matrix type_id=\"opencv-matrix\">\n  <rows>3</rows>\n  <cols>3</cols>\n"
         "  <dt>d</dt>\n  <data>\n    500. 0. 320. 0.\n    501. 240. 0. 0. "
         "1.</data></camera_matrix>\n"
         "<distortion_coefficients type_id=\"opencv-matrix\">\n  <rows>5</rows>\n  <cols>1</cols>\n"
         "  <dt>d</dt>\n  <data>" +
         coefficients + "</data></distortion_coefficients>\n</opencv_storage>\n";
}

TEST(OpenCvFile, WarnsOfFourCoefficientsWithoutModel) {
  for (const std::string& text :
       {opencv_text("%YAML:1.0\n---\n", "0.1, -0.05, 0.001, 0.002"),
        opencv_xml("0.1 -0.05 0.001 0.002"), opencv_json("0.1, -0.05, 0.001, 0.002")}) {
    const auto camera = read_camera(text);
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().model, DistortionModel::plumb_bob);
    EXPECT_THAT(camera->warnings,
                ElementsAre(AllOf(HasSubstr("plumb_bob is assumed"), HasSubstr("cv::fisheye"),
                                  HasSubstr("equidistant"))));
  }
  const std::string four = opencv_text("", "0.1, -0.05, 0.001, 0.002");
  for (const char* named :
       {"distortion_model: plumb_bob\n", "fisheye_model: 0\n", "fisheye_model: 1\n"}) {
    const auto camera = read_camera(four + named);
    ASSERT_TRUE(camera) << camera.error().message;
    EXPECT_THAT(camera->warnings, IsEmpty()) << named;
  }
  EXPECT_THAT(read_camera(opencv_text("", "0., 0., 0., 0."))->warnings, IsEmpty());
}

TEST(OpenCvFile, IsRejectedWithMirrorParameter) {
  const std::string text = opencv_text("%YAML:1.0\n---\n", "0.1, -0.05, 0.001, 0.002, 0.");
  const std::string matrix = "xi: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ ";
  for (const std::string& xi : {std::string("xi: 0.9\n"), matrix + "0.9 ]\n"}) {
    EXPECT_THAT(error_of(text + xi), AllOf(HasSubstr("xi"), HasSubstr("is 0.9"),
                                           HasSubstr("cv::omnidir"), HasSubstr("line 15")));
  }
  std::string xml = opencv_xml("0.1 -0.05 0.001 0.002 0.");
  xml.insert(xml.find("</opencv_storage>"),
             "<xi type_id=\"opencv-matrix\"><rows>1</rows><cols>1</cols><dt>d</dt>"
             "<data>0.9</data></xi>\n");
  EXPECT_THAT(error_of(xml), AllOf(HasSubstr("is 0.9"), HasSubstr("cv::omnidir")));
  for (const std::string& xi : {std::string("xi: 0.\n"), matrix + "0. ]\n"})
    EXPECT_EQ(error_of(text + xi), "");
  for (const std::string& xi : {std::string("xi: .nan\n"), matrix + ".nan ]\n"})
    EXPECT_NE(error_of(text + xi), "");
}

TEST(OpenCvFile, IsReadAsJsonAndXml) {
  for (const std::string& text :
       {opencv_json("0.1, -0.05, 0.001, 0.002, 0"), opencv_xml("0.1 -0.05 0.001 0.002 0."),
        "\xEF\xBB\xBF" + opencv_xml("0.1 -0.05 0.001 0.002 0.")}) {
    const auto camera = read_camera(text);
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_EQ(camera->camera.parameters().distortion[3], 0.002);
    EXPECT_THAT(camera->warnings, IsEmpty());
  }
}

TEST(OpenCvFile, IsRejectedWithOneLineWhenXmlIsDamaged) {
  EXPECT_THAT(error_of("<?xml version=\"1.0\"?>\n<opencv_storage><a>1</b></opencv_storage>"),
              AllOf(HasSubstr("line 2"), HasSubstr("XML")));
  EXPECT_THAT(error_of("<html><body>404</body></html>"), HasSubstr("no FileStorage of OpenCV"));
  EXPECT_THAT(error_of("<opencv_storage></opencv_storage>"), HasSubstr("no named values"));
  EXPECT_THAT(error_of("<opencv_storage><a>1</a><a>2</a></opencv_storage>"), HasSubstr("twice"));
  EXPECT_THAT(error_of("<"), HasSubstr("XML"));
  EXPECT_THAT(error_of(opencv_xml("0.1 much 0 0 0")), HasSubstr("not a finite number"));
  std::string deep = "<opencv_storage>";
  for (int i = 0; i < 100'000; ++i) deep += "<a>";
  EXPECT_THAT(error_of(deep), HasSubstr("XML"));
}

TEST(OpenCvFile, RequiresNameWhenItHoldsTwoCameras) {
  const std::string matrix =
      ": !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 501., "
      "240., 0., 0., 1. ]\n";
  const std::string coefficients =
      ": !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ ";
  const std::string stereo = "%YAML:1.0\n---\nimage_size: [640, 480]\nM1" + matrix + "D1" +
                             coefficients + "0.1, 0., 0., 0., 0. ]\nM2" + matrix + "D2" +
                             coefficients + "0.2, 0., 0., 0., 0. ]\n";
  EXPECT_THAT(error_of(stereo), AllOf(HasSubstr("M1, M2"), HasSubstr("--camera-name")));
  const auto second = read_camera(stereo, "M2");
  expect_pinhole(second);
  EXPECT_EQ(second->camera.parameters().distortion[0], 0.2);
  EXPECT_THAT(error_of(stereo, "left"), AllOf(HasSubstr("'left'"), HasSubstr("M1, M2")));
}

std::string kalibr_camera(const std::string& name, double fx) {
  return fmt::format(
      "{}:\n  cam_overlaps: []\n  camera_model: pinhole\n"
      "  distortion_coeffs: [0.01, 0.02, -0.003, 0.001]\n  distortion_model: equidistant\n"
      "  intrinsics: [{}, 501.0, 320.0, 240.0]\n  resolution: [640, 480]\n"
      "  rostopic: /cam0/image_raw\n",
      name, fx);
}

TEST(KalibrChain, AcceptsAnyCameraNameAndSelectsOneOfSeveral) {
  for (const char* name : {"cam0", "cam1", "camera_center"}) {
    expect_pinhole(read_camera(kalibr_camera(name, 500.0)));
    expect_pinhole(read_camera(kalibr_camera(name, 500.0), name));
  }
  const std::string two = kalibr_camera("cam0", 400.0) + kalibr_camera("right", 500.0);
  EXPECT_THAT(error_of(two), AllOf(HasSubstr("cam0, right"), HasSubstr("--camera-name")));
  expect_pinhole(read_camera(two, "right"));
  EXPECT_EQ(read_camera(two, "cam0")->camera.parameters().fx, 400.0);
  EXPECT_THAT(error_of(two, "cam1"), AllOf(HasSubstr("'cam1'"), HasSubstr("cam0, right")));
  EXPECT_FALSE(error_of(kalibr_camera("cam0", 500.0), "cam1").empty());
}

TEST(CameraName, MustMatchSingleCameraOfFile) {
  const std::string text = ros_text("distortion_model: plumb_bob\n", "[]");
  expect_pinhole(read_camera(text, "cam"));
  EXPECT_THAT(error_of(text, "left"), AllOf(HasSubstr("'cam'"), HasSubstr("--camera-name")));
}

// Camera files in the folder shared/cases.
class SharedCameraCase : public testing::Test {
 protected:
  void SetUp() override {
    shared_ = test::shared_dir();
    if (shared_.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  }
  [[nodiscard]] Result<LoadedCamera> load(const std::string& file) const {
    return load_camera_file(shared_ / "cases" / file);
  }
  std::filesystem::path shared_;
};

TEST_F(SharedCameraCase, ReadsCoefficientsByLensModel) {
  const std::string folder = "camera-info-coefficients/";
  for (const char* file : {"ros_empty_D_emptymodel.yaml", "ros_empty_D_plumb.yaml"}) {
    const auto camera = load(folder + file);
    expect_pinhole(camera);
    ASSERT_TRUE(camera);
    EXPECT_FALSE(camera->camera.has_distortion());
  }
  const auto distortion = [&](const char* file) {
    const auto camera = load(folder + file);
    expect_pinhole(camera);
    return camera ? camera->camera.parameters().distortion : std::array<double, 8>{};
  };
  const std::array<double, 8> five = {0.1, -0.05, 0.001, 0.002};
  const std::array<double, 8> eight = {0.1, -0.05, 0.001, 0.002, 0.01, 0.2, 0.02, 0.003};
  EXPECT_EQ(distortion("cv_14zero.yaml"), five);
  EXPECT_EQ(distortion("ros_missing_model.yaml"), five);
  EXPECT_EQ(distortion("ros_rational_5.yaml"), five);
  EXPECT_EQ(distortion("ros_rational_12_zero.yaml"), eight);
  EXPECT_EQ(distortion("ros_rational_14_zero.yaml"), eight);
  EXPECT_EQ(distortion("ros_plumb_8_trailing0.yaml"),
            (std::array<double, 8>{-0.0306, 0.0352, -0.000138, -0.000146, -0.01204}));
  EXPECT_EQ(distortion("ros_equidistant_5zero.yaml"),
            (std::array<double, 8>{0.01, 0.02, -0.003, 0.001}));
  EXPECT_EQ(load(folder + "ros_missing_model.yaml")->warnings.size(), 1U);
}

TEST_F(SharedCameraCase, ReadsOpenCvAndKalibrFilesByContent) {
  const std::string folder = "opencv-yaml-not-recognised/";
  for (const char* file : {"cv_bom.yaml", "cv_json.json", "cv_leading_comment.yaml",
                           "cv_no_header.yaml", "cv_xml.xml", "cv_yaml12_header.yaml"}) {
    const auto camera = load(folder + file);
    expect_pinhole(camera);
    ASSERT_TRUE(camera) << file;
    EXPECT_EQ(camera->camera.parameters().distortion,
              (std::array<double, 8>{0.1, -0.05, 0.001, 0.002}));
    EXPECT_THAT(camera->warnings, IsEmpty()) << file;
  }
  for (const char* file : {"kal_cam1_only.yaml", "kal_named.yaml"}) {
    const auto camera = load(folder + file);
    expect_pinhole(camera);
    ASSERT_TRUE(camera) << file;
    EXPECT_EQ(camera->camera.parameters().model, DistortionModel::fisheye);
  }
}

}  // namespace
}  // namespace penumbra
