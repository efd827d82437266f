#include "app/window/viewer.hpp"

#include <gtest/gtest.h>

#include <deque>
#include <set>
#include <utility>

#include "app/window/overlay.hpp"
#include "render/gl/framebuffer.hpp"
#include "render/scene/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

constexpr int kEscape = 256;  // GLFW's key codes
constexpr int kSpace = 32;
constexpr int kPeriod = 46;
constexpr int kF11 = 300;
constexpr int kQ = 81;
constexpr int kX = 88;

WindowEvent key(int code) {
  WindowEvent event;
  event.code = code;
  return event;
}
WindowEvent pointer(WindowEvent::Kind kind, double x, double y, int button = 0) {
  WindowEvent event;
  event.kind = kind;
  event.code = button;
  event.x = x;
  event.y = y;
  return event;
}

// A window with scripted events, one entry per poll. An entry without a code has no event.
class ScriptedWindow final : public GlContext {
 public:
  explicit ScriptedWindow(std::deque<int> keys) {
    for (const int code : keys) events_.push_back(key(code));
  }
  explicit ScriptedWindow(std::deque<WindowEvent> events) : events_(std::move(events)) {}
  void make_current() override {}
  [[nodiscard]] bool poll_events() override {
    if (events_.empty()) return open;
    const WindowEvent event = events_.front();
    events_.pop_front();
    if (event.kind != WindowEvent::Kind::key_down || event.code != 0) handler_(event);
    return open;
  }
  void swap() override { ++swaps; }
  [[nodiscard]] Size window_size() const override { return size; }
  void on_event(std::function<void(const WindowEvent&)> handler) override {
    handler_ = std::move(handler);
  }
  void toggle_full_screen() override { full_screen = !full_screen; }
  void fill_screen() override { full_screen = true; }
  void keep_open() override { open = true; }
  void show_pointer(bool shown) override { pointer_shown = shown; }

  bool open = true;
  bool full_screen = false;
  bool pointer_shown = true;
  int swaps = 0;
  Size size{64, 48};

 private:
  std::deque<WindowEvent> events_;
  std::function<void(const WindowEvent&)> handler_;
};

class Host : public ViewerHost {
 public:
  void present() override { ++presented; }
  [[nodiscard]] SessionView view() const override { return shown; }
  [[nodiscard]] std::vector<HudNode> nodes() const override {
    ++hud_drawings;
    if (!has_shadows) return {};
    return {{"one", style}, {"two", style}};
  }
  void edit(const SceneEdit& edit) override { edits.push_back(edit); }
  [[nodiscard]] Translucency translucency() const override { return translucency_mode; }
  void set_translucency(Translucency asked) override { translucency_mode = asked; }
  void redraw() override { ++redrawn; }
  [[nodiscard]] bool is_over() const override { return presented >= ends_after; }
  [[nodiscard]] std::string save_screenshot() override {
    ++screenshots;
    return "saved";
  }
  [[nodiscard]] std::string toggle_recording() override {
    ++recordings;
    return "recording";
  }
  [[nodiscard]] std::string toggle_smoothing() override {
    ++smoothings;
    return "smoothed";
  }
  [[nodiscard]] std::string toggle_walls() override {
    calls.emplace_back("walls");
    return "hidden";
  }
  void begin_move(const std::string& object) override { calls.push_back("move " + object); }
  [[nodiscard]] std::string add_object(const std::filesystem::path& file) override {
    calls.push_back("add " + file.string());
    return "added";
  }
  [[nodiscard]] std::string undo() override {
    calls.emplace_back("undo");
    return "undone";
  }
  [[nodiscard]] std::string reset() override {
    calls.emplace_back("reset");
    return "reset";
  }
  void start_again() override { calls.emplace_back("start again"); }
  [[nodiscard]] std::string save_scene() override {
    calls.emplace_back("save");
    return "saved";
  }
  void describe(HudState& state, bool debug) const override {
    ++described;
    debug_asked = debug;
    state.has_image = true;
    state.trouble = trouble;
  }

