// Edits during a session: the next frame shows them, and only the shadows that depend on them are
// recomputed.
#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "app/session/session.hpp"
#include "render/scene/shapes.hpp"
#include "support/scene_events.hpp"
#include "support/studio.hpp"

namespace penumbra {
namespace {

constexpr int kImageWidth = 160;
constexpr int kImageHeight = 120;

class EditedSession : public testing::Test {
 protected:
  EditedSession() {
    for (const double x : {-0.12, 0.12}) {
      const int object =
          builder.add(test::finished(make_box({0.1F, 0.06F, 0.04F}), glm::vec4(1.0F)),
                      test::at(x, 0.0, 0.1), false);
      if (object > 0) builder.scene().shadows.push_back(builder.scene().shadows[0]);
    }
    builder.scene().shadows[0].name = "left";
    builder.scene().shadows[0].casters = {0};
    builder.scene().shadows[1].name = "right";
    builder.scene().shadows[1].casters = {1};
    context = create_offscreen_context().value();
    restart({});
  }

  void restart(const PlanOptions& plan) {
    session.reset();
    Trajectory poses;
    for (int i = 0; i < 30; ++i) {
      poses.poses.push_back({i * 1'000'000'000LL, test::look_at({0.1, -0.5, 0.5}, {0, 0, 0}), {}});
    }
    SessionOptions options;
    options.plan = plan;
    // A mask combines all shadows of a plane, so a style change of one shadow would recompute them
    // all.
    options.plan.layers = LayerDrawing::direct;
    session.emplace(Session::create(*context, builder.build(), camera,
                                    GivenPoses{std::move(poses), {}}, options)
                        .value());
    frame_number = 0;
  }

  SessionFrame step() {
    Frame frame = test::plain_frame(kImageWidth, kImageHeight, 200);
    frame.timestamp_ns = 1'000'000'000LL * frame_number++;
    image.assign(static_cast<std::size_t>(kImageWidth) * kImageHeight * 4, 0);
    return session->draw(session->track(frame), image).value();
  }
  [[nodiscard]] ShadowStyled styled(const char* name) const {
    for (const ShadowNode& node : session->view().scene->shadows) {
      if (node.name == name) return {name, session->style_in_effect(node)};
    }
    return {};
  }

  test::SceneBuilder builder;
  CameraModel camera = test::camera_of(kImageWidth, kImageHeight, 140.0);
  std::unique_ptr<GlContext> context;
  std::optional<Session> session;
  std::vector<std::uint8_t> image;
  int frame_number = 0;
};

// The image of the warm-up must not remain in the framebuffer.
TEST_F(EditedSession, DrawsBlackAfterWarmUp) {
  ASSERT_TRUE(session->warm_up(PixelFormat::yuv420p));
  image.assign(static_cast<std::size_t>(kImageWidth) * kImageHeight * 4, 77);
  ASSERT_TRUE(session->read_back(image));
  int lit = 0;
  for (std::size_t i = 0; i < image.size(); ++i) lit += i % 4 != 3 && image[i] != 0 ? 1 : 0;
  EXPECT_EQ(lit, 0);
  step();
  EXPECT_GT(image[0], 0);
}

// A replay uses the light that the session recorded, not light measured in the images.
TEST_F(EditedSession, UsesRecordedInsteadOfMeasuredLight) {
  const auto drawn_with = [&](std::vector<LitFrame> recorded) {
    Trajectory poses;
    poses.poses.push_back({0, test::look_at({0.1, -0.5, 0.5}, {0, 0, 0}), {}});
    SessionOptions options;
    options.video_light = true;
    options.recorded_light = std::move(recorded);
    session.emplace(Session::create(*context, builder.build(), camera,
                                    GivenPoses{std::move(poses), {}}, options)
                        .value());
    frame_number = 0;
    return step().video_light;
  };
  const auto measured = drawn_with({});
  ASSERT_TRUE(measured);
  const auto bright = image;
  const VideoLight dim = {{0.1, 0.2, 0.15}, {0.05, 0.05, 0.05}};
  const auto recorded = drawn_with({{0, dim}});
  ASSERT_TRUE(recorded);
  EXPECT_EQ(recorded->on_table, dim.on_table);
  EXPECT_EQ(recorded->around, dim.around);
  EXPECT_NE(image, bright);
  (void)drawn_with({{0, *measured}});
  EXPECT_EQ(image, bright);
}

TEST_F(EditedSession, ReusesShadowsWhenLightFractionsChange) {
  EXPECT_EQ(step().composite[Counter::triples_recomputed], 2);
  const auto before = image;
  EXPECT_EQ(step().composite[Counter::triples_recomputed], 0);
  EXPECT_EQ(image, before) << "without an edit, frames must be equal";
  ShadowStyled edit = styled("left");
  edit.style.fractions = {0.9, 0.95, 0.99};
  ASSERT_TRUE(session->edit(edit));
  const SessionFrame after = step();
  EXPECT_NE(image, before);
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 0);
  EXPECT_EQ(after.composite[Counter::kernel_generations], 0);
  EXPECT_EQ(after.composite[Counter::reprojections], 2);
}

TEST_F(EditedSession, ReprojectsOnlyEditedNodeWhenLightConstantsChange) {
  step();
  const auto before = image;
  ShadowStyled edit = styled("right");
  edit.style.layered = layered_constants_for_workspace(0.2, 2.0).value();
  ASSERT_TRUE(session->edit(edit));
  const SessionFrame after = step();
  EXPECT_NE(image, before);
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 1);
  EXPECT_EQ(after.composite[Counter::reprojections], 1);
  EXPECT_EQ(after.composite[Counter::kernel_generations], 0);
}

TEST_F(EditedSession, GeneratesKernelsOnceForEditedNode) {
  step();
  ShadowStyled edit = styled("left");
  const ShadowStyled original = edit;
  edit.style.kernels = KernelSource::centroid;
  ASSERT_TRUE(session->edit(edit));
  SessionFrame after = step();
  EXPECT_EQ(after.composite[Counter::kernel_generations], 1);
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 1);
  EXPECT_EQ(step().composite[Counter::kernel_generations], 0);
  ASSERT_TRUE(session->edit(original));
  after = step();
  EXPECT_EQ(after.composite[Counter::kernel_generations], 0) << "earlier kernels must be reused";
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 1);
}

