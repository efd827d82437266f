#include "app/window/hud.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <set>

#include "render/shadow/layers/layered_penumbra.hpp"

namespace penumbra {
namespace {

TEST(Hud, NamesMissingCalibrationInPlaceOfUncertainLens) {
  HudState state;
  state.has_image = true;
  state.calibrated = false;
  state.pose.status = TrackStatus::uncertain;
  state.pose.reason = {PoseCause::uncertain_lens, 6.4};
  EXPECT_EQ(status_of(state).text, "not calibrated: press V to calibrate the camera");
  EXPECT_EQ(warnings_of(state).size(), 1U);
  state.pose.status = TrackStatus::lost;
  state.pose.reason = {PoseCause::no_tag};
  EXPECT_EQ(status_of(state).text, "lost: no tag of the table was found");
}

TEST(Hud, DistinguishesStatusByWordAndColour) {
  std::set<std::array<float, 3>> colors;
  PoseEstimate pose;
  pose.reason = {PoseCause::no_tag};
  for (const TrackStatus status :
       {TrackStatus::tracked, TrackStatus::uncertain, TrackStatus::held, TrackStatus::lost}) {
    pose.status = status;
    const HudStatus shown = status_of(pose);
    EXPECT_THAT(shown.text, testing::StartsWith(std::string(to_string(status))));
    EXPECT_EQ(shown.text.find("no tag of the table") != std::string::npos,
              status != TrackStatus::tracked);
    colors.insert({shown.color.red, shown.color.green, shown.color.blue});
  }
  EXPECT_EQ(colors.size(), 4U);
}

TEST(Hud, FadesCoastingPoseAndShowsItsAge) {
  PoseEstimate pose;
  pose.status = TrackStatus::held;
  pose.age_s = 0.1;
  const HudStatus young = status_of(pose);
  pose.age_s = 0.4;
  const HudStatus old = status_of(pose);
  EXPECT_GT(young.color.alpha, old.color.alpha);
  EXPECT_GT(old.color.alpha, 0.3F) << "must stay readable";
  EXPECT_THAT(old.text, testing::HasSubstr("0.40 s"));
}

TEST(Hud, PrefixesGroupStatusWithItsName) {
  GroupEstimate group;
  group.name = "wall";
  group.status = TrackStatus::tracked;
  EXPECT_EQ(status_of(group).text, "wall: tracked");
  group.status = TrackStatus::held;
  group.age_s = 0.25;
  group.reason = {PoseCause::group_not_seen};
  EXPECT_EQ(status_of(group).text, "wall: held 0.25 s: not seen");
}

TEST(Hud, ListsTechniquesOfNodes) {
  std::vector<HudNode> nodes(3);
  EXPECT_EQ(technique_text(nodes), "layered");
  nodes[1].style.kernels = KernelSource::centroid;
  nodes[2].style.technique = ShadowTechnique::simple;
  EXPECT_EQ(technique_text(nodes), "layered, cocl, simple");
  EXPECT_EQ(technique_text({}), "none");
}

// Converts the values of docs/shadows.md#constants in both directions.
TEST(Hud, RecoversWorkspaceFromConstants) {
  for (const double magnification : {1.25, 1.5, 2.0}) {
    const LayeredConstants constants = layered_constants_for_workspace(0.3, magnification).value();
    const auto workspace = workspace_of(constants);
    ASSERT_TRUE(workspace);
    EXPECT_NEAR(workspace->height_m, 0.3, 1e-12);
    EXPECT_NEAR(workspace->magnification, magnification, 1e-12);
  }
  EXPECT_FALSE(workspace_of(make_layered_constants(0.9, 0.8, 0.0).value()));
  const auto zenith = workspace_of(
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, 0.4).value());
  ASSERT_TRUE(zenith);
  EXPECT_EQ(zenith->magnification, 1.0);
}

TEST(Hud, InterpolatesOpacityFromNoneToFull) {
  const LightFractions full;
  EXPECT_EQ(with_opacity(full, 0.0).umbra, 1.0);
  EXPECT_DOUBLE_EQ(with_opacity(full, 1.0).umbra, full.umbra);
  EXPECT_DOUBLE_EQ(with_opacity(full, 0.5).penumbra, 0.5 * (1.0 + full.penumbra));
}

TEST(Hud, ShowsStateRateAndNextStepInOneLine) {
  HudState state;
  state.live = true;
  EXPECT_EQ(status_line_of(state).state.text, "no image yet");
  EXPECT_EQ(status_line_of(state).rate, "");
  state.has_image = true;
  state.frames_per_s = 29.8;
  const auto next = [&](TrackStatus status) {
    state.pose.status = status;
    return status_line_of(state).next;
  };
  EXPECT_EQ(next(TrackStatus::lost), "show the tags to the camera");
  EXPECT_EQ(next(TrackStatus::held), "keep the tags in view");
  EXPECT_EQ(next(TrackStatus::uncertain), "show more tags, or come closer");
  EXPECT_EQ(next(TrackStatus::tracked), "drag an object to move it");
  EXPECT_EQ(status_line_of(state).state.text, "tracked");
  EXPECT_EQ(status_line_of(state).rate, "30 frames/s");
  state.selected = "cube";
  state.drag = DragMode::lift;
  EXPECT_EQ(status_line_of(state).next, "dragging cube up and sideways: U undoes");
  state.recording = HudRecording{"session", 512, 0, std::nullopt};
  EXPECT_EQ(status_line_of(state).recording, "REC 512");
  EXPECT_FALSE(status_line_of(state).warns);
  state.calibrated = false;
  EXPECT_EQ(status_line_of(state).next, "V: calibrate the camera");
  state.paused = true;
  EXPECT_EQ(status_line_of(state).next, "space: go on");
  state.trouble = "unplugged";
  EXPECT_EQ(status_line_of(state).next, "camera: unplugged");
  state.recording->error = "no space left";
  EXPECT_EQ(status_line_of(state).next, "recording FAILED: no space left");
  EXPECT_TRUE(status_line_of(state).warns);
}

TEST(Hud, NamesEachMenuEntryByWhatItDoes) {
  HudState state;
  state.live = true;
  std::set<WindowCommand> commands;
  for (const MenuEntry& entry : menu_of(state)) {
    EXPECT_FALSE(entry.label.empty());
    EXPECT_GE(std::string(entry.longest).size(), std::min<std::size_t>(entry.label.size(), 15));
    EXPECT_TRUE(commands.insert(entry.command).second) << entry.label;
  }
  for (const WindowCommand command :
       {WindowCommand::help, WindowCommand::panels, WindowCommand::quit, WindowCommand::record}) {
    EXPECT_TRUE(commands.contains(command));
  }
  state.live = false;
  EXPECT_EQ(menu_of(state).size(), commands.size() - 2) << "no recording, no calibration";
}

TEST(Hud, MapsKeysToCommandsAndHelp) {
  std::string help;
  for (const KeyHelp& key : key_help()) help += std::string(key.keys) + " ";
  for (const char* name : {"F1", "H", "D", "P", "C", "S", "R", "F11", "Esc", "space", "B", "M"}) {
    EXPECT_THAT(help, testing::HasSubstr(name));
  }
  WindowEvent event;
  event.code = 'H';
  EXPECT_EQ(command_of_key(event), WindowCommand::hud);
  event.control = true;
  EXPECT_FALSE(command_of_key(event));
  event.control = false;
  event.kind = WindowEvent::Kind::key_up;
  EXPECT_FALSE(command_of_key(event));
  event.kind = WindowEvent::Kind::key_down;
  event.code = '0';
  EXPECT_EQ(technique_of_key(event), ShadowTechnique::none);
  event.code = '1';
  EXPECT_EQ(technique_of_key(event), techniques_by_key().front());
  event.code = '9';
  EXPECT_FALSE(technique_of_key(event));
  EXPECT_TRUE(is_number_key(event));
  event.code = 321;  // keypad 1
  EXPECT_EQ(technique_of_key(event), techniques_by_key().front());
  event.code = 'H';
  EXPECT_FALSE(is_number_key(event));
}

TEST(Hud, ListsTechniquesInHelpInOrderOfTheirKeys) {
  std::vector<std::string_view> names;
  for (const ShadowTechnique technique : techniques_by_key()) names.push_back(to_string(technique));
  const std::string line = fmt::format("shadows: {}; none", fmt::join(names, ", "));
  EXPECT_EQ(std::ranges::count(key_help(), line, &KeyHelp::what), 1) << line;
}

TEST(Hud, ListsReasonsForSkippedAndReusedParts) {
  HudState state;
  EXPECT_TRUE(reason_lines(state).empty());
  state.skipped = {"rotor: outside the view", "leaf: too high for an umbra"};
  state.kept = {"video: the frame is on the GPU already"};
  EXPECT_THAT(reason_lines(state),
              testing::ElementsAre("skipped: rotor: outside the view",
                                   "skipped: leaf: too high for an umbra",
                                   "kept: video: the frame is on the GPU already"));
  // The HUD shows at most kMaxReasons reasons.
  state.skipped.resize(kMaxReasons + 3, "leaf: outside the view");
  state.kept.resize(kMaxReasons, "floor: its mask is that of an earlier image");
  const std::vector<std::string> lines = reason_lines(state);
  ASSERT_EQ(lines.size(), 2 * kMaxReasons + 1);
  EXPECT_EQ(lines[kMaxReasons - 1], "skipped: leaf: outside the view");
  EXPECT_EQ(lines[kMaxReasons], "skipped: 3 more");
  EXPECT_EQ(lines.back(), "kept: floor: its mask is that of an earlier image");
}

TEST(Hud, FormatsTranslucency) {
  EXPECT_EQ(translucency_text(Translucency::mesh, Translucency::mesh), "mesh");
  EXPECT_EQ(translucency_text(Translucency::automatic, Translucency::retexture),
            "auto (retexture)");
  EXPECT_EQ(translucency_text(Translucency::automatic, Translucency::automatic), "auto");
}

TEST(Hud, CyclesThroughEveryTechnique) {
  std::set<ShadowTechnique> seen;
  ShadowTechnique technique = ShadowTechnique::none;
  for (std::size_t i = 0; i < techniques_by_key().size(); ++i) {
    technique = technique_after(technique);
    seen.insert(technique);
  }
  EXPECT_EQ(seen.size(), techniques_by_key().size());
  EXPECT_EQ(technique_after(technique), techniques_by_key().front());
}

}  // namespace
}  // namespace penumbra
