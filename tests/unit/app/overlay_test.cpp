// Draws the HUD offscreen, with both APIs.
#include "app/window/overlay.hpp"

#include <epoxy/gl.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <ostream>
#include <set>
#include <vector>

#include "core/image/image_file.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/scene/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

HudState busy_state() {
  HudState state;
  state.live = true;
  state.has_image = true;
  state.frame = 117;
  state.pose.status = TrackStatus::uncertain;
  state.pose.reason = {PoseCause::two_poses};
  state.pose.tags_used = 12;
  state.pose.reprojection_rms_px = 0.213;
  state.pose.predicted_overlay_error_px = 2.61;
  state.frames_per_s = 29.8;
  state.stages = {
      {"capture", 1.2}, {"track", 6.4}, {"align", 4.1}, {"shadow", 0.3}, {"render", 5.2}};
  state.latency_ms = 48.2;
  state.frames_dropped = 3;
  state.faults = {{"silent", 2}, {"gap", 14}};
  state.trouble = "the stream stalled";
  state.recording = HudRecording{"session", 512, 2, std::nullopt};
  state.nodes = {{"layers on the table", {}}};
  state.skipped = {"rotor: outside the view"};
  state.kept = {"video: the frame is on the GPU already"};
  state.twists = {{"helicopter", {2000, 12, 0.013}, 0.004}};
  state.work = {{"shadow_vertices", 8124}, {"kernel_generations", 3}, {"reprojections", 114}};
  state.selected = "helicopter";
  state.message = "screenshot saved: penumbra-20260131-142305.png";
  return state;
}

TEST(HudText, ShowsFrameAgeInPlaceOfLatency) {
  HudState state;
  EXPECT_EQ(age_text(state), "");
  EXPECT_TRUE(warnings_of(state).empty());
  state.latency_ms = 48.2;
  EXPECT_EQ(age_text(state), "latency 48 ms");
  EXPECT_TRUE(warnings_of(state).empty());
  state.stalled_s = 3.21;
  EXPECT_EQ(age_text(state), "the frame is 3.2 s old");
  EXPECT_EQ(warnings_of(state).size(), 1U);
  state.recording = HudRecording{"session", 26, 0, std::nullopt};
  EXPECT_EQ(recording_text(*state.recording), "REC session   26 frames");
  EXPECT_EQ(warnings_of(state).size(), 1U);
  state.recording = HudRecording{"session", 26, 40, "no space left"};
  EXPECT_EQ(recording_text(*state.recording), "recording FAILED: session   26 frames, 40 dropped");
  EXPECT_EQ(warnings_of(state).back(), "no space left");
}