TEST_F(EditedSession, ChangesTechniqueOfEditedNodeOnly) {
  step();
  const auto before = image;
  ShadowStyled edit = styled("left");
  edit.style.technique = ShadowTechnique::simple;
  ASSERT_TRUE(session->edit(edit));
  const SessionFrame after = step();
  EXPECT_NE(image, before);
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 1);
  EXPECT_EQ(after.composite[Counter::reprojections], 1);
  ASSERT_EQ(after.edits.size(), 1U);
  EXPECT_EQ(std::get<ShadowStyled>(after.edits[0]).node, "left");
  EXPECT_TRUE(step().edits.empty()) << "each edit must be returned once";
}

TEST_F(EditedSession, KeepsCommandLineTechniqueForOtherNodes) {
  PlanOptions plan;
  plan.technique = ShadowTechnique::simple;
  restart(plan);
  step();
  ShadowStyled edit = styled("left");
  EXPECT_EQ(edit.style.technique, ShadowTechnique::simple);
  edit.style.technique = ShadowTechnique::layered;
  ASSERT_TRUE(session->edit(edit));
  EXPECT_EQ(step().composite[Counter::triples_recomputed], 1);
  EXPECT_EQ(styled("right").style.technique, ShadowTechnique::simple);
  EXPECT_EQ(styled("left").style.technique, ShadowTechnique::layered);
}