  int presented = 0, redrawn = 0, screenshots = 0, recordings = 0, smoothings = 0;
  int ends_after = std::numeric_limits<int>::max();  // frames
  bool has_shadows = true;
  ShadowStyle style;
  Translucency translucency_mode = Translucency::automatic;
  SessionView shown;
  std::vector<SceneEdit> edits;
  std::vector<std::string> calls;
  mutable int described = 0;
  mutable int hud_drawings = 0;  // number of calls without node commands
  mutable bool debug_asked = false;
  std::optional<std::string> trouble;  // warning about the camera
};

TEST(Viewer, PresentsEachFrameOnce) {
  ScriptedWindow window(std::deque<int>{0, kX, 0});
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.presented, 3);
  EXPECT_EQ(window.swaps, 3);
  EXPECT_EQ(viewer.paused_ms(), 0.0);
}

TEST(Viewer, ClosesOnEscapeAndQ) {
  for (const int code : {kEscape, kQ}) {
    ScriptedWindow window(std::deque<int>{0, code});
    InterruptWatch interrupt;
    Host host;
    Viewer viewer(window, host, nullptr);
    EXPECT_TRUE(viewer.show(interrupt));
    EXPECT_FALSE(viewer.show(interrupt));
  }
}

TEST(Viewer, EndsWhenWindowIsClosed) {
  ScriptedWindow window(std::deque<int>{});
  window.open = false;
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  EXPECT_FALSE(viewer.show(interrupt));
}

TEST(Viewer, PausesUntilSpaceIsPressedAgain) {
  ScriptedWindow window(std::deque<int>{kSpace, 0, 0, kSpace, 0});
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(window.swaps, 4) << "the paused frame must be redrawn";
  EXPECT_GT(viewer.paused_ms(), 0.0);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(window.swaps, 5);
}

TEST(Viewer, EndsPauseWhenWindowCloses) {
  ScriptedWindow window(std::deque<int>{kSpace, 0, kEscape});
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  EXPECT_FALSE(viewer.show(interrupt));
}

TEST(Viewer, EndsPauseWhenRunEnds) {
  ScriptedWindow window(std::deque<int>{kSpace, 0, 0});
  InterruptWatch interrupt;
  Host host;
  host.ends_after = 3;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt)) << "the window was not closed";
  EXPECT_EQ(host.presented, 3);
}

TEST(Viewer, PresentsOneFramePerStep) {
  ScriptedWindow window(std::deque<int>{kPeriod, 0, kPeriod, kEscape});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(window.swaps, 1);
  EXPECT_TRUE(viewer.show(interrupt)) << "the viewer must wait for the second step";
  EXPECT_EQ(window.swaps, 3);
  EXPECT_FALSE(viewer.show(interrupt));
}

TEST(Viewer, ExecutesCommandsOfKeys) {
  ScriptedWindow window(std::deque<int>{'S', 'R', 'F', 300, '3', '0', 'N'});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.screenshots, 1);
  EXPECT_EQ(host.recordings, 1);
  EXPECT_TRUE(window.full_screen);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_FALSE(window.full_screen) << "F11";
  const auto last = [&] { return std::get<ShadowStyled>(host.edits.back()); };
  EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_EQ(host.edits.size(), 2U) << "the key must change both nodes";
  EXPECT_EQ(last().node, "two");
  EXPECT_EQ(last().style.technique, techniques_by_key()[2]);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(last().style.technique, ShadowTechnique::none);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(last().style.technique, technique_after(host.style.technique));
}

TEST(Viewer, IgnoresKeysWithoutTechniqueOrShadow) {
  for (const bool has_shadows : {true, false}) {
    std::deque<int> keys = {'7', '9', 328};  // 328: 8 of the keypad
    if (!has_shadows) keys = {'1', '0', 'N'};
    ScriptedWindow window(keys);
    Host host;
    host.has_shadows = has_shadows;
    InterruptWatch interrupt;
    Viewer viewer(window, host, nullptr);
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show(interrupt));
    EXPECT_TRUE(host.edits.empty());
  }
}

