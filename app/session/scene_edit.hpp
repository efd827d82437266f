// What a person changes in a scene while it runs: where an object stands, how a shadow is drawn;
// and the light that it was drawn in. Written to a recording's events.jsonl, and read from there to
// happen again.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/error.hpp"
#include "render/scene/light_meter.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// The object stands here from now on, and its own animation ends; what hangs on it comes along.
struct ObjectPlaced {
  std::string object;
  Placement placement;  // relative to its parent; in the table frame where it has none
  bool turned = false;  // rather than moved: by this the event is named
};

// Everything that a shadow node can be given.
struct ShadowStyle {
  ShadowTechnique technique = ShadowTechnique::layered;
  KernelSource kernels = KernelSource::automatic;
  LayeredConstants layered;
  LightFractions fractions;
  bool light_rays = false;
};
[[nodiscard]] ShadowStyle style_of(const ShadowNode& node);

struct ShadowStyled {
  std::string node;
  ShadowStyle style;
};

using SceneEdit = std::variant<ObjectPlaced, ShadowStyled>;

// False where the scene has nothing of that name, or a number is of no use: then nothing changes.
bool apply(Scene& scene, const SceneEdit& edit);

// An edit is in effect from the frame with this timestamp on.
struct SceneEvent {
  std::int64_t timestamp_ns = 0;
  SceneEdit edit;
};

// A line of events.jsonl, without line break: {"timestamp_s": ..., "event": "object_moved",
// "object": ..., ...}. Numbers are written so that they are read as they were, bit for bit.
[[nodiscard]] std::string event_line(const SceneEvent& event);
// Nothing for lines that are other events. Fails on a line that is damaged; `name` is put into the
// error.
[[nodiscard]] Result<std::optional<SceneEvent>> parse_event_line(std::string_view line,
                                                                 const std::string& name);

// The video's light that the frame with this timestamp was drawn in. It follows the frames that
// were drawn, also those before the recording began: from its pictures alone it can't be had again.
struct LitFrame {
  std::int64_t timestamp_ns = 0;
  VideoLight light;
};
// A line of events.jsonl, as event_line's: {"timestamp_s": ..., "event": "video_light",
// "on_table": [r, g, b], "around": [r, g, b]}, linear light above 0.
[[nodiscard]] std::string light_line(const LitFrame& lit);

struct SceneEvents {
  std::optional<std::int64_t> scene_start_ns;  // the frames' clock at which the scene's time was 0
  std::vector<SceneEvent> edits;               // in order of time
  std::vector<LitFrame> lights;                // in order of time
};
// That of the last frame drawn up to this time; the first one's before it. Nothing where there is
// none.
[[nodiscard]] const VideoLight* light_at(const std::vector<LitFrame>& lights,
                                         std::int64_t timestamp_ns);
// Of a recording; none where the file is not there. A damaged last line is left out: the session
// was cut off there.
[[nodiscard]] Result<SceneEvents> load_scene_events(const std::filesystem::path& file);
// The event that says when the scene's time was 0: its name.
inline constexpr std::string_view kSceneStartEvent = "scene_start";

}  // namespace penumbra
