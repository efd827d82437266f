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
      {"line-320x240", 320, 240, {.compact = true}, 0.1},
      {"line-320x480", 320, 480, {.compact = true}, 0.1},
      {"line-480x320", 480, 320, {.compact = true}, 0.1},
      {"line-640x480", 640, 480, {.compact = true}, 0.1},
      {"line-800x480", 800, 480, {.compact = true}, 0.1},
      {"line-1280x800", 1280, 800, {}, 0.1},
      {"line-1920x1080", 1920, 1080, {}, 0.1},
      {"line-3840x2160", 3840, 2160, {}, 0.1},
      {"menu-1280x800", 1280, 800, {.menu = true}, 0.15},
      {"menu-3840x2160", 3840, 2160, {.menu = true}, 0.15},
      {"details-1280x800", 1280, 800, {.details = true}, 0.3},
      {"panels-debug-1280x800", 1280, 800, {.debug = true, .panels = true}, 0.75},
      {"help-1280x800", 1280, 800, {.help = true}, 0.8},
      {"all-1280x800",
       1280,
       800,
       {.debug = true, .panels = true, .details = true, .menu = true},
       0.85},
      {"menu-800x480", 800, 480, {.menu = true, .compact = true}, 0.5},
      {"panels-800x480", 800, 480, {.panels = true, .compact = true}, 0.65},
      {"details-800x480", 800, 480, {.details = true, .compact = true}, 0.65},
      {"help-800x480", 800, 480, {.help = true, .compact = true}, 1.0},
      {"menu-640x480", 640, 480, {.menu = true, .compact = true}, 0.6},
      {"panels-640x480", 640, 480, {.panels = true, .compact = true}, 0.95},
      {"debug-640x480", 640, 480, {.debug = true, .compact = true}, 0.95},
      {"help-640x480", 640, 480, {.help = true, .compact = true}, 1.0},
      {"menu-480x320", 480, 320, {.menu = true, .compact = true}, 0.72},
      {"panels-480x320", 480, 320, {.panels = true, .compact = true}, 0.95},
      {"help-320x480", 320, 480, {.help = true, .compact = true}, 1.0},
  };
  for (const Case& layout : cases) {
    HudActions actions;
    HudState state = busy_state();
    state.message.clear();  // disappears after some seconds
    // The layout sizes are final in the second drawing.
    shoot(*overlay, state, layout.panels, layout.width, layout.height, actions);
    const Shot shot = shoot(*overlay, state, layout.panels, layout.width, layout.height, actions);
    const double fraction =
        static_cast<double>(changed_pixels(shot)) / (layout.width * layout.height);
    EXPECT_GT(fraction, 0.004) << layout.name;
    EXPECT_LE(fraction, layout.max_fraction) << layout.name;
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
  // The button of the menu is in the top left corner.
  WindowEvent event;
  event.x = 30.0;
  event.y = 20.0;
  EXPECT_TRUE(overlay->covers(event.x, event.y));
  EXPECT_FALSE(overlay->covers(320.0, 300.0)) << "the HUD must not cover the image's centre";
  event.kind = WindowEvent::Kind::button_down;
  overlay->handle(event);
  event.kind = WindowEvent::Kind::button_up;
  overlay->handle(event);
  for (int i = 0; i < 3; ++i) shoot(*overlay, busy_state(), panels, 640, 480, actions);
  ASSERT_EQ(actions.commands.size(), 1U);
  EXPECT_EQ(actions.commands[0], WindowCommand::menu);
}

// Each button of the menu can be hit, on small and large screens.
TEST_P(HudOverlay, ReachesEveryCommandOfMenuByClicks) {
  constexpr int kStep_px = 12;
  for (const auto& [width, height] : {std::pair(480, 320), std::pair(1280, 800)}) {
    HudPanels panels;
    panels.compact = width < 800;
    panels.menu = true;
    for (int i = 0; i < 2; ++i) {
      HudActions actions;
      act(*overlay, busy_state(), panels, width, height, actions);
    }
    std::set<WindowCommand> found;
    for (int y = 50; y < height; y += kStep_px) {
      for (int x = kStep_px / 2; x < width; x += 3 * kStep_px) {
        if (!overlay->covers(x, y)) continue;
        HudActions actions;
        WindowEvent event;
        event.x = x;
        event.y = y;
        for (const auto kind : {WindowEvent::Kind::button_down, WindowEvent::Kind::button_up}) {
          event.kind = kind;
          overlay->handle(event);
          act(*overlay, busy_state(), panels, width, height, actions);
        }
        found.insert(actions.commands.begin(), actions.commands.end());
      }
    }
    for (const MenuEntry& entry : menu_of(busy_state()))
      EXPECT_TRUE(found.contains(entry.command)) << entry.label << " at " << width;
  }
}

