// Soft shadows of one object on a rectangle of the table, 1280 x 720. Compares the layers with
// common GPU techniques: cost, and difference from the shadow of an area light.
//
//   count_soft_shadows count FRAMES SHAPE:TECHNIQUE... draws moving frames for callgrind to count,
//                                                      dumped under these names
//   count_soft_shadows frame SHAPE:TECHNIQUE FILE.ppm  one image
//   count_soft_shadows errors                          lines of SHAPE TECHNIQUE and the four Errors
//
// SHAPE: sphere | torus, of 3000 triangles. TECHNIQUE: a technique of the program, a technique of
// soft_shadows.hpp, or `bare` for the frame without a shadow. The light is a disc at the zenith
// whose size follows from the layers' constants and the body's thickness. A fraction of 0.15 of the
// light is ambient, as in the layers' light fractions.
#include <valgrind/callgrind.h>

#include <array>
#include <cstdio>
#include <fstream>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/text/text.hpp"
#include "counted_scene.hpp"
#include "render/passes/object_painter.hpp"
#include "render/passes/video_texture.hpp"
#include "render/shadow/kernels/shadow_kernels.hpp"
#include "soft_shadows.hpp"

namespace penumbra {
namespace {

constexpr int kTriangles = 3000;
constexpr double kUmbraHeight = 0.28;  // H / a of the scenes' default constants [m]
constexpr int kReferenceSamples = 1024;

std::shared_ptr<const Scene> scene_of(std::string_view shape) {
  // At the zenith, the lights of all parts coincide.
  const LayeredConstants constants =
      make_layered_constants(std::numeric_limits<double>::infinity(), 0.0, kUmbraHeight).value();
  return std::make_shared<const Scene>(counted::scene_of(
      shape == "sphere" ? counted::sphere(kTriangles) : counted::torus(kTriangles), constants));
}

void check(const Result<void>& done) {
  if (!done) throw std::runtime_error(done.error().message);
}

// Draws a frame with the program's passes and adds the soft shadow of a peer technique.
class PeerStudio {
 public:
  explicit PeerStudio(std::shared_ptr<const Scene> scene)
      : scene_(std::move(scene)), camera_(counted::camera()), lens_(make_lens(camera_)) {
    context_ = create_offscreen_context(GlApi::gl33).value();
    framebuffer_.emplace(Framebuffer::create(counted::kWidth, counted::kHeight).value());
    objects_.emplace(ObjectPainter::create(GlApi::gl33, *scene_, camera_, false).value());
    check(objects_->choose(Translucency::blend, PixelFormat::yuyv));
    video_.emplace(GlApi::gl33);
  }
  // Selects the technique of the following frames; nullopt: no shadow.
  void choose(std::optional<counted::SoftTechnique> technique) {
    context_->make_current();
    soft_.reset();
    if (!technique) return;
    const ShadowMesh mesh = make_shadow_mesh(*scene_->objects[0].model);
    const Eigen::Vector3d up =
        scene_->objects[0].placement.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    const auto parts = part_discs(mesh, up);
    const counted::SoftLight light{
        static_cast<double>(parts.at(0).radius) / scene_->shadows[0].layered.umbra_height,
        static_cast<float>(scene_->shadows[0].fractions.umbra)};
    soft_.emplace(
        counted::SoftShadows::create(mesh, *technique, light, {counted::kWidth, counted::kHeight})
            .value());
  }
  [[nodiscard]] const CameraModel& camera() const { return camera_; }

  void draw(const Frame& frame, const SceneState& state, const FramePlan& plan) {
    const PlaneFrame plane;
    const glm::mat4x3 to_camera = camera_from_plane(plan.T_table_camera, plane);
    if (soft_) soft_->prepare(state.objects[0], plane, lens_, to_camera);
    framebuffer_->bind();
    video_->upload(frame);
    check(video_->draw(frame));
    glDepthMask(GL_TRUE);
    glStencilMask(0xFF);
    glClear(GL_DEPTH_BUFFER_BIT | GL_STENCIL_BUFFER_BIT);
    objects_->draw_objects(plan, lens_, *framebuffer_);
    if (soft_) soft_->draw(lens_, to_camera);
    glFinish();
    if (glGetError() != GL_NO_ERROR) throw std::runtime_error("OpenGL reports an error");
  }
  [[nodiscard]] test::RenderedImage picture() const {
    test::RenderedImage picture{counted::kWidth, counted::kHeight, {}};
    picture.rgba.resize(std::size_t{4} * counted::kWidth * counted::kHeight);
    framebuffer_->read_rgba(picture.rgba);
    return picture;
  }

