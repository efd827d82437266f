// Edits of a running scene (added and moved objects, shadow styles) and the light of its frames. A
// live session writes them to the recording's events.jsonl, and a replay reads them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/error.hpp"
#include "render/scene/light_meter.hpp"
#include "render/scene/scene.hpp"
#include "render/translucency.hpp"

namespace penumbra {

// Places an object and its children, and ends the object's animation.
struct ObjectPlaced {
  std::string object;
  Placement placement;  // relative to the parent; in the table frame if there is no parent
  bool turned = false;  // event type is object_rotated instead of object_moved
};

struct ShadowStyled {
  std::string node;
  ShadowStyle style;
};

// Adds a model to the scene (add_object()). If the scene has an object of this name, places it.
struct ObjectAdded {
  std::string object;
  std::string model_file;  // absolute path; in a recording's events, relative to the recording
  Placement placement;
  std::shared_ptr<const Model> model;  // null until it is loaded
  UpAxis up = UpAxis::by_format;       // of the model's file
  // Only its model and its animation are recorded; the animation is empty for a rigid object.
  Playback playback = {};
};

// Puts an object back to its place and animation at the start.
struct ObjectReset {
  std::string object;
};

// Removes an added object, or brings it back.
struct ObjectRemoved {
  std::string object;
  bool removed = true;
};

// How the session draws, as chosen in the window.
struct ViewChanged {
  Translucency translucency = Translucency::automatic;
  bool walls = true;    // virtual walls are shown
  bool smooth = false;  // the drawn pose is smoothed
  friend bool operator==(const ViewChanged&, const ViewChanged&) = default;
};

using SceneEdit =
    std::variant<ObjectPlaced, ShadowStyled, ObjectAdded, ObjectReset, ObjectRemoved, ViewChanged>;

// Returns false and changes nothing if the object or node does not exist or a number is invalid.
// ViewChanged does not change the scene; Session applies it.
// `start`: the scene without edits, to which added objects are added too; nullptr: objects can't be
// reset.
bool apply(Scene& scene, const SceneEdit& edit, Scene* start = nullptr);

// An edit that is in effect from the frame with this timestamp on.
struct SceneEvent {
  std::int64_t timestamp_ns = 0;
  SceneEdit edit;
};

// Returns a line of events.jsonl without the line break: {"timestamp_s": ..., "event":
// "object_moved", "object": ..., ...}. Reading it back gives bit-identical numbers.
[[nodiscard]] std::string event_line(const SceneEvent& event);

// The measured light of the frame with this timestamp. It is recorded because it depends on all
// frames drawn earlier, including those before the recording.
struct LitFrame {
  std::int64_t timestamp_ns = 0;
  VideoLight light;
};
// Returns a line of events.jsonl like event_line(): {"timestamp_s": ..., "event": "video_light",
// "on_table": [r, g, b], "around": [r, g, b]}, linear light > 0.
[[nodiscard]] std::string light_line(const LitFrame& lit);

struct SceneEvents {
  std::optional<std::int64_t> scene_start_ns;  // timestamp at which the scene's time was 0
  std::string scene;                           // file of the session's scene; "": not recorded
  std::vector<SceneEvent> edits;               // in order of time
  std::vector<LitFrame> lights;                // in order of time
};
// Returns the latest light up to this time, else the first light; nullptr if there is none.
[[nodiscard]] const VideoLight* light_at(const std::vector<LitFrame>& lights,
                                         std::int64_t timestamp_ns);
// Loads the events of a recording. A missing file means no events. A damaged last line is ignored,
// because the session may have crashed.
[[nodiscard]] Result<SceneEvents> load_scene_events(const std::filesystem::path& file);
// Returns true if the session added objects to its scene.
[[nodiscard]] bool adds_objects(const SceneEvents& events);
// Name of the event at which the scene's time was 0; its detail is the scene's file.
inline constexpr std::string_view kSceneStartEvent = "scene_start";

}  // namespace penumbra