TEST(Viewer, EditsOneNodeOrAllByKey) {
  ScriptedWindow window(std::deque<int>{'G', '3', 'G', 'N', 'G', '1'});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  const auto last = [&] { return std::get<ShadowStyled>(host.edits.back()); };
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_EQ(host.edits.size(), 1U);
  EXPECT_EQ(last().node, "one");
  EXPECT_EQ(last().style.technique, techniques_by_key()[2]);
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_EQ(host.edits.size(), 2U);
  EXPECT_EQ(last().node, "two");
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_EQ(host.edits.size(), 4U) << "the last edit must change both nodes";
  EXPECT_EQ(last().style.technique, techniques_by_key()[0]);
}

TEST(Viewer, CyclesTranslucencyWithKeyM) {
  std::deque<int> keys(kTranslucencyNames.size(), 'M');
  ScriptedWindow window(keys);
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  std::set<Translucency> seen;
  for (std::size_t i = 0; i < kTranslucencyNames.size(); ++i) {
    EXPECT_TRUE(viewer.show(interrupt));
    seen.insert(host.translucency_mode);
  }
  EXPECT_EQ(seen.size(), kTranslucencyNames.size());
  EXPECT_EQ(host.translucency_mode, Translucency::automatic)
      << "the last key must return to the first mode";
  EXPECT_TRUE(host.edits.empty()) << "not a scene edit";
}

TEST(Viewer, TogglesSmoothingDuringPause) {
  ScriptedWindow window(std::deque<int>{'J', kSpace, 'J', 0, kSpace});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.smoothings, 1);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.smoothings, 2);
  EXPECT_EQ(host.redrawn, 1);
  EXPECT_TRUE(host.edits.empty()) << "not a scene edit";
}

TEST(Viewer, TogglesWallsAndRedrawsPausedFrame) {
  ScriptedWindow window(std::deque<int>{kSpace, 'L', 0, kSpace});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.calls, std::vector<std::string>{"walls"});
  EXPECT_EQ(host.redrawn, 1);
  EXPECT_TRUE(host.edits.empty()) << "not a scene edit";
}

TEST(Viewer, RedrawsOnceForChangeDuringPause) {
  ScriptedWindow window(std::deque<int>{kSpace, 0, '1', 0, 0, kSpace});
  Host host;
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.redrawn, 1);
}

TEST(Viewer, DragsObjectByMouseInLetterboxedWindow) {
  test::SceneBuilder builder;
  builder.add(test::finished(make_box({0.2F, 0.2F, 0.2F}), glm::vec4(1.0F)),
              test::at(0.0, 0.0, 0.1));
  const Scene& scene = builder.scene();
  const SceneState state = evaluate_scene(scene, 0.0);
  const CameraModel camera = test::camera_of(160, 120, 150.0);
  const CameraPose pose = test::look_at({0.0, -0.8, 0.8}, {0.0, 0.0, 0.1});
  // A window of twice the size, with borders of 40 px.
  const auto in_window = [&](const Eigen::Vector3d& p) {
    const Eigen::Vector2d pixel = camera.project(pose.inverse() * p).value();
    return Eigen::Vector2d(40.0 + 2.0 * (pixel.x() + 0.5), 2.0 * (pixel.y() + 0.5));
  };
  using Kind = WindowEvent::Kind;
  const Eigen::Vector2d from = in_window({0.0, 0.0, 0.2});
  const Eigen::Vector2d to = in_window({0.1, 0.05, 0.2});
  ScriptedWindow window(std::deque<WindowEvent>{
      pointer(Kind::button_down, from.x(), from.y()), pointer(Kind::pointer_moved, to.x(), to.y()),
      pointer(Kind::button_up, to.x(), to.y()), pointer(Kind::pointer_moved, from.x(), from.y())});
  window.size = {400, 240};
  Host host;
  host.shown = {&scene, &state, &camera, pose};
  InterruptWatch interrupt;
  Viewer viewer(window, host, nullptr);
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_GE(host.edits.size(), 2U);
  const auto position = [&](const SceneEdit& edit) {
    return std::get<ObjectPlaced>(edit).placement.position;
  };
  EXPECT_EQ(host.calls, std::vector<std::string>{"move object1"}) << "one undo reverts a drag";
  EXPECT_EQ(position(host.edits.front()), Eigen::Vector3d(0.0, 0.0, 0.1));
  EXPECT_LT((position(host.edits.back()) - Eigen::Vector3d(0.1, 0.05, 0.1)).norm(), 1e-5);
}

