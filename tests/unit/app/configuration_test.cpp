#include "app/commands/configuration.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <memory>

#include "app/commands/options.hpp"
#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;

class ConfigurationTest : public testing::Test {
 protected:
  ConfigurationTest() {
    setenv("HOME", folder_.path().c_str(), 1);
    unsetenv("XDG_CONFIG_HOME");
  }

  fs::path write(const std::string& text, const char* name = "c.yaml") const {
    std::ofstream(folder_.path() / name) << text;
    return folder_.path() / name;
  }
  // Returns the words that the file adds to "live --config FILE MORE...".
  [[nodiscard]] std::vector<std::string> added(const std::string& text,
                                               std::vector<std::string> more = {}) {
    std::vector<std::string> words = {"live", "--config", write(text).string()};
    words.insert(words.end(), more.begin(), more.end());
    const auto configuration = load_configuration(*program_, words);
    EXPECT_TRUE(configuration) << configuration.error().message;
    std::vector<std::string> found;
    if (!configuration || !*configuration) return found;
    unused_ = (*configuration)->unused;
    for (const ConfiguredOption& option : (*configuration)->used) found.push_back(option.words);
    return found;
  }
  [[nodiscard]] std::string error_of(const std::string& text) {
    const auto configuration =
        load_configuration(*program_, {"live", "--config", write(text).string()});
    return configuration ? "no error" : configuration.error().message;
  }

  test::TemporaryFolder folder_;
  ChosenCommand chosen_;
  std::unique_ptr<CLI::App> program_ = make_program(chosen_);
  std::vector<std::string> unused_;
};

TEST_F(ConfigurationTest, AddsOptionsByTheirNames) {
  EXPECT_THAT(added("live:\n"
                    "  camera: v4l2:/dev/video2\n"
                    "  fps: 15\n"
                    "  kiosk: true\n"
                    "  no-hud: false\n"
                    "  fov: 70\n"
                    "  pixel-buffers: on\n"
                    "  object: [a.glb, \"b.glb,height=0.2\"]\n"),
              ElementsAre("--camera=v4l2:/dev/video2", "--fps=15", "--kiosk", "--fov=70",
                          "--pixel-buffers=on", "--object=a.glb", "--object=b.glb,height=0.2"));
}

TEST_F(ConfigurationTest, PrefersCommandLine) {
  const std::string text = "live:\n  fps: 15\n  shadow: field\n  object: a.glb\n";
  EXPECT_THAT(added(text, {"--fps", "30", "--object=b.glb"}), ElementsAre("--shadow=field"));
  EXPECT_TRUE(unused_.empty());
}

TEST_F(ConfigurationTest, IgnoresOptionsOfAnotherCamera) {
  const std::string text =
      "live:\n  camera: v4l2:/dev/video2\n  calibration: c.yaml\n  tags: t.yaml\n  shadow: field\n";
  EXPECT_THAT(added(text, {"--camera", "recording:r"}), ElementsAre("--shadow=field"));
  EXPECT_THAT(unused_, ElementsAre("--calibration", "--tags"));
  EXPECT_THAT(added(text, {"--camera", "v4l2:/dev/video2"}),
              ElementsAre("--calibration=c.yaml", "--tags=t.yaml", "--shadow=field"))
      << "the same camera keeps its calibration";
  EXPECT_THAT(added(text, {"--fov"}),
              ElementsAre("--camera=v4l2:/dev/video2", "--tags=t.yaml", "--shadow=field"));
}

TEST_F(ConfigurationTest, ReplacesHomeAndKeepsOtherPaths) {
  const std::string home = folder_.path().string();
  EXPECT_THAT(added("live:\n  tags: ~/t.yaml\n  calibration: ./~/c.yaml\n"
                    "  camera: recording:~/r\n"),
              ElementsAre("--tags=" + home + "/t.yaml", "--calibration=./~/c.yaml",
                          "--camera=recording:" + home + "/r"));
}

TEST_F(ConfigurationTest, ReadsUserFileOnlyForLive) {
  fs::create_directories(folder_.path() / ".config" / "penumbra");
  write("live:\n  fps: 15\n", ".config/penumbra/config.yaml");
  const auto applies = [this](const std::vector<std::string>& words) {
    const auto configuration = load_configuration(*program_, words);
    return configuration && *configuration;
  };
  EXPECT_TRUE(applies({"live"}));
  EXPECT_TRUE(applies({"--log-level", "info", "live"}));
  EXPECT_FALSE(applies({"live", "--help"}));
  EXPECT_FALSE(applies({"live", "-h"}));
  EXPECT_FALSE(applies({"replay", "live"}));
  EXPECT_FALSE(applies({}));
  setenv("XDG_CONFIG_HOME", (folder_.path() / "other").c_str(), 1);
  EXPECT_FALSE(applies({"live"}));
  fs::create_directories(folder_.path() / "other" / "penumbra");
  fs::create_symlink("nothing", folder_.path() / "other" / "penumbra" / "config.yaml");
  EXPECT_FALSE(load_configuration(*program_, {"live"})) << "a link to nothing is a mistake";
}

