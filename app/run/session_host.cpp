#include "app/run/session_host.hpp"

#include <fmt/chrono.h>

#include <ctime>
#include <string_view>
#include <system_error>

#include "app/logging.hpp"
#include "app/output/output_file.hpp"
#include "core/image/image_file.hpp"

namespace penumbra {

std::filesystem::path free_name(const std::filesystem::path& base, const std::string& extension) {
  std::error_code ignored;
  std::filesystem::path name = base.string() + extension;
  for (int i = 2; std::filesystem::exists(name, ignored); ++i) {
    name = fmt::format("{}-{}{}", base.string(), i, extension);
  }
  return name;
}

std::filesystem::path free_name(const std::string& extension) {
  const std::time_t now = std::time(nullptr);
  std::tm local{};
  return free_name(fmt::format("penumbra-{:%Y%m%d-%H%M%S}", *localtime_r(&now, &local)), extension);
}

void SessionHost::forget_frame() {
  if (last_) last_->tracked.frame = Frame();
}

std::vector<HudNode> SessionHost::nodes() const {
  std::vector<HudNode> nodes;
  for (const ShadowNode& node : session_.view().scene->shadows) {
    nodes.push_back({node.name, session_.style_in_effect(node)});
  }
  return nodes;
}

void SessionHost::start_again() {
  history_.start_again(session_);
  for (const HudNode& first : first_nodes_) {
    for (const HudNode& node : nodes()) {
      if (node.name == first.name && node.style != first.style)
        session_.edit(ShadowStyled{first.name, first.style});
    }
  }
  if (session_.drawn_view() != first_view_) session_.edit(first_view_);
}

void SessionHost::redraw() {
  if (!last_ || last_->tracked.frame.empty()) return;
  auto drawn = session_.redraw(last_->tracked);
  if (!drawn) {
    log_warning("{}", drawn.error().message);
    return;
  }
  run_.add_work(drawn->composite);
  last_ = std::move(*drawn);
}

std::string save_screenshot_png(int width, int height, std::span<const std::uint8_t> rgba,
                                const std::optional<std::filesystem::path>& recording) {
  const std::filesystem::path file = free_name(".png");
  if (recording && lies_in(file, *recording)) {
    return "this folder is the recording that is played; start elsewhere to save images";
  }
  if (auto saved = save_png(file, width, height, rgba); !saved) return saved.error().message;
  std::error_code ignored;
  return "screenshot saved: " + std::filesystem::absolute(file, ignored).string();
}

std::string SessionHost::save_screenshot() {
  const ImageSize size = session_.shown_size();
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(size.width) *
                                   static_cast<std::size_t>(size.height) * 4U);
  if (auto read = session_.read_back(pixels); !read) return read.error().message;
  return save_screenshot_png(size.width, size.height, pixels, recording_);
}

void describe_frame(HudState& state, const SessionFrame& frame, const RunRecorder& run) {
  state.has_image = true;
  state.frame = frame.tracked.frame.sequence;
  state.pose = frame.tracked.pose;
  state.smoothed = frame.smoothed;
  state.groups = frame.tracked.groups;
  state.translucency_drawn = frame.composite.translucency;
  const auto add = [&](std::string_view stage) {
    if (const auto mean = run.recent_ms(stage)) state.stages.emplace_back(stage, *mean);
  };
  for (const char* stage : {"capture", "track", "shadow", "render", "gpu", "readback", "encode"}) {
    add(stage);
    if (stage != std::string_view("track")) continue;
    // Lists only stages that ran in the latest frame, because the times of the others may be old.
    const TrackTimes& times = frame.tracked.times;
    if (times.detect_ms > 0.0) add("detect");
    if (times.align_ms > 0.0) add("align");
    if (times.solve_ms > 0.0) add("solve");
  }
}

void RunHost::describe(HudState& state, bool debug) const {
  state.frame_count = frame_count_;
  if (!last_) return;
  describe_frame(state, *last_, run_);
  if (!debug) return;
  state.drawn = last_->composite;
  state.work = run_.work();
  for (const SkippedPass& skipped : last_->plan.skipped)
    state.skipped.push_back(text_of(skipped, scene()));
  for (const KeptResult& kept : last_->composite.kept) state.kept.push_back(text_of(kept, scene()));
}

std::string SessionHost::add_object(const std::filesystem::path& file) {
  ObjectRequest request;
  request.file = file;
  auto added = load_object(request, *session_.view().scene, sheet_);
  if (!added) return added.error().message;
  if (!session_.edit(added->edit)) {
    return fmt::format("{}: can't be drawn; the log has the cause", file.string());
  }
  history_.note_added(added->edit.object);
  redraw();  // the old image is lost with the old compositor
  return file.filename().string() + ": " + added->description;
}

std::string SessionHost::save_scene() {
  std::error_code ignored;
  const std::filesystem::path name = std::filesystem::absolute(free_name(".json"), ignored);
  if (recording_ && lies_in(name, *recording_)) {
    return "this folder is the recording that is played; start elsewhere to save scenes";
  }
  const auto text = session_.scene_text(name.parent_path());
  if (!text) return text.error().message;
  auto file = OutputFile::create(name);
  if (!file) return file.error().message;
  if (const auto written = write_text(*file, *text); !written) return written.error().message;
  return "scene saved: " + name.string();
}

void SessionHost::set_translucency(Translucency mode) {
  ViewChanged view = session_.drawn_view();
  view.translucency = mode;
  session_.edit(view);
}

std::string SessionHost::toggle_smoothing() {
  ViewChanged view = session_.drawn_view();
  view.smooth = !view.smooth;
  session_.edit(view);
  return view.smooth ? "the drawn pose is smoothed" : "the pose is drawn as measured";
}

std::string SessionHost::toggle_walls() {
  const auto has_walls = [](const HudNode& node) {
    return node.style.technique == ShadowTechnique::walls;
  };
  if (std::ranges::none_of(nodes(), has_walls)) return "no shadow node has the technique walls";
  ViewChanged view = session_.drawn_view();
  view.walls = !view.walls;
  session_.edit(view);
  return view.walls ? "the walls are shown" : "the walls are hidden";
}

void SessionHost::describe(HudState& state, bool debug) const {
  RunHost::describe(state, debug);
  state.smooth = session_.drawn_view().smooth;
  state.walls = session_.drawn_view().walls;
  if (!debug || !last_) return;
  const SessionView view = session_.view();
  for (const CasterKernels& caster : session_.kernels_in_use()) {
    state.twists.push_back({view.scene->objects[static_cast<std::size_t>(caster.object)].name,
                            caster.twist, caster.spill});
    if (!view.T_table_camera) continue;
    const auto T_camera_table = view.T_table_camera->inverse();
    for (const Eigen::Vector3d& p : caster.on_plane) {
      if (const auto pixel = view.camera->project(T_camera_table * p)) {
        state.kernels_px.push_back(*pixel);
      }
    }
  }
  state.image_width = view.camera->width();
  state.image_height = view.camera->height();
}

}  // namespace penumbra