TEST(Viewer, AddsDroppedFilesAndRevertsByKeys) {
  WindowEvent dropped;
  dropped.kind = WindowEvent::Kind::file_dropped;
  dropped.file = "toys/boat.glb";
  WindowEvent control_z = key('Z');
  control_z.control = true;
  WindowEvent control_s = key('S');
  control_s.control = true;
  ScriptedWindow window(std::deque<WindowEvent>{dropped, key('U'), control_z, key('O'), key('W'),
                                                control_s, key('Z'), key('S')});
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.calls, (std::vector<std::string>{"add toys/boat.glb", "undo", "undo", "reset",
                                                  "save", "save"}));
  EXPECT_EQ(host.screenshots, 1) << "S without Ctrl";
}

// A paused image shows an added object at once.
TEST(Viewer, DrawsPausedFrameAgainAfterDrop) {
  WindowEvent dropped;
  dropped.kind = WindowEvent::Kind::file_dropped;
  dropped.file = "boat.glb";
  ScriptedWindow window(std::deque<WindowEvent>{key(kSpace), key(0), dropped, key(kSpace)});
  InterruptWatch interrupt;
  Host host;
  Viewer viewer(window, host, nullptr);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.redrawn, 1);
}

// Without the option, pointer motion changes no frame.
TEST(Viewer, MovesCursorWithPointerOnlyWhenEnabled) {
  test::SceneBuilder builder;
  builder.add(test::finished(make_box({0.02F, 0.02F, 0.02F}), glm::vec4(1.0F)),
              test::at(0.0, 0.0, 0.1));
  Scene& scene = builder.scene();
  const SceneState state = evaluate_scene(scene, 0.0);
  const CameraModel camera = test::camera_of(160, 120, 150.0);
  const CameraPose pose = test::look_at({0.0, -0.8, 0.8}, {0.0, 0.0, 0.1});
  const auto in_window = [&](const Eigen::Vector3d& p) {
    const Eigen::Vector2d pixel = camera.project(pose.inverse() * p).value();
    return Eigen::Vector2d(pixel.x() + 0.5, pixel.y() + 0.5);
  };
  using Kind = WindowEvent::Kind;
  const Eigen::Vector2d to = in_window({0.1, 0.05, 0.1});
  const auto move = pointer(Kind::pointer_moved, to.x(), to.y());
  const auto wheel = pointer(Kind::scrolled, 0.0, 2.0);
  const auto edits = [&](std::deque<WindowEvent> events) {
    const int count = static_cast<int>(events.size());
    ScriptedWindow window(std::move(events));
    window.size = {160, 120};
    Host host;
    host.shown = {&scene, &state, &camera, pose};
    InterruptWatch interrupt;
    Viewer viewer(window, host, nullptr);
    for (int i = 0; i < count; ++i) EXPECT_TRUE(viewer.show(interrupt));
    std::vector<Eigen::Vector3d> positions;
    for (const SceneEdit& edit : host.edits)
      positions.push_back(std::get<ObjectPlaced>(edit).placement.position);
    return positions;
  };
  EXPECT_TRUE(edits({key('K'), move}).empty()) << "the scene has no cursor";
  scene.objects[0].cursor = true;
  EXPECT_TRUE(edits({move, wheel}).empty());
  EXPECT_TRUE(edits({key('K'), key('K'), move}).empty());
  const auto followed = edits({key('K'), move, wheel});
  ASSERT_EQ(followed.size(), 2U);
  EXPECT_LT((followed[0] - Eigen::Vector3d(0.1, 0.05, 0.1)).norm(), 1e-5);
  EXPECT_NEAR(followed[1].z(), 0.11, 1e-9);
}