 private:
  std::shared_ptr<const Scene> scene_;
  CameraModel camera_;
  LensUniforms lens_;
  std::unique_ptr<GlContext> context_;
  std::optional<Framebuffer> framebuffer_;
  std::optional<ObjectPainter> objects_;
  std::optional<VideoTexture> video_;
  std::optional<counted::SoftShadows> soft_;
};

bool is_peer(std::string_view technique) {
  return technique == "bare" || counted::soft_technique(technique);
}

PlanOptions options_of(std::string_view technique) {
  PlanOptions options;
  options.translucency = Translucency::blend;
  const auto choice = counted::technique_of(technique);
  options.technique = choice ? choice->technique : ShadowTechnique::none;
  if (choice) options.layers = choice->layers;
  return options;
}

// Calls draw(video frame, state, plan) for each frame.
template <class Draw>
void run_frames(const Scene& scene, const CameraModel& camera, const std::string& technique,
                int frames, const std::string& name, const Draw& draw) {
  SceneState state = evaluate_scene(scene, 0.0);
  const std::array<Frame, 2> video = {counted::video(counted::Video::gradients),
                                      counted::video(counted::Video::gradients)};
  for (int i = 0; i < counted::kWarmFrames + frames; ++i) {
    if (i == counted::kWarmFrames) CALLGRIND_ZERO_STATS;
    counted::move_on(state, i);
    draw(video[static_cast<std::size_t>(i % 2)], state,
         plan_frame(scene, state, counted::pose(), camera, options_of(technique)));
  }
  if (frames > 0) CALLGRIND_DUMP_STATS_AT(name.c_str());
}

// Draws the scene of one shape with the program's techniques and with the peer techniques.
class Studios {
 public:
  explicit Studios(std::string_view shape)
      : scene_(scene_of(shape)), peers_(scene_), program_(scene_, counted::camera()) {}

  void count(const std::string& technique, int frames, const std::string& name) {
    if (is_peer(technique)) {
      peers_.choose(counted::soft_technique(technique));
      run_frames(*scene_, peers_.camera(), technique, frames, name,
                 [&](const Frame& frame, const SceneState& state, const FramePlan& plan) {
                   peers_.draw(frame, state, plan);
                 });
      return;
    }
    program_.context().make_current();
    run_frames(*scene_, program_.camera(), technique, frames, name,
               [&](const Frame& frame, const SceneState&, const FramePlan& plan) {
                 program_.compositor().draw(frame, plan).value();
               });
  }
  // Uses plain grey video, so that images differ only in the shadow.
  test::RenderedImage picture(std::string_view technique) {
    const SceneState state = evaluate_scene(*scene_, 0.0);
    const Frame frame = counted::video(counted::Video::plain);
    const FramePlan plan =
        plan_frame(*scene_, state, counted::pose(), program_.camera(), options_of(technique));
    if (!is_peer(technique)) return program_.draw(frame, plan);
    peers_.choose(counted::soft_technique(technique));
    peers_.draw(frame, state, plan);
    return peers_.picture();
  }

