#include "render/render_work.hpp"

#include <fmt/format.h>

#include <array>

#include "render/scene/scene.hpp"

namespace penumbra {
namespace {

enum class Subject { none, object, plane, light, node };

// `text`: {0} and {1} are names of scene entries, {2} is kVolumeReach.
struct ReasonEntry {
  std::string_view key;
  Subject subject = Subject::object;
  std::string_view text;
  Subject other = Subject::none;
};

// In the order of SkipReason.
constexpr auto kSkipTable = std::to_array<ReasonEntry>({
    {"no_pose", Subject::none, "overlay: no pose"},
    {"faded_out", Subject::none, "overlay: the pose is too old"},
    {"group_not_seen", Subject::object, "{0}: its tags are not seen"},
    {"group_not_seen", Subject::plane, "{0}: its tags are not seen"},
    {"object_out_of_view", Subject::object, "{0}: outside the view"},
    {"shape_missing", Subject::object,
     "{0}: its animation moves a vertex too far away at this time; its first shape is shown"},
    {"technique_none", Subject::node, "{0}: no shadows asked for"},
    {"camera_behind_plane", Subject::plane, "{0}: seen from behind"},
    {"casts_no_shadow", Subject::object, "{0}: casts no shadow"},
    {"shadow_misses_phantoms", Subject::object, "{0}: its shadow meets no phantom"},
    {"shadow_misses_objects", Subject::object, "{0}: its shadow meets no other object"},
    {"receiver_blends", Subject::object, "{0}: shadows do not fall on what blends"},
    {"no_light", Subject::node, "{0}: the scene has no light; add one to \"lights\""},
    {"light_below_plane", Subject::light, "{0}: in or under the plane"},
    {"too_many_lights", Subject::light, "{0}: one light too many for the plane"},
    {"volume_out_of_view", Subject::object, "{0}: its shadow volume is outside the view"},
    {"rays_out_of_view", Subject::object, "{0}: its light rays are outside the view"},
    {"shadow_below_plane", Subject::object, "{0}: under the plane"},
    {"shadow_above_light", Subject::object, "{0}: above the light"},
    {"shadow_off_receiver", Subject::object, "{0}: off the plane's outline"},
    {"shadow_out_of_view", Subject::object, "{0}: its shadow is outside the view"},
    {"umbra_vanished", Subject::object, "{0}: above the umbra's height"},
    {"mask_impossible", Subject::plane,
     "{0}: layers are drawn directly and not as a mask, because the orientation of {1}'s "
     "faces is ambiguous",
     Subject::object},
    {"field_too_coarse", Subject::object,
     "{0}: it is so large and thin that no cell of its field is covered; give it another "
     "technique"},
    {"kernels_not_carried", Subject::object,
     "{0}: its layered shadow is a field, because shadow kernels do not follow its animation well"},
    {"light_inside_caster", Subject::object,
     "{0}: the light \"{1}\" is inside of it, or of a part of it", Subject::light},
    {"volume_too_far", Subject::object,
     "{0}: it is so large or so far from the table that its shadow volume from \"{1}\" ends "
     "{2:.0f} m from the table's origin, above the plane",
     Subject::light},
});
static_assert(kSkipTable.size() == static_cast<std::size_t>(SkipReason::count));

// In the order of KeepReason.
constexpr auto kKeepTable = std::to_array<ReasonEntry>({
    {"video", Subject::none, "video: the frame is on the GPU already"},
    {"layer_mask", Subject::plane, "{0}: its mask is that of an earlier image"},
    {"phantom_mask", Subject::object, "{0}: the shadow of {1} on it is that of an earlier image",
     Subject::object},
});
static_assert(kKeepTable.size() == static_cast<std::size_t>(KeepReason::count));

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
  return kSkipTable[static_cast<std::size_t>(reason)].key;
}
std::string_view key_of(KeepReason reason) {
  return kKeepTable[static_cast<std::size_t>(reason)].key;
}

std::string text_of(const SkippedPass& skipped, const Scene& scene) {
  const ReasonEntry& entry = kSkipTable[static_cast<std::size_t>(skipped.reason)];
  return text_of_entry(entry, scene, skipped.subject, skipped.other);
}
std::string text_of(const KeptResult& kept, const Scene& scene) {
  const ReasonEntry& entry = kKeepTable[static_cast<std::size_t>(kept.reason)];
  return text_of_entry(entry, scene, kept.subject, kept.other);
}

}  // namespace penumbra
