// penumbra replay --compare: several techniques in panes side by side.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <fstream>

#include "app/output/pane_grid.hpp"
#include "app/recording/video_reader.hpp"
#include "core/image/image_file.hpp"
#include "replay/replay_support.hpp"
#include "support/textured_glb.hpp"

namespace penumbra::test {
namespace {

using testing::HasSubstr;

// Returns the pixels of one pane.
RgbaImage pane_of(const RgbaImage& image, const PaneGrid& grid, std::size_t pane, int width,
                  int height) {
  RgbaImage cut{width, height, {}};
  const PaneGrid::Corner corner = grid.corner_of(pane);
  for (int y = 0; y < height; ++y) {
    const auto* row =
        image.pixels.data() + std::ptrdiff_t{4} * ((corner.y + y) * image.width + corner.x);
    cut.pixels.insert(cut.pixels.end(), row, row + std::ptrdiff_t{4} * width);
  }
  return cut;
}

class CompareOption : public testing::Test {
 protected:
  [[nodiscard]] std::string file(const std::string& name) const {
    return (folder_.path() / name).string();
  }
  static ProgramResult replay(const std::vector<std::string>& more,
                              const std::string& frames = "28:31") {
    std::vector<std::string> arguments = {"replay", bundled("tabletop"), "--frames", frames};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return penumbra(arguments);
  }
  // Expects that each pane of each frame equals the frame drawn with the pane's technique alone.
  // Calls without `more` share the frames that are drawn with one technique.
  void expect_panes(const std::vector<std::string>& techniques,
                    const std::vector<std::string>& more = {}) {
    std::string list;
    for (const std::string& name : techniques) list += (list.empty() ? "" : ",") + name;
    SCOPED_TRACE(list);
    const std::string together = file("together " + list);
    std::vector<std::string> words = {"--compare", list, "--output", together};
    words.insert(words.end(), more.begin(), more.end());
    const ProgramResult result = replay(words, "28:30");
    ASSERT_EQ(result.exit_code, 0) << result.err;
    EXPECT_EQ(result.err, "");
    ASSERT_EQ(contents_of(together).size(), 2U);
    for (std::size_t pane = 0; pane < techniques.size(); ++pane) {
      const std::string alone = file("alone " + techniques[pane]);
      words = {"--shadow", techniques[pane], "--output", alone};
      if (!more.empty()) std::filesystem::remove_all(alone);
      words.insert(words.end(), more.begin(), more.end());
      if (techniques[pane] == "cocl") {  // always uses CoCL kernels
        const auto kernels = std::ranges::find(words, "--kernels");
        if (kernels != words.end()) words.erase(kernels, kernels + 2);
      }
      if (!std::filesystem::exists(alone)) {
        const ProgramResult single = replay(words, "28:30");
        ASSERT_EQ(single.exit_code, 0) << single.err;
      }
      for (const char* name : {"000028.png", "000029.png"}) {
        const auto image = load_rgba(together + "/" + name);
        ASSERT_TRUE(image) << image.error().message;
        const auto expected = load_rgba(alone + "/" + name);
        ASSERT_TRUE(expected) << expected.error().message;
        const PaneGrid grid(expected->width, expected->height, techniques);
        ASSERT_EQ(image->width, grid.width());
        ASSERT_EQ(image->height, grid.height());
        EXPECT_TRUE(pane_of(*image, grid, pane, expected->width, expected->height).pixels ==
                    expected->pixels)
            << techniques[pane] << " in " << name;
      }
    }
  }