TEST_F(EditedSession, RedrawsMovedObjectAndReusesShadowOnSlide) {
  step();
  const auto before = image;
  Placement placement = test::at(-0.12, 0.05, 0.1);
  ASSERT_TRUE(session->edit(ObjectPlaced{"object1", placement, false}));
  SessionFrame after = step();
  EXPECT_NE(image, before);
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 0)
      << "a slide along the plane must reuse the shadow";
  placement.position.z() = 0.14;
  ASSERT_TRUE(session->edit(ObjectPlaced{"object1", placement, false}));
  after = step();
  EXPECT_EQ(after.composite[Counter::triples_recomputed], 1)
      << "a change of height must recompute the shadow";
  EXPECT_EQ(after.composite[Counter::kernel_generations], 0);
  EXPECT_FALSE(session->edit(ObjectPlaced{"unknown", placement, false}));
}

TEST_F(EditedSession, KeepsEditsForNextFrameAfterRedraw) {
  const SessionFrame first = step();
  ASSERT_TRUE(session->edit(ObjectPlaced{"object1", test::at(0, 0.1, 0.1), false}));
  EXPECT_TRUE(session->redraw(first.tracked)->edits.empty());
  EXPECT_EQ(step().edits.size(), 1U);
  EXPECT_EQ(session->latest_edits().size(), 1U);
  ASSERT_TRUE(session->edit(ObjectPlaced{"object1", test::at(0, 0.2, 0.1), false}));
  EXPECT_EQ(session->latest_edits().size(), 1U) << "only the latest edit of each object";
}

// Replayed edits give the recorded frames, bit for bit.
TEST_F(EditedSession, ReplaysEditsToSameFrames) {
  const std::vector<SceneEdit> edits = {
      ObjectPlaced{
          "object2",
          {{0.05, 1.0 / 3.0 - 0.3, 0.2},
           Eigen::Quaterniond(Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, 3).normalized())),
           1.0},
          true},
      ObjectPlaced{"object1", test::at(-0.1, 0.07, 0.13), false},
      ViewChanged{Translucency::mesh, false, true}};
  std::vector<std::vector<std::uint8_t>> images;
  std::vector<std::string> lines;
  for (const SceneEdit& edit : edits) {
    ASSERT_TRUE(session->edit(edit));
    const SessionFrame done = step();
    for (const SceneEdit& applied : done.edits) {
      lines.push_back(event_line({done.tracked.frame.timestamp_ns, applied}));
    }
    images.push_back(image);
  }
  ASSERT_EQ(lines.size(), edits.size());
  restart({});
  for (std::size_t i = 0; i < lines.size(); ++i) {
    ASSERT_TRUE(session->replay_edit(test::events_of(lines[i])->edits.at(0).edit));
    EXPECT_TRUE(step().edits.empty());
    EXPECT_EQ(image, images[i]) << "frame " << i;
  }
  EXPECT_NE(images[2], images[1]);
}

// An option of replay has priority over the recorded view; the user's keys have priority over both.
TEST_F(EditedSession, KeepsViewChosenByOptions) {
  SessionOptions options;
  options.chosen_view.walls = true;
  Session chosen =
      Session::create(*context, builder.build(), camera, GivenPoses{}, options).value();
  ASSERT_TRUE(chosen.replay_edit(ViewChanged{Translucency::mesh, false, true}));
  EXPECT_TRUE(chosen.drawn_view().walls);
  EXPECT_EQ(chosen.drawn_view().translucency, Translucency::mesh);
  EXPECT_TRUE(chosen.drawn_view().smooth);
  ASSERT_TRUE(chosen.edit(ViewChanged{Translucency::blend, false, false}));
  EXPECT_FALSE(chosen.drawn_view().walls);
  ASSERT_EQ(chosen.latest_edits().size(), 1U);
  EXPECT_FALSE(std::get<ViewChanged>(chosen.latest_edits()[0]).smooth);
}

}  // namespace
}  // namespace penumbra