struct Shot {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

// Draws the HUD on a grey window; rows run from the top.
Shot shoot(Overlay& overlay, const HudState& state, const HudPanels& panels, int width, int height,
           HudActions& actions) {
  const auto framebuffer = Framebuffer::create(width, height).value();
  framebuffer.bind();
  glClearColor(0.6F, 0.6F, 0.6F, 1.0F);
  glClear(GL_COLOR_BUFFER_BIT);
  overlay.draw(state, panels, {width, height}, actions);
  Shot shot{width, height, {}};
  std::vector<std::uint8_t> upside_down(static_cast<std::size_t>(width * height * 4));
  framebuffer.read_rgba(upside_down);
  const std::ptrdiff_t row = std::ptrdiff_t{4} * width;
  for (std::ptrdiff_t y = height - 1; y >= 0; --y) {
    shot.rgba.insert(shot.rgba.end(), upside_down.begin() + y * row,
                     upside_down.begin() + (y + 1) * row);
  }
  return shot;
}

// Draws the HUD only for its actions. Rasterization, the slowest part with software OpenGL, is off.
void act(Overlay& overlay, const HudState& state, const HudPanels& panels, int width, int height,
         HudActions& actions) {
  const auto framebuffer = Framebuffer::create(1, 1).value();
  framebuffer.bind();
  glEnable(GL_RASTERIZER_DISCARD);
  overlay.draw(state, panels, {width, height}, actions);
  glDisable(GL_RASTERIZER_DISCARD);
}

std::size_t changed_pixels(const Shot& shot) {
  std::size_t changed = 0;
  for (std::size_t i = 0; i < shot.rgba.size(); i += 4) {
    changed += shot.rgba[i] != 153 || shot.rgba[i + 1] != 153 || shot.rgba[i + 2] != 153 ? 1U : 0U;
  }
  return changed;
}

// Saves the image for inspection if PENUMBRA_HUD_IMAGES=FOLDER is set.
void save_for_inspection(const Shot& shot, const std::string& name) {
  const char* folder = std::getenv("PENUMBRA_HUD_IMAGES");
  if (folder == nullptr) return;
  const auto file = std::filesystem::path(folder) / (name + ".png");
  ASSERT_TRUE(save_png(file, shot.width, shot.height, shot.rgba));
}

class HudOverlay : public testing::TestWithParam<GlApi> {
 protected:
  HudOverlay() : context(create_offscreen_context(GetParam()).value()) {
    overlay = Overlay::create(*context).value();
  }
  [[nodiscard]] std::string prefix() const { return GetParam() == GlApi::gl33 ? "gl-" : "gles-"; }
  std::unique_ptr<GlContext> context;
  std::unique_ptr<Overlay> overlay;
};

TEST_P(HudOverlay, DrawsEveryLayoutAndKeepsFrameVisible) {
  struct Case {
    const char* name;
    int width, height;
    HudPanels panels;
    double max_fraction;  // maximum fraction of the window that the HUD covers
  };
  const std::vector<Case> cases = {
      {"full-1280x720", 1280, 720, {}, 0.35},
      {"full-panels-debug-1280x720", 1280, 720, {false, true, true, false}, 0.75},
      {"full-help-1280x720", 1280, 720, {true, false, false, false}, 0.8},
      {"compact-640x480", 640, 480, {false, false, false, true}, 0.45},
      {"compact-panels-640x480", 640, 480, {false, false, true, true}, 0.95},
      {"compact-debug-640x480", 640, 480, {false, true, false, true}, 0.95},
      {"compact-help-640x480", 640, 480, {true, false, false, true}, 1.0},
      {"compact-480x320", 480, 320, {false, false, false, true}, 0.6},
      {"compact-panels-480x320", 480, 320, {false, false, true, true}, 0.95},
      {"compact-help-480x320", 480, 320, {true, false, false, true}, 1.0},
      {"compact-320x480", 320, 480, {false, false, false, true}, 0.65},
      {"compact-panels-320x480", 320, 480, {false, false, true, true}, 1.0},
      {"compact-help-320x480", 320, 480, {true, false, false, true}, 1.0},
      {"full-640x480", 640, 480, {}, 0.6},
      {"full-1920x1080", 1920, 1080, {}, 0.3},
  };
  for (const Case& layout : cases) {
    HudActions actions;
    // The layout sizes are final in the second drawing.
    shoot(*overlay, busy_state(), layout.panels, layout.width, layout.height, actions);
    const Shot shot =
        shoot(*overlay, busy_state(), layout.panels, layout.width, layout.height, actions);
    const double fraction =
        static_cast<double>(changed_pixels(shot)) / (layout.width * layout.height);
    EXPECT_GT(fraction, 0.02) << layout.name;
    EXPECT_LT(fraction, layout.max_fraction) << layout.name;
    EXPECT_TRUE(actions.commands.empty() && actions.edits.empty()) << layout.name;
    save_for_inspection(shot, prefix() + layout.name);
  }
}

// The debug view shows the image scaled into a window of another aspect ratio.
TEST_P(HudOverlay, DrawsKernelsAsDotsInDebugView) {
  HudState state;
  state.has_image = true;
  state.image_width = 320;
  state.image_height = 240;
  state.kernels_px = {{159.5, 119.5}, {300.0, 200.0}};
  HudActions actions;
  const auto bluish = [](const Shot& shot, int x, int y) {
    const std::uint8_t* p = shot.rgba.data() + 4 * (y * shot.width + x);
    return p[2] > p[0] + 50;
  };
  for (const bool debug : {true, false}) {
    HudPanels panels;
    panels.debug = debug;
    shoot(*overlay, state, panels, 1280, 720, actions);
    const Shot shot = shoot(*overlay, state, panels, 1280, 720, actions);
    // The image fills 960 x 720 in the middle: 3 x 3 window pixels for each image pixel.
    EXPECT_EQ(bluish(shot, 160 + 480, 360), debug);
    EXPECT_EQ(bluish(shot, 160 + 901, 601), debug);
    EXPECT_FALSE(bluish(shot, 160 + 480, 380));
    if (debug) save_for_inspection(shot, prefix() + "kernels-1280x720");
  }
}

// The debug view, and only it, has a line for each skipped or reused part.
TEST_P(HudOverlay, ListsSkippedAndReusedPartsInDebugViewOnly) {
  HudState plain = busy_state();
  plain.skipped.clear();
  plain.kept.clear();
  HudState with_skipped = plain;
  with_skipped.skipped = {"rotor: outside the view"};
  HudState kept = plain;
  kept.kept = {"video: the frame is on the GPU already"};
  HudState both = with_skipped;
  both.kept = kept.kept;
  const auto shot_of = [&](const HudState& state, bool debug) {
    HudPanels panels;
    panels.debug = debug;
    HudActions actions;
    shoot(*overlay, state, panels, 1280, 720, actions);
    return shoot(*overlay, state, panels, 1280, 720, actions);
  };
  // Lower end of the debug view: the last row in which the pixel at x = 60 is not the image's grey.
  const auto bottom = [](const Shot& shot) {
    int last = 0;
    for (int y = 0; y < shot.height * 3 / 4; ++y) {
      const std::uint8_t* p = shot.rgba.data() + 4 * (y * shot.width + 60);
      if (p[0] != 153 || p[1] != 153 || p[2] != 153) last = y;
    }
    return last;
  };
  const int without = bottom(shot_of(plain, true));
  const int line = bottom(shot_of(with_skipped, true)) - without;
  EXPECT_GT(line, 8) << "height of a line [px]";
  EXPECT_EQ(bottom(shot_of(kept, true)), without + line);
  EXPECT_EQ(bottom(shot_of(both, true)), without + 2 * line);
  EXPECT_NE(shot_of(kept, true).rgba, shot_of(with_skipped, true).rgba)
      << "skipped and reused parts must have different texts";
  EXPECT_EQ(shot_of(both, false).rgba, shot_of(plain, false).rgba);
  save_for_inspection(shot_of(both, true), prefix() + "reasons-1280x720");
}

TEST_P(HudOverlay, TurnsClickShorterThanFrameIntoCommand) {
  HudActions actions;
  HudPanels panels;
  panels.compact = true;
  shoot(*overlay, busy_state(), panels, 640, 480, actions);
  shoot(*overlay, busy_state(), panels, 640, 480, actions);
  // The buttons fill the lowest row over its whole width; the first one changes the technique.
  WindowEvent event;
  event.x = 30.0;
  event.y = 460.0;
  EXPECT_TRUE(overlay->covers(event.x, event.y));
  EXPECT_FALSE(overlay->covers(320.0, 300.0)) << "the HUD must not cover the image's centre";
  event.kind = WindowEvent::Kind::button_down;
  overlay->handle(event);
  event.kind = WindowEvent::Kind::button_up;
  overlay->handle(event);
  for (int i = 0; i < 3; ++i) shoot(*overlay, busy_state(), panels, 640, 480, actions);
  ASSERT_EQ(actions.commands.size(), 1U);
  EXPECT_EQ(actions.commands[0], WindowCommand::next_technique);
}

// For touch screens, the help of the compact layout has buttons to leave full screen and to quit.
TEST_P(HudOverlay, OffersFullScreenAndQuitButtonsInCompactHelp) {
  constexpr int kWidth = 480;
  constexpr int kHeight = 320;
  constexpr int kStep_px = 24;
  HudPanels panels;
  panels.compact = panels.help = true;
  std::set<WindowCommand> found;
  for (int i = 0; i < 2; ++i) {
    HudActions actions;
    act(*overlay, busy_state(), panels, kWidth, kHeight, actions);
  }
  for (int y = kStep_px / 2; y < kHeight; y += kStep_px) {
    for (int x = kStep_px / 2; x < kWidth; x += kStep_px) {
      if (!overlay->covers(x, y)) continue;
      WindowEvent event;
      event.x = x;
      event.y = y;
      event.kind = WindowEvent::Kind::button_down;
      overlay->handle(event);
      event.kind = WindowEvent::Kind::button_up;
      overlay->handle(event);
      HudActions actions;
      for (int i = 0; i < 3; ++i) {
        HudPanels shown = panels;  // the panels that are open in this case
        act(*overlay, busy_state(), shown, kWidth, kHeight, actions);
      }
      found.insert(actions.commands.begin(), actions.commands.end());
    }
  }
  EXPECT_TRUE(found.contains(WindowCommand::full_screen));
  EXPECT_TRUE(found.contains(WindowCommand::quit));
  EXPECT_TRUE(found.contains(WindowCommand::help)) << "a touch must also close the help";
}

// A study's participant sees the instructions and no controls.
TEST_P(HudOverlay, ReplacesHudByStudyInstructions) {
  HudActions actions;
  shoot(*overlay, busy_state(), {}, 640, 480, actions);
  for (const bool in_the_middle : {true, false}) {
    const auto framebuffer = Framebuffer::create(640, 480).value();
    framebuffer.bind();
    Shot shot{640, 480, std::vector<std::uint8_t>(std::size_t{640} * 480 * 4)};
    for (int drawing = 0; drawing < 2; ++drawing) {  // sizes are final in the second drawing
      glClearColor(0.6F, 0.6F, 0.6F, 1.0F);
      glClear(GL_COLOR_BUFFER_BIT);
      overlay->draw_text("Click on the highest sphere", in_the_middle, {640, 480});
      framebuffer.read_rgba(shot.rgba);
    }
    const std::size_t changed = changed_pixels(shot);
    EXPECT_GT(changed, 500U);
    EXPECT_LT(changed, 640U * 480U / 20U);
    const auto is_changed = [&](std::size_t x, std::size_t y_from_below) {
      return shot.rgba[(y_from_below * 640 + x) * 4] != 153;
    };
    EXPECT_EQ(is_changed(320, 240), in_the_middle);
    EXPECT_EQ(is_changed(14, 480 - 14), !in_the_middle);
    EXPECT_FALSE(overlay->covers(30.0, 460.0)) << "the HUD's buttons must be hidden";
  }
}

// Settings that change when the pointer drags near the left end of the open panel, tried at every
// height. Dragging inside an input box changes its value too.
struct DraggedSettings {
  bool constants = false;
  bool strength = false, umbra = false, middle = false, penumbra = false;
  bool rays = false;
  bool operator==(const DraggedSettings&) const = default;
};
std::ostream& operator<<(std::ostream& out, const DraggedSettings& s) {
  return out << "constants " << s.constants << ", strength " << s.strength << ", light in umbra "
             << s.umbra << ", in middle " << s.middle << ", in penumbra " << s.penumbra << ", rays "
             << s.rays;
}
DraggedSettings drag_along_panel(Overlay& overlay, const HudState& state) {
  HudActions actions;
  HudPanels panels;
  panels.panels = true;
  const auto draw = [&] { act(overlay, state, panels, 640, 400, actions); };
  draw();
  draw();
  WindowEvent event;
  for (int y = 20; y < 360; y += 8) {
    event.y = y;
    event.x = 368.0;
    event.kind = WindowEvent::Kind::pointer_moved;
    overlay.handle(event);
    draw();
    event.kind = WindowEvent::Kind::button_down;
    overlay.handle(event);
    draw();
    event.kind = WindowEvent::Kind::pointer_moved;
    event.x = 398.0;
    overlay.handle(event);
    draw();
    event.kind = WindowEvent::Kind::button_up;
    overlay.handle(event);
    draw();
  }
  DraggedSettings changed;
  for (const SceneEdit& edit : actions.edits) {
    const auto& style = std::get<ShadowStyled>(edit).style;
    EXPECT_EQ(std::get<ShadowStyled>(edit).node, "layers on the table");
    changed.constants |= style.layered.light_height != LayeredConstants().light_height;
    const LightFractions full;
    const auto differ = [](double a, double b) { return std::abs(a - b) > 1e-6; };
    const bool umbra = differ(style.fractions.umbra, full.umbra);
    const bool middle = differ(style.fractions.middle, full.middle);
    const bool penumbra = differ(style.fractions.penumbra, full.penumbra);
    changed.strength |= umbra && middle && penumbra;
    changed.umbra |= umbra && !middle;
    changed.middle |= middle && !umbra;
    changed.penumbra |= penumbra && !middle;
    changed.rays |= style.light_rays;
  }
  return changed;
}

DraggedSettings settings_that_act(ShadowTechnique technique) {
  switch (technique) {
    case ShadowTechnique::none:
      return {};
    case ShadowTechnique::simple:
    case ShadowTechnique::walls:
      return {.strength = true, .middle = true};
    case ShadowTechnique::layered:
    case ShadowTechnique::field:
      return {.constants = true, .strength = true, .umbra = true, .middle = true, .penumbra = true};
    case ShadowTechnique::hard:
    case ShadowTechnique::volume:
      return {.rays = true};
  }
  return {};
}

TEST_P(HudOverlay, ShowsExactlyTheSettingsThatActOnTechnique) {
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    HudState state = busy_state();
    for (HudNode& node : state.nodes) node.style.technique = technique;
    EXPECT_EQ(drag_along_panel(*overlay, state), settings_that_act(technique)) << name;
  }
}

