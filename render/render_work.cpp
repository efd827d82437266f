#include "render/render_work.hpp"

#include <fmt/format.h>

#include "render/scene/scene.hpp"

namespace penumbra {
namespace {

enum class Subject { none, object, plane, light, node };

// `text`: {0} and {1} are the names of the subjects, {2} is kVolumeReach.
struct ReasonEntry {
  std::string_view key;
  Subject subject = Subject::object;
  std::string_view text;
  Subject other = Subject::none;
};

ReasonEntry entry_of(SkipReason reason) {
  switch (reason) {
    case SkipReason::no_pose:
      return {"no_pose", Subject::none, "overlay: "};
    case SkipReason::faded_out:
      return {"faded_out", Subject::none, "overlay: the pose is too old"};
    case SkipReason::object_group_not_seen:
      return {"group_not_seen", Subject::object, "{0}: its tags are not seen"};
    case SkipReason::plane_group_not_seen:
      return {"group_not_seen", Subject::plane, "{0}: its tags are not seen"};
    case SkipReason::object_out_of_view:
      return {"object_out_of_view", Subject::object, "{0}: outside the view"};
    case SkipReason::technique_none:
      return {"technique_none", Subject::node, "{0}: no shadows asked for"};
    case SkipReason::camera_behind_plane:
      return {"camera_behind_plane", Subject::plane, "{0}: seen from behind"};
    case SkipReason::casts_no_shadow:
      return {"casts_no_shadow", Subject::object, "{0}: casts no shadow"};
    case SkipReason::shadow_misses_phantoms:
      return {"shadow_misses_phantoms", Subject::object, "{0}: its shadow meets no phantom"};
    case SkipReason::shadow_misses_objects:
      return {"shadow_misses_objects", Subject::object, "{0}: its shadow meets no other object"};
    case SkipReason::receiver_blends:
      return {"receiver_blends", Subject::object, "{0}: shadows do not fall on what blends"};
    case SkipReason::no_light:
      return {"no_light", Subject::node, "{0}: the scene has no light"};
    case SkipReason::light_below_plane:
      return {"light_below_plane", Subject::light, "{0}: in or under the plane"};
    case SkipReason::too_many_lights:
      return {"too_many_lights", Subject::light, "{0}: one light too many for the plane"};
    case SkipReason::volume_out_of_view:
      return {"volume_out_of_view", Subject::object, "{0}: its shadow volume is outside the view"};
    case SkipReason::rays_out_of_view:
      return {"rays_out_of_view", Subject::object, "{0}: its light rays are outside the view"};
    case SkipReason::shadow_below_plane:
      return {"shadow_below_plane", Subject::object, "{0}: under the plane"};
    case SkipReason::shadow_above_light:
      return {"shadow_above_light", Subject::object, "{0}: above the light"};
    case SkipReason::shadow_off_receiver:
      return {"shadow_off_receiver", Subject::object, "{0}: off the plane's outline"};
    case SkipReason::shadow_out_of_view:
      return {"shadow_out_of_view", Subject::object, "{0}: its shadow is outside the view"};
    case SkipReason::umbra_vanished:
      return {"umbra_vanished", Subject::object, "{0}: above the umbra's height"};
    case SkipReason::mask_impossible:
      return {"mask_impossible", Subject::plane,
              "{0}: layers are drawn directly and not as a mask, because the orientation of {1}'s "
              "faces is ambiguous",
              Subject::object};
    case SkipReason::field_too_coarse:
      return {"field_too_coarse", Subject::object,
              "{0}: it is so large and thin that no cell of its field is covered; give it another "
              "technique"};
    case SkipReason::light_inside_caster:
      return {"light_inside_caster", Subject::object,
              "{0}: the light \"{1}\" is inside of it, or of a part of it", Subject::light};
    case SkipReason::volume_too_far:
      return {
          "volume_too_far", Subject::object,
          "{0}: it is so large or so far from the table that its shadow volume from \"{1}\" ends "
          "{2:.0f} m "
          "from the table's origin, above the plane",
          Subject::light};
  }
  return {};
}

ReasonEntry entry_of(KeepReason reason) {
  switch (reason) {
    case KeepReason::video:
      return {"video", Subject::none, "video: the frame is on the GPU already"};
    case KeepReason::layer_mask:
      return {"layer_mask", Subject::plane, "{0}: its mask is that of an earlier picture"};
    case KeepReason::phantom_mask:
      return {"phantom_mask", Subject::object,
              "{0}: the shadow of {1} on it is that of an earlier picture", Subject::object};
  }
  return {};
}

std::string name_of(const Scene& scene, Subject subject, int index) {
  const auto named = [index](const auto& things) {
    const auto at = static_cast<std::size_t>(index);
    return at < things.size() ? things[at].name : std::string();
  };
  switch (subject) {
    case Subject::object:
      return named(scene.objects);
    case Subject::plane:
      return named(scene.planes);
    case Subject::light:
      return named(scene.lights);
    case Subject::node:
      return named(scene.shadows);
    case Subject::none:
      break;
  }
  return {};
}

std::string text_of_entry(const ReasonEntry& entry, const Scene& scene, int subject, int other) {
  return fmt::format(fmt::runtime(entry.text), name_of(scene, entry.subject, subject),
                     name_of(scene, entry.other, other), kVolumeReach);
}

}  // namespace

std::string_view key_of(SkipReason reason) {
  return entry_of(reason).key;
}
std::string_view key_of(KeepReason reason) {
  return entry_of(reason).key;
}

std::string text_of(const SkippedPass& skipped, const Scene& scene) {
  const ReasonEntry entry = entry_of(skipped.reason);
  return text_of_entry(entry, scene, skipped.subject, skipped.other) + skipped.detail;
}
std::string text_of(const KeptPart& kept, const Scene& scene) {
  const ReasonEntry entry = entry_of(kept.reason);
  return text_of_entry(entry, scene, kept.subject, kept.other);
}

}  // namespace penumbra