  TemporaryFolder folder_;
};

TEST_F(CompareOption, DrawsEachPaneLikeItsTechniqueAlone) {
  expect_panes({"layered", "simple", "walls", "hard"});
  expect_panes({"none", "cocl", "field", "volume", "layered", "simple", "walls", "hard"});
  expect_panes({"layered", "cocl"}, {"--kernels", "smooth", "--threads", "1"});
}

TEST_F(CompareOption, ReplaysRecordedEditsInEveryPane) {
  const std::filesystem::path recording = folder_.path() / "recording";
  std::filesystem::create_directory(recording);
  for (const auto& entry : std::filesystem::directory_iterator(bundled("tabletop"))) {
    std::filesystem::create_symlink(entry.path(), recording / entry.path().filename());
  }
  std::ofstream(recording / "events.jsonl")
      << R"({"timestamp_s":0.9,"event":"object_moved","object":"helicopter",)"
      << R"("position":[0.0,0.0,0.05],"quaternion_xyzw":[0.0,0.0,0.0,1.0],"scale":1.0})"
      << "\n";
  const auto run = [&](const std::string& name, std::vector<std::string> words) {
    words.insert(words.begin(),
                 {"replay", recording.string(), "--frames", "28:29", "--output", file(name)});
    const ProgramResult result = penumbra(words);
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return load_rgba(file(name) + "/000028.png").value();
  };
  const RgbaImage together = run("together", {"--compare", "hard,layered"});
  const RgbaImage still = run("still", {"--compare", "hard,layered", "--no-edits"});
  EXPECT_FALSE(together.pixels == still.pixels);
  std::size_t pane = 0;
  for (const char* technique : {"hard", "layered"}) {
    const RgbaImage alone = run(technique, {"--shadow", technique});
    const PaneGrid grid(alone.width, alone.height, {"hard", "layered"});
    EXPECT_TRUE(pane_of(together, grid, pane++, alone.width, alone.height).pixels == alone.pixels)
        << technique;
  }
}

TEST_F(CompareOption, WarnsOfCutOutMaterialsInAnyPane) {
  const RgbaImage half = image_of(8, 8, [](int x, int) {
    return std::array<int, 4>{90, 90, 90, x < 4 ? 255 : 0};
  });
  TexturedSquare square;
  square.material = R"("pbrMetallicRoughness":{"baseColorTexture":{"index":0}},"alphaMode":"MASK")";
  square.images = {png_bytes(half)};
  std::ofstream(file("cut.glb"), std::ios::binary) << glb_of(square);
  std::ofstream(file("scene.json"))
      << R"({"objects": [{"name": "cut", "model": "cut.glb", "position": [0, 0, 0.05]}],)"
      << R"("shadows": [{"name": "shadow", "technique": "simple"}]})";
  const auto error_output = [&](const std::string& techniques) {
    const ProgramResult result =
        replay({"--scene", file("scene.json"), "--compare", techniques, "--output", file("out")});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return result.err;
  };
  EXPECT_EQ(error_output("simple,field"), "");
  EXPECT_THAT(error_output("simple,layered"),
              HasSubstr("cut.glb: its materials cut holes into faces"));
}

TEST_F(CompareOption, WritesAllOutputsAndReport) {
  const std::vector<std::string> names = {"layered", "simple", "hard"};
  const GridSize size = grid_size(640, 480, 3);
  const ProgramResult lossless =
      replay({"--compare", "layered,simple,hard", "--output", file("out.mkv"), "--poses",
              file("out.tum"), "--report", file("report.json")});
  ASSERT_EQ(lossless.exit_code, 0) << lossless.err;
  for (const char* name : {"layered", "simple", "hard"}) {
    EXPECT_THAT(lossless.out, HasSubstr(std::string(name) + ": shadow"));
  }
  ASSERT_EQ(replay({"--compare", "layered,simple,hard", "--output", file("frames")}).exit_code, 0);
  ASSERT_EQ(replay({"--compare", "layered,simple,hard", "--output", file("out.mp4")}).exit_code, 0);
  EXPECT_EQ(bytes_of(file("out.mp4")).substr(4, 4), "ftyp");
  EXPECT_EQ(contents_of(file("frames")).size(), 3U);
  auto video = VideoReader::open(file("out.mkv"));
  ASSERT_TRUE(video) << video.error().message;
  for (const char* name : {"000028.png", "000029.png", "000030.png"}) {
    const auto image = load_rgba(file("frames") + "/" + name);
    ASSERT_TRUE(image) << image.error().message;
    ASSERT_EQ(image->width, size.width);
    ASSERT_EQ(image->height, size.height);
    const auto frame = video->next();
    ASSERT_TRUE(frame && *frame);
    ASSERT_EQ((*frame)->format, PixelFormat::rgb24);
    ASSERT_EQ((*frame)->width, size.width);
    ASSERT_EQ((*frame)->height, size.height);
    std::size_t differing = 0;
    const PixelPlane& plane = (*frame)->planes[0];
    for (std::ptrdiff_t y = 0; y < size.height; ++y) {
      for (std::ptrdiff_t x = 0; x < size.width; ++x) {
        const std::uint8_t* video_pixel = plane.data + y * plane.stride + 3 * x;
        const std::uint8_t* image_pixel = image->pixels.data() + 4 * (y * size.width + x);
        differing += std::equal(video_pixel, video_pixel + 3, image_pixel) ? 0U : 1U;
      }
    }
    EXPECT_EQ(differing, 0U) << name;
  }
  EXPECT_FALSE(video->next().value()) << "the video has more than three frames";
  // The poses must equal those of a replay without --compare.
  ASSERT_EQ(replay({"--poses", file("alone.tum")}).exit_code, 0);
  EXPECT_EQ(bytes_of(file("out.tum")), bytes_of(file("alone.tum")));

  const nlohmann::json report = read_json(file("report.json"));
  EXPECT_EQ(report.at("frames"), 3);
  EXPECT_EQ(report.at("frames_tracked"), 3);
  ASSERT_EQ(report.at("compare").size(), 3U);
  std::int64_t drawn = 0;
  for (const std::string& name : names) {
    const auto& pane = report.at("compare").at(name);
    EXPECT_EQ(pane.at("time_ms").at("render").at("count"), 3) << name;
    drawn += pane.at("work").at("passes_drawn").get<std::int64_t>();
  }
  EXPECT_EQ(report.at("work").at("passes_drawn"), drawn) << "must be the sum over all panes";
  EXPECT_EQ(report.at("time_ms").at("render").at("count"), 3);
  EXPECT_GT(report.at("compare").at("layered").at("work").at("kernel_generations"), 0);
  EXPECT_EQ(report.at("compare").at("hard").at("work").at("kernel_generations"), 0);
}

TEST_F(CompareOption, WritesSameFramesWithAndWithoutWindow) {
  ASSERT_TRUE(has_xvfb()) << "no Xvfb: scripts/setup installs it";
  ASSERT_EQ(replay({"--compare", "layered,hard", "--output", file("offscreen")}).exit_code, 0);
  const ProgramResult shown =
      run_program(source_dir() / "tests" / "support" / "with-display",
                  {program().string(), "replay", bundled("tabletop"), "--frames", "28:31",
                   "--compare", "layered,hard", "--output", file("window")},
                  {}, folder_.path());
  ASSERT_EQ(shown.exit_code, 0) << shown.err;
  EXPECT_EQ(shown.out.find("offscreen"), std::string::npos)
      << "the program drew offscreen, without a window";
  EXPECT_EQ(contents_of(file("window")), contents_of(file("offscreen")));
}

TEST_F(CompareOption, ReportsErrorsInTechniqueList) {
  const auto error_output = [&](const std::vector<std::string>& words) {
    const ProgramResult result = replay(words);
    EXPECT_EQ(result.exit_code, 2) << result.err;
    return result.err;
  };
  EXPECT_THAT(error_output({"--compare", "layered"}), HasSubstr("give 2 to 8"));
  EXPECT_THAT(error_output({"--compare", "layered,pink"}),
              HasSubstr("pink: no such technique; known: "));
  EXPECT_THAT(error_output({"--compare", "hard,simple,hard"}), HasSubstr("hard: is named twice"));
  EXPECT_THAT(error_output({"--compare", "hard,simple", "--shadow", "field"}),
              HasSubstr("--shadow"));
}

}  // namespace
}  // namespace penumbra::test
