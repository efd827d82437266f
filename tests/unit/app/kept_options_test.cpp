// The options of live that a recording keeps.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <memory>
#include <string>

#include "app/commands/options.hpp"
#include "app/recording/session_record.hpp"

namespace penumbra {
namespace {

// Options that do not change how frames of a recording are drawn, or whose result the recording
// contains: the scene, its objects and kernels, the tag map and the images.
constexpr auto kOthers =
    std::to_array<std::string_view>({"--help",          "--camera",
                                     "--calibration",   "--camera-name",
                                     "--size",          "--scale-calibration",
                                     "--fps",           "--format",
                                     "--exposure",      "--gain",
                                     "--white-balance", "--focus",
                                     "--no-dma-buf",    "--fov",
                                     "--duration",      "--record",
                                     "--scene",         "--tags",
                                     "--object",        "--no-background-search",
                                     "--refine-map",    "--refine-camera",
                                     "--output",        "--poses",
                                     "--poses-all",     "--group-poses",
                                     "--report",        "--frame-log",
                                     "--save-scene",    "--threads",
                                     "--pixel-buffers", "--no-skip",
                                     "--no-window",     "--no-hud",
                                     "--fullscreen",    "--kiosk",
                                     "--reset-after",   "--config",
                                     "--no-vsync",      "--version",
                                     "--log-level"});

TEST(KeptOptions, ContainEachOptionOfLiveThatChangesImages) {
  ChosenCommand chosen;
  const std::unique_ptr<CLI::App> program = make_program(chosen);
  const CLI::App* live = program->get_subcommand("live");
  const CLI::App* replay = program->get_subcommand("replay");
  for (const CLI::Option* option : live->get_options()) {
    for (const std::string& word : option->get_lnames()) {
      const std::string name = "--" + word;
      const bool kept = std::ranges::count(kept_options(), name) > 0;
      const bool other = std::ranges::count(kOthers, name) > 0;
      EXPECT_NE(kept, other) << name << ": list it in kKeptOptions or in this test";
    }
  }
  for (const std::string name : kept_options()) {
    EXPECT_NE(live->get_option_no_throw(name), nullptr) << name;
    EXPECT_NE(replay->get_option_no_throw(name), nullptr) << name;
  }
}

}  // namespace
}  // namespace penumbra