 private:
  std::shared_ptr<const Scene> scene_;
  PeerStudio peers_;
  test::Studio program_;
};

int write_image(const test::RenderedImage& picture, const char* file) {
  std::ofstream out(file, std::ios::binary);
  out << "P6 " << picture.width << " " << picture.height << " 255\n";
  for (std::size_t i = 0; i < picture.rgba.size(); i += 4)
    out.write(reinterpret_cast<const char*>(picture.rgba.data() + i), 3);
  return out.flush() ? 0 : 1;
}

struct Choice {
  std::string shape, technique;
};

struct Shadow {
  std::vector<int> lost;  // number of grey levels by which the shadow darkens each pixel
  int darkest = 0;
  Shadow(const test::RenderedImage& with, const test::RenderedImage& without) {
    for (std::size_t i = 1; i < with.rgba.size(); i += 4) {
      lost.push_back(static_cast<int>(without.rgba[i]) - static_cast<int>(with.rgba[i]));
      darkest = std::max(darkest, lost.back());
    }
  }
};

struct Errors {
  double rms = 0.0;                    // RMS where the reference is dark [grey levels]
  double relative = 0.0;               // L2 norm of the difference over that of the reference
  double umbra = 0.0, penumbra = 0.0;  // relative errors of the areas
};
Errors errors_of(const Shadow& shadow, const Shadow& reference) {
  double squared_difference = 0.0;
  double squared_reference = 0.0;
  double pixels = 0.0;
  std::array<double, 2> umbra{};
  std::array<double, 2> penumbra{};
  for (std::size_t i = 0; i < reference.lost.size(); ++i) {
    const double expected = reference.lost[i];
    squared_difference += (shadow.lost[i] - expected) * (shadow.lost[i] - expected);
    squared_reference += expected * expected;
    pixels += expected > 0 ? 1.0 : 0.0;
    for (const bool ours : {false, true}) {
      const int lost = ours ? shadow.lost[i] : reference.lost[i];
      umbra[ours ? 1 : 0] += lost >= reference.darkest - 1 ? 1.0 : 0.0;
      penumbra[ours ? 1 : 0] += lost > 0 ? 1.0 : 0.0;
    }
  }
  return {std::sqrt(squared_difference / pixels), std::sqrt(squared_difference / squared_reference),
          umbra[1] / umbra[0] - 1.0, penumbra[1] / penumbra[0] - 1.0};
}

int print_errors() {
  for (const char* shape : {"sphere", "torus"}) {
    Studios studios(shape);
    const test::RenderedImage bare = studios.picture("bare");
    if (!(bare == studios.picture("none"))) {
      std::fprintf(stderr, "count_soft_shadows: the peers' frame is not the program's\n");
      return 1;
    }
    const Shadow reference(studios.picture("reference-" + std::to_string(kReferenceSamples)), bare);
    for (const char* technique :
         {"simple", "layered", "layered-direct", "field", "hard-map", "pcf", "pcss-16", "pcss-32",
          "pcss-64", "average-4", "average-16", "average-64"}) {
      const Errors errors = errors_of(Shadow(studios.picture(technique), bare), reference);
      std::printf("%s %s %.6f %.6f %.6f %.6f\n", shape, technique, errors.rms, errors.relative,
                  errors.umbra, errors.penumbra);
    }
  }
  return 0;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  using namespace penumbra;
  const auto misused = [] {
    std::fprintf(stderr,
                 "count_soft_shadows count FRAMES SHAPE:TECHNIQUE... | frame SHAPE:TECHNIQUE "
                 "FILE.ppm | errors\n");
    return 2;
  };
  counted::use_one_thread_of_software_gl();
  const std::string what = argc > 1 ? argv[1] : "";
  if (what == "errors" && argc == 2) return print_errors();
  if (argc < 4) return misused();
  const auto choice_of = [](const std::string& name) {
    const std::size_t colon = std::min(name.find(':'), name.size());
    Choice choice{name.substr(0, colon), name.substr(std::min(colon + 1, name.size()))};
    const bool known = (choice.shape == "sphere" || choice.shape == "torus") &&
                       (is_peer(choice.technique) || counted::technique_of(choice.technique));
    return known ? std::optional(choice) : std::nullopt;
  };
  if (what == "frame" && argc == 4) {
    const auto choice = choice_of(argv[2]);
    return choice ? write_image(Studios(choice->shape).picture(choice->technique), argv[3])
                  : misused();
  }
  const auto frames = static_cast<int>(parse_integer(argv[2]).value_or(0));
  if (what != "count" || frames < 1) return misused();
  std::map<std::string, Studios> studios;
  std::vector<std::pair<std::string, Choice>> rows;
  for (int i = 3; i < argc; ++i) {
    const auto choice = choice_of(argv[i]);
    if (!choice) return misused();
    rows.emplace_back(argv[i], *choice);
    studios.try_emplace(choice->shape, choice->shape);
  }
  // Compiles all shaders before the single start of instrumentation.
  for (const auto& [name, choice] : rows) studios.at(choice.shape).count(choice.technique, 0, name);
  CALLGRIND_START_INSTRUMENTATION;
  for (const auto& [name, choice] : rows)
    studios.at(choice.shape).count(choice.technique, frames, name);
  CALLGRIND_STOP_INSTRUMENTATION;
  return 0;
}