// Draws the actual HUD into a framebuffer of an offscreen context.
class ViewerWithHud : public testing::Test {
 protected:
  ViewerWithHud()
      : gl(create_offscreen_context().value()), target(Framebuffer::create(640, 480).value()) {
    target.bind();
  }
  std::unique_ptr<GlContext> gl;
  Framebuffer target;
  Host host;
  InterruptWatch interrupt;
};

TEST_F(ViewerWithHud, DrawsNoHudWhenHidden) {
  ScriptedWindow window(std::deque<int>{0, kX, 'H', 'D', 'H', 0});
  window.size = {640, 480};
  ViewerOptions options;
  options.hud = false;
  Viewer viewer(window, host, Overlay::create(*gl).value(), options);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.hud_drawings, 0);
  EXPECT_TRUE(viewer.show(interrupt)) << "H must show the HUD";
  EXPECT_EQ(host.hud_drawings, 1);
  EXPECT_FALSE(host.debug_asked);
  EXPECT_TRUE(viewer.show(interrupt)) << "D must add the debug view";
  EXPECT_TRUE(host.debug_asked);
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.hud_drawings, 2) << "H must hide the HUD again";
}

// A hidden HUD still shows warnings, because a frozen image must not look live.
TEST_F(ViewerWithHud, DrawsWarningsWhenHudIsHidden) {
  ScriptedWindow window(std::deque<int>{0, 0});
  window.size = {640, 480};
  ViewerOptions options;
  options.hud = false;
  Viewer viewer(window, host, Overlay::create(*gl).value(), options);
  const auto shown = [&] {
    target.clear();
    EXPECT_TRUE(viewer.show(interrupt));
    std::vector<std::uint8_t> rgba(std::size_t{4} * 640 * 480);
    target.read_rgba(rgba);
    int bright = 0;
    for (std::size_t i = 0; i < rgba.size(); i += 4) bright += rgba[i] > 128 ? 1 : 0;
    return bright;
  };
  EXPECT_EQ(shown(), 0);
  host.trouble = "unplugged";
  (void)shown();  // a window that fits its text is drawn one frame after it is measured
  EXPECT_GT(shown(), 50);
  EXPECT_EQ(host.hud_drawings, 0);
}

TEST_F(ViewerWithHud, ShowsHudAgainOnTouchInCorner) {
  ScriptedWindow window(
      std::deque<WindowEvent>{pointer(WindowEvent::Kind::button_down, 10.0, 10.0)});
  window.size = {640, 480};
  ViewerOptions options;
  options.hud = false;
  Viewer viewer(window, host, Overlay::create(*gl).value(), options);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.hud_drawings, 2);
}

