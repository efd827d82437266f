// Added objects, undo and reset in a session.
#include "app/session/edit_history.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "app/run/session_host.hpp"
#include "render/scene/shapes.hpp"
#include "support/paths.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

using testing::HasSubstr;

constexpr int kImageWidth = 160;
constexpr int kImageHeight = 120;

std::string model_file() {
  return (test::source_dir() / "scenes/models/helicopter.glb").string();
}

class History : public testing::Test {
 protected:
  History() {
    builder.add(test::finished(make_box({0.1F, 0.06F, 0.04F}), glm::vec4(1.0F)),
                test::at(-0.1, 0.0, 0.1));
    builder.scene().objects[0].animation.spin_turns_per_s = 0.01;
    context = create_offscreen_context().value();
    session.emplace(start_session());
  }

  [[nodiscard]] Session start_session() const {
    Trajectory poses;
    for (int i = 0; i < 30; ++i) {
      poses.poses.push_back({i * 1'000'000'000LL, test::look_at({0.1, -0.5, 0.5}, {0, 0, 0}), {}});
    }
    return Session::create(*context, builder.build(), camera, GivenPoses{std::move(poses), {}}, {})
        .value();
  }

  SessionFrame step() { return step(*session, frame_number++); }
  SessionFrame step(Session& of, int number) {
    Frame frame = test::plain_frame(kImageWidth, kImageHeight, 200);
    frame.timestamp_ns = 1'000'000'000LL * number;
    image.assign(static_cast<std::size_t>(kImageWidth) * kImageHeight * 4, 0);
    return of.draw(of.track(frame), image).value();
  }
  [[nodiscard]] const SceneObject& object(std::size_t index) const {
    return session->view().scene->objects[index];
  }
  void move(const std::string& name, double x) {
    history.begin_move(*session, name);
    ASSERT_TRUE(session->edit(ObjectPlaced{name, test::at(0.5 * x, 0.0, 0.1), false}));
    ASSERT_TRUE(session->edit(ObjectPlaced{name, test::at(x, 0.0, 0.1), false}));
  }
  [[nodiscard]] ObjectAdded toy() const {
    return {"toy", model_file(), test::at(0.1, 0.0, 0.05),
            std::make_shared<const Model>(load_model(model_file()).value())};
  }

  test::SceneBuilder builder;
  CameraModel camera = test::camera_of(kImageWidth, kImageHeight, 140.0);
  std::unique_ptr<GlContext> context;
  std::optional<Session> session;
  EditHistory history;
  std::vector<std::uint8_t> image;
  int frame_number = 0;
};

TEST_F(History, RevertsMovesInReverseOrder) {
  move("object1", 0.2);
  move("object1", 0.3);
  EXPECT_THAT(history.undo(*session), HasSubstr("object1"));
  EXPECT_EQ(object(0).placement.position.x(), 0.2);
  EXPECT_THAT(history.undo(*session), HasSubstr("object1"));
  EXPECT_EQ(object(0).placement.position.x(), -0.1);
  EXPECT_NE(object(0).animation.spin_turns_per_s, 0.0) << "the animation goes on";
  EXPECT_EQ(history.undo(*session), "nothing to undo");
}

TEST_F(History, StartsAgainWithoutUndo) {
  ASSERT_TRUE(session->edit(toy()));
  history.note_added("toy");
  move("object1", 0.3);
  history.start_again(*session);
  EXPECT_EQ(object(0).placement.position.x(), -0.1);
  EXPECT_TRUE(object(1).removed);
  EXPECT_EQ(history.undo(*session), "nothing to undo");
}

TEST_F(History, KeepsThousandChanges) {
  for (int i = 1; i <= 1002; ++i) move("object1", 0.001 * i);
  int undone = 0;
  while (history.undo(*session) != "nothing to undo") ++undone;
  EXPECT_EQ(undone, 1000);
  EXPECT_NEAR(object(0).placement.position.x(), 0.002, 1e-12) << "the oldest changes are forgotten";
}

// The host of a kiosk puts shadows and the view back, too.
TEST_F(History, HostStartsAgainWithFirstStylesAndView) {
  step();
  RunRecorder recorder({camera});
  SessionHost host(*session, recorder);
  HudNode node = host.nodes().front();
  const ShadowTechnique first = node.style.technique;
  node.style.technique = ShadowTechnique::hard;
  ASSERT_TRUE(session->edit(ShadowStyled{node.name, node.style}));
  host.set_translucency(Translucency::mesh);
  host.start_again();
  EXPECT_EQ(host.nodes().front().style.technique, first);
  EXPECT_EQ(host.translucency(), Translucency::automatic);
}

// A click grabs and releases an object without moving it.
TEST_F(History, IgnoresClicksThatMoveNothing) {
  move("object1", 0.2);
  history.begin_move(*session, "object1");
  ASSERT_TRUE(session->edit(ObjectPlaced{"object1", test::at(0.2, 0.0, 0.1), false}));
  (void)history.undo(*session);
  EXPECT_EQ(object(0).placement.position.x(), -0.1);
}

TEST_F(History, ResetsAndRevertsReset) {
  ASSERT_TRUE(session->edit(toy()));
  history.note_added("toy");
  move("object1", 0.2);
  move("toy", 0.15);
  EXPECT_EQ(history.reset(*session), "objects are back as at the start");
  EXPECT_EQ(object(0).placement.position.x(), -0.1);
  EXPECT_TRUE(object(1).removed);
  EXPECT_EQ(history.reset(*session), "every object is where it was at the start");
  EXPECT_EQ(history.undo(*session), "the reset is undone");
  EXPECT_EQ(object(0).placement.position.x(), 0.2);
  EXPECT_FALSE(object(1).removed);
  EXPECT_EQ(object(1).placement.position.x(), 0.15);
}

// Any sequence of moves, added objects and resets can be undone completely, one change at a time.
TEST_F(History, RevertsRandomSequencesCompletely) {
  std::mt19937 random(7);
  const ObjectAdded added = toy();
  const auto arrangement = [this] {
    std::vector<std::pair<Placement, bool>> places;
    for (const SceneObject& of_scene : session->view().scene->objects)
      places.emplace_back(of_scene.placement, of_scene.removed);
    return places;
  };
  for (int sequence = 0; sequence < 20; ++sequence) {
    SCOPED_TRACE(sequence);
    session.emplace(start_session());
    history = EditHistory();
    std::vector<std::vector<std::pair<Placement, bool>>> states = {arrangement()};
    int count = 0;  // of added objects
    for (int step = 0; step < 10; ++step) {
      const auto& objects = session->view().scene->objects;
      switch (random() % 8) {
        case 0: {
          ObjectAdded next = added;
          next.object = fmt::format("toy {}", ++count);
          ASSERT_TRUE(session->edit(next));
          history.note_added(next.object);
          // Before it was added, the object was as if it were removed.
          for (auto& state : states) state.emplace_back(next.placement, true);
          break;
        }
        case 1:
          (void)history.reset(*session);
          break;
        default: {
          const SceneObject& moved = objects[random() % objects.size()];
          if (moved.removed) continue;
          move(moved.name, 0.001 * static_cast<double>(random() % 1000));
          break;
        }
      }
      if (arrangement() != states.back()) states.push_back(arrangement());
    }
    while (states.size() > 1) {
      states.pop_back();
      (void)history.undo(*session);
      ASSERT_EQ(arrangement(), states.back());
    }
    EXPECT_EQ(object(0).animation.spin_turns_per_s, 0.01);
  }
}

TEST_F(History, DrawsAddedObjectUntilItIsRemoved) {
  step();
  const auto without = image;
  ASSERT_TRUE(session->edit(toy()));
  const SessionFrame added = step();
  EXPECT_NE(image, without);
  ASSERT_EQ(added.edits.size(), 1U);
  history.note_added("toy");
  EXPECT_THAT(history.undo(*session), HasSubstr("toy is removed"));
  --frame_number;
  --frame_number;
  step();
  EXPECT_EQ(image, without);
}

// A recording that begins later contains the object and its latest place.
TEST_F(History, RepeatsSessionFromLatestEdits) {
  ASSERT_TRUE(session->edit(toy()));
  history.note_added("toy");
  move("toy", 0.2);
  move("object1", -0.2);
  (void)history.undo(*session);
  step();
  const auto seen = image;
  Session again = start_session();
  (void)step(again, 0);
  for (const SceneEdit& edit : session->latest_edits()) {
    // The model is loaded again from its file.
    SceneEdit loaded = edit;
    if (auto* of_toy = std::get_if<ObjectAdded>(&loaded)) of_toy->model = toy().model;
    ASSERT_TRUE(again.replay_edit(loaded));
  }
  (void)step(again, 0);
  EXPECT_EQ(image, seen);
}

// With pixel buffers, the image of the frame before an object was added is read back after it.
TEST_F(History, KeepsPendingImageWhenObjectIsAdded) {
  SessionOptions options;
  options.pixel_buffers = true;
  Trajectory poses;
  for (int i = 0; i < 3; ++i) {
    poses.poses.push_back({i * 1'000'000'000LL, test::look_at({0.1, -0.5, 0.5}, {0, 0, 0}), {}});
  }
  Session late =
      Session::create(*context, builder.build(), camera, GivenPoses{std::move(poses), {}}, options)
          .value();
  const auto draw = [&](int number) {
    Frame frame = test::plain_frame(kImageWidth, kImageHeight, 200);
    frame.timestamp_ns = 1'000'000'000LL * number;
    image.assign(static_cast<std::size_t>(kImageWidth) * kImageHeight * 4, 0);
    return late.draw(late.track(frame), image, ReadBackTime::later).value();
  };
  step();
  const auto first = image;
  EXPECT_FALSE(draw(0).read_back);
  ASSERT_TRUE(late.edit(toy()));
  EXPECT_TRUE(draw(1).read_back);
  EXPECT_EQ(image, first);
  EXPECT_TRUE(draw(2).read_back);
  EXPECT_NE(image, first);
  ASSERT_TRUE(late.edit(ObjectAdded{"toy 2", model_file(), test::at(0.0, 0.1, 0.05), toy().model}));
  std::vector<std::uint8_t> last;
  ASSERT_TRUE(late.take_image(last));
  EXPECT_EQ(last.size(), first.size());
}

TEST_F(History, HostAddsDroppedModelsAndReportsOthers) {
  RunRecorder run({camera});
  SessionHost host(*session, run);
  host.set_sheet(Eigen::AlignedBox2d(Eigen::Vector2d(-0.1, -0.07), Eigen::Vector2d(0.1, 0.07)));
  host.observe(step());
  EXPECT_THAT(host.add_object(model_file()), HasSubstr("cm high, at x 0.2"));
  EXPECT_THAT(host.add_object(model_file()), HasSubstr("helicopter.glb: scale 1 (its own size)"));
  ASSERT_EQ(session->view().scene->objects.size(), 3U);
  EXPECT_EQ(object(2).name, "helicopter 2");
  EXPECT_NE(object(1).placement.position.head<2>(), object(2).placement.position.head<2>());
  EXPECT_EQ(object(1).placement.position.z(), object(2).placement.position.z());
  EXPECT_THAT(host.add_object("missing.glb"), HasSubstr("missing.glb"));
  EXPECT_THAT(host.add_object(test::source_dir() / "README.md"), HasSubstr("README.md"));
  EXPECT_EQ(session->view().scene->objects.size(), 3U);
  HudState state;
  host.describe(state, true);
  EXPECT_THAT(host.undo(), HasSubstr("helicopter 2 is removed"));
  EXPECT_THAT(host.undo(), HasSubstr("helicopter is removed"));
  host.redraw();
  host.describe(state, true);
  EXPECT_THAT(host.undo(), HasSubstr("nothing"));
}

}  // namespace
}  // namespace penumbra
