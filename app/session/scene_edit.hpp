// Edits of a scene while it runs (object placements, shadow styles) and the light of its frames.
// They are written to a recording's events.jsonl and read from there for a replay.
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

// Places an object and its children, and ends the object's animation.
struct ObjectPlaced {
  std::string object;
  Placement placement;  // relative to its parent, or in the table frame
  bool turned = false;  // the event is object_rotated rather than object_moved
};

struct ShadowStyled {
  std::string node;
  ShadowStyle style;
};

using SceneEdit = std::variant<ObjectPlaced, ShadowStyled>;

// Returns false and changes nothing if the scene has nothing of that name or a number is invalid.
bool apply(Scene& scene, const SceneEdit& edit);

// An edit in effect from the frame with this timestamp on.
struct SceneEvent {
  std::int64_t timestamp_ns = 0;
  SceneEdit edit;
};

// A line of events.jsonl, without line break: {"timestamp_s": ..., "event": "object_moved",
// "object": ..., ...}. Numbers are read back bit for bit.
[[nodiscard]] std::string event_line(const SceneEvent& event);

// The video's light of the frame with this timestamp. It depends on all earlier drawn frames, also
// on those before the recording.
struct LitFrame {
  std::int64_t timestamp_ns = 0;
  VideoLight light;
};
// A line of events.jsonl, as event_line's: {"timestamp_s": ..., "event": "video_light",
// "on_table": [r, g, b], "around": [r, g, b]}, linear light above 0.
[[nodiscard]] std::string light_line(const LitFrame& lit);

struct SceneEvents {
  std::optional<std::int64_t> scene_start_ns;  // timestamp at which the scene's time was 0
  std::vector<SceneEvent> edits;               // in order of time
  std::vector<LitFrame> lights;                // in order of time
};
// The light of the last frame up to this time, or of the first one; nullptr if there is none.
[[nodiscard]] const VideoLight* light_at(const std::vector<LitFrame>& lights,
                                         std::int64_t timestamp_ns);
// Loads the events of a recording; none if there is no file. A damaged last line is ignored,
// because the session may have been cut off.
[[nodiscard]] Result<SceneEvents> load_scene_events(const std::filesystem::path& file);
// Name of the event at which the scene's time was 0.
inline constexpr std::string_view kSceneStartEvent = "scene_start";

}  // namespace penumbra