TEST_F(ConfigurationTest, UsesTimeOfKioskOnlyInKiosk) {
  const std::string text = "live:\n  reset-after: 60\n  no-window: true\n";
  EXPECT_THAT(added(text), ElementsAre("--no-window"));
  EXPECT_THAT(unused_, ElementsAre("--reset-after"));
  EXPECT_THAT(added(text, {"--kiosk"}), ElementsAre("--reset-after=60"));
}

TEST_F(ConfigurationTest, InsertsWordsBehindCommand) {
  Configuration configuration;
  configuration.used = {{"--fps", "--fps=15", 2}};
  std::vector<std::string> words = {"--log-level", "info", "live", "--duration", "1"};
  insert_options(*program_, configuration, words);
  EXPECT_THAT(words, ElementsAre("--log-level", "info", "live", "--fps=15", "--duration", "1"));
}

TEST_F(ConfigurationTest, NamesFileLineAndRemedyOfMistakes) {
  EXPECT_THAT(error_of("live:\n  fps: 15\n  shadwo: field\n"),
              HasSubstr("c.yaml: line 3: shadwo: is no option of live; did you mean shadow?"));
  EXPECT_THAT(error_of("live:\n  nothing-like-it: 1\n"), HasSubstr("penumbra live --help"));
  EXPECT_THAT(error_of("fps: 15\n"), HasSubstr("line 1: fps: is not a command"));
  EXPECT_THAT(error_of("live: 3\n"), HasSubstr("holds no options"));
  EXPECT_THAT(error_of("live:\n  kiosk: perhaps\n"), HasSubstr("give it true or false"));
  EXPECT_THAT(error_of("live:\n  fps:\n"), HasSubstr("is empty"));
  EXPECT_THAT(error_of("live:\n  fps: \"\"\n"), HasSubstr("is empty"));
  EXPECT_THAT(error_of("live:\n  fps: [15, 30]\n"), HasSubstr("the option has one value"));
  EXPECT_THAT(error_of("live:\n  fps: {a: 1}\n"), HasSubstr("is a map"));
  EXPECT_THAT(error_of("live:\n  object: [[a]]\n"), HasSubstr("something other than values"));
  EXPECT_THAT(error_of("live:\n  config: d.yaml\n"),
              HasSubstr("only be given on the command line"));
  EXPECT_THAT(error_of("live:\n  fps: 1\n  fps: 2\n"), HasSubstr("is there twice"));
  EXPECT_THAT(error_of("live: [\n"), HasSubstr("is not valid YAML"));
  EXPECT_THAT(error_of("live:\n  fps: 1\n---\nlive:\n  fps: 2\n"), HasSubstr("several documents"));
  EXPECT_THAT(error_of("live:\n  object: []\n"), HasSubstr("is empty"));
  EXPECT_THAT(error_of("live:\n  scene: !!binary aGVsbG8=\n"), HasSubstr("YAML tag"));
  for (const char* empty : {"live:\n", "", "# no option yet\n\n"})
    EXPECT_EQ(error_of(empty), "no error");
}

TEST_F(ConfigurationTest, FindsOptionThatAnErrorBeginsWith) {
  Configuration configuration;
  configuration.used = {{"--no-window", "--no-window", 2}, {"--no-win", "--no-win", 3}};
  EXPECT_EQ(blamed_option(configuration, "--no-window excludes --kiosk")->line, 2);
  EXPECT_EQ(blamed_option(configuration, "--no-win: x")->line, 3);
  EXPECT_EQ(blamed_option(configuration, "--camera: x"), nullptr);
}

TEST_F(ConfigurationTest, NamesUsedAndUnusedOptions) {
  Configuration configuration;
  configuration.file = "c.yaml";
  EXPECT_EQ(configuration_line(configuration), "configuration: c.yaml (no option used)");
  configuration.used = {{"--object", "--object=a", 2}, {"--object", "--object=b", 2}};
  configuration.unused = {"--tags"};
  EXPECT_EQ(configuration_line(configuration),
            "configuration: c.yaml (object; not used with this command line: tags)");
}

}  // namespace
}  // namespace penumbra