// A click on a button must not pick the object under it.
TEST_F(ViewerWithHud, DoesNotPickObjectsUnderHudButtons) {
  test::SceneBuilder builder;
  builder.add(test::finished(make_box({2.0F, 2.0F, 0.1F}), glm::vec4(1.0F)), test::at(0, 0, 0));
  const Scene& scene = builder.scene();
  const SceneState state = evaluate_scene(scene, 0.0);
  const CameraModel camera = test::camera_of(640, 480, 500.0);
  host.shown = {&scene, &state, &camera, test::look_at({0.0, -0.4, 0.8}, {0.0, 0.0, 0.0})};
  using Kind = WindowEvent::Kind;
  const WindowEvent nothing = key(0);
  ScriptedWindow window(std::deque<WindowEvent>{
      nothing, nothing, pointer(Kind::button_down, 30.0, 20.0),
      pointer(Kind::button_up, 30.0, 20.0), nothing, nothing,
      pointer(Kind::button_down, 320.0, 150.0), pointer(Kind::button_up, 320.0, 150.0)});
  window.size = {640, 480};
  Viewer viewer(window, host, Overlay::create(*gl).value());
  for (int i = 0; i < 6; ++i) EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_TRUE(host.edits.empty()) << "the click was on the menu's button";
  EXPECT_TRUE(viewer.show(interrupt));
  ASSERT_FALSE(host.edits.empty());
  EXPECT_TRUE(std::holds_alternative<ObjectPlaced>(host.edits.back()));
}

WindowEvent unlocking_keys() {
  WindowEvent event = key('K');
  event.control = event.shift = true;
  return event;
}

ViewerOptions kiosk_options(double reset_after_s = 0.0) {
  ViewerOptions options;
  options.kiosk = true;
  options.reset_after_s = reset_after_s;
  return options;
}

TEST_F(ViewerWithHud, IgnoresKeysFilesAndClosingInLockedKiosk) {
  WindowEvent dropped;
  dropped.kind = WindowEvent::Kind::file_dropped;
  dropped.file = "toy.glb";
  ScriptedWindow window(std::deque<WindowEvent>{key(kEscape), key(kQ), key(kSpace), key('S'),
                                                key('R'), key('H'), key('P'), dropped});
  window.size = {640, 480};
  Viewer viewer(window, host, Overlay::create(*gl).value(), kiosk_options());
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(viewer.show(interrupt));
  window.open = false;
  EXPECT_TRUE(viewer.show(interrupt)) << "the window stays";
  EXPECT_TRUE(window.open);
  EXPECT_EQ(host.screenshots, 0);
  EXPECT_EQ(host.recordings, 0);
  EXPECT_EQ(host.hud_drawings, 0);
  EXPECT_TRUE(host.calls.empty());
  EXPECT_FALSE(window.pointer_shown);
}

TEST_F(ViewerWithHud, OpensKioskByItsKeys) {
  ScriptedWindow window(std::deque<WindowEvent>{unlocking_keys(), key('S'), key(kF11),
                                                unlocking_keys(), key('S'), key(kQ),
                                                unlocking_keys(), key(kQ)});
  window.size = {640, 480};
  window.full_screen = true;
  Viewer viewer(window, host, Overlay::create(*gl).value(), kiosk_options());
  for (int i = 0; i < 7; ++i) EXPECT_TRUE(viewer.show(interrupt)) << i;
  EXPECT_EQ(host.screenshots, 1);
  EXPECT_GT(host.hud_drawings, 0);
  EXPECT_TRUE(window.full_screen) << "F11 left full screen, and locking fills the screen again";
  EXPECT_FALSE(viewer.show(interrupt)) << "unlocked, Q quits";
}

TEST_F(ViewerWithHud, PutsEverythingBackWhenKioskIsLeftAlone) {
  ScriptedWindow window(std::deque<WindowEvent>{
      key(0), pointer(WindowEvent::Kind::button_down, 10.0, 10.0), unlocking_keys(), key('P')});
  window.size = {640, 480};
  Viewer viewer(window, host, Overlay::create(*gl).value(), kiosk_options(1e-9));
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_TRUE(host.calls.empty());
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.calls, std::vector<std::string>{"start again"});
  EXPECT_TRUE(viewer.show(interrupt));  // unlocks, and locks again at once
  EXPECT_TRUE(viewer.show(interrupt));
  EXPECT_EQ(host.calls.size(), 2U);
  EXPECT_EQ(host.hud_drawings, 0);
}

}  // namespace
}  // namespace penumbra