// Arrow keys move the keyboard focus through the menu, and Enter presses.
TEST_P(HudOverlay, PressesMenuButtonsByKeyboard) {
  constexpr int kRight = 262;  // GLFW's key codes
  constexpr int kEnter = 257;
  constexpr int kSpace = 32;
  HudPanels panels;
  HudActions actions;
  const auto draw = [&] { act(*overlay, busy_state(), panels, 1280, 800, actions); };
  const auto press = [&](int code) {
    WindowEvent event;
    event.code = code;
    event.kind = WindowEvent::Kind::key_down;
    overlay->handle(event);
    draw();
    event.kind = WindowEvent::Kind::key_up;
    overlay->handle(event);
    draw();
  };
  draw();
  EXPECT_FALSE(overlay->takes_key(kSpace)) << "without focus the space bar pauses";
  panels.menu = true;
  draw();
  draw();
  for (int i = 0; i < 3; ++i) press(kRight);
  EXPECT_TRUE(overlay->takes_key(kSpace));
  EXPECT_TRUE(overlay->takes_key(kEnter));
  EXPECT_FALSE(overlay->takes_key('N')) << "letters are commands even then";
  ASSERT_TRUE(actions.commands.empty());
  press(kEnter);
  ASSERT_EQ(actions.commands.size(), 1U);
  const auto entries = menu_of(busy_state());
  const auto is_pressed = [&](const MenuEntry& entry) {
    return entry.command == actions.commands.front();
  };
  const auto first = std::ranges::find_if(entries, is_pressed);
  ASSERT_NE(first, entries.end());
  press(kRight);
  press(kEnter);
  ASSERT_EQ(actions.commands.size(), 2U);
  EXPECT_EQ(actions.commands.back(), (first + 1)->command);
}

// A visitor of a kiosk sees the image, warnings, and one button for fingers.
TEST_P(HudOverlay, DrawsOnlyDragButtonInKiosk) {
  HudState state = busy_state();
  state.trouble.reset();
  state.recording.reset();
  state.message.clear();
  state.locked = true;
  const auto drawn = [&] {
    const auto framebuffer = Framebuffer::create(800, 480).value();
    Shot shot{800, 480, std::vector<std::uint8_t>(std::size_t{800} * 480 * 4)};
    HudActions actions;
    for (int drawing = 0; drawing < 2; ++drawing) {
      framebuffer.bind();
      glClearColor(0.6F, 0.6F, 0.6F, 1.0F);
      glClear(GL_COLOR_BUFFER_BIT);
      overlay->draw_kiosk(state, {800, 480}, actions);
    }
    framebuffer.read_rgba(shot.rgba);
    return changed_pixels(shot);
  };
  const std::size_t quiet = drawn();
  EXPECT_GT(quiet, 500U);
  EXPECT_LE(quiet, 800U * 480U / 20U);
  state.trouble = "unplugged";
  EXPECT_GT(drawn(), quiet + 200U);
  state.trouble.reset();
  HudActions actions;
  const auto press = [&](double x, double y) {
    WindowEvent event;
    event.x = x;
    event.y = y;
    actions = {};
    for (const auto kind : {WindowEvent::Kind::button_down, WindowEvent::Kind::button_up}) {
      event.kind = kind;
      overlay->handle(event);
      overlay->draw_kiosk(state, {800, 480}, actions);
    }
  };
  press(780.0, 460.0);
  ASSERT_EQ(actions.commands.size(), 1U);
  EXPECT_EQ(actions.commands[0], WindowCommand::lift);
  state.drag = DragMode::lift;
  press(780.0, 460.0);
  ASSERT_EQ(actions.commands.size(), 1U);
  EXPECT_EQ(actions.commands[0], WindowCommand::slide);
  press(20.0, 20.0);
  EXPECT_TRUE(actions.commands.empty());
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
    click(72);
    click(92 + 12 * row);
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