// Clicks down the panel until the list of modes opens, then selects each mode from it.
TEST_P(HudOverlay, SelectsEveryTranslucencyFromList) {
  HudPanels panels;
  panels.panels = true;
  HudState state = busy_state();
  state.nodes.clear();  // the list is then the only control to click
  std::set<Translucency> chosen;
  for (int row = 0; row < 12; ++row) {
    HudActions actions;
    const auto draw = [&] { act(*overlay, state, panels, 1280, 720, actions); };
    const auto click = [&](int y) {
      WindowEvent event;
      event.x = 1150.0;
      event.y = y;
      for (const auto kind : {WindowEvent::Kind::pointer_moved, WindowEvent::Kind::button_down,
                              WindowEvent::Kind::button_up}) {
        event.kind = kind;
        overlay->handle(event);
        draw();
      }
      draw();
    };
    draw();
    click(30);
    click(50 + 12 * row);
    if (actions.translucency) {
      state.translucency = *actions.translucency;
      chosen.insert(*actions.translucency);
    }
    EXPECT_TRUE(actions.edits.empty());
    click(700);  // closes the open list
  }
  EXPECT_EQ(chosen.size(), kTranslucencyNames.size());
}

TEST_P(HudOverlay, KeepsFrameUnderneathUnchanged) {
  test::SceneBuilder builder;
  builder.add(test::finished(make_box({0.1F, 0.1F, 0.1F}), glm::vec4(0.8F, 0.2F, 0.1F, 1.0F)),
              test::at(0, 0, 0.1));
  builder.scene().shadows[0].technique = ShadowTechnique::field;
  const CameraModel camera = test::camera_of(320, 240, 300.0);
  auto compositor = Compositor::create(*context, builder.build(), camera).value();
  const PoseEstimate pose = test::tracked(test::look_at({0.1, -0.4, 0.5}, {0, 0, 0}));
  const auto plan = plan_frame(builder.scene(), evaluate_scene(builder.scene(), 0.0), pose, camera);
  const auto draw = [&] {
    std::vector<std::uint8_t> rgba(std::size_t{320} * 240 * 4);
    EXPECT_TRUE(compositor.draw(test::plain_frame(320, 240, 180), plan));
    EXPECT_TRUE(compositor.read_back(rgba));
    return rgba;
  };
  const auto before = draw();
  HudActions actions;
  for (int i = 0; i < 3; ++i) {
    shoot(*overlay, busy_state(), {true, true, true, i == 1}, 640, 480, actions);
    EXPECT_EQ(draw(), before);
  }
}

INSTANTIATE_TEST_SUITE_P(BothApis, HudOverlay, testing::Values(GlApi::gl33, GlApi::gles30),
                         [](const auto& api) {
                           return api.param == GlApi::gl33 ? "Gl33" : "Gles30";
                         });

}  // namespace
}  // namespace penumbra
