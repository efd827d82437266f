#include "app/session/edit_history.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>
#include <variant>

namespace penumbra {
namespace {

const SceneObject* object_named(const Session& session, const std::string& name) {
  const auto& objects = session.view().scene->objects;
  const auto object = std::ranges::find(objects, name, &SceneObject::name);
  return object == objects.end() ? nullptr : &*object;
}

// Returns true if the edit changes nothing.
bool is_in_effect(const Session& session, const SceneEdit& edit) {
  if (const auto* removed = std::get_if<ObjectRemoved>(&edit)) {
    const SceneObject* object = object_named(session, removed->object);
    return object == nullptr || object->removed == removed->removed;
  }
  if (const auto* placed = std::get_if<ObjectPlaced>(&edit)) {
    const SceneEdit now = session.place_of(placed->object);
    const auto* place = std::get_if<ObjectPlaced>(&now);
    return place != nullptr && place->placement == placed->placement;
  }
  if (const auto* reset = std::get_if<ObjectReset>(&edit)) {
    return std::holds_alternative<ObjectReset>(session.place_of(reset->object));
  }
  return false;
}

std::string text_of(const SceneEdit& edit) {
  if (const auto* removed = std::get_if<ObjectRemoved>(&edit)) {
    return removed->removed ? removed->object + " is removed" : removed->object + " is back";
  }
  if (const auto* placed = std::get_if<ObjectPlaced>(&edit)) return placed->object + " is back";
  if (const auto* reset = std::get_if<ObjectReset>(&edit)) return reset->object + " is back";
  return {};
}

}  // namespace

void EditHistory::begin_move(const Session& session, const std::string& object) {
  if (object_named(session, object) == nullptr) return;
  remember({session.place_of(object)});
}

void EditHistory::note_added(const std::string& object) {
  remember({ObjectRemoved{object, true}});
  added_.insert(object);
}

std::string EditHistory::undo(Session& session) {
  while (!undo_.empty()) {
    std::vector<SceneEdit> edits = std::move(undo_.back());
    undo_.pop_back();
    // A click that moved nothing is not a change.
    std::erase_if(edits, [&](const SceneEdit& edit) { return is_in_effect(session, edit); });
    if (edits.empty()) continue;
    for (const SceneEdit& edit : edits) session.edit(edit);
    return edits.size() == 1 ? "undone: " + text_of(edits.front()) : "the reset is undone";
  }
  return "nothing to undo";
}

std::string EditHistory::reset(Session& session) {
  std::vector<SceneEdit> changes;
  std::vector<SceneEdit> reverts;
  for (const SceneObject& object : session.view().scene->objects) {
    if (const SceneEdit place = session.place_of(object.name);
        !std::holds_alternative<ObjectReset>(place)) {
      changes.emplace_back(ObjectReset{object.name});
      reverts.push_back(place);
    }
    if (added_.contains(object.name) && !object.removed) {
      changes.emplace_back(ObjectRemoved{object.name, true});
      reverts.emplace_back(ObjectRemoved{object.name, false});
    }
  }
  if (changes.empty()) return "every object is where it was at the start";
  for (const SceneEdit& edit : changes) session.edit(edit);
  remember(std::move(reverts));
  return "objects are back as at the start";
}

void EditHistory::start_again(Session& session) {
  (void)reset(session);
  undo_.clear();
}

// Forgets the oldest change of a long session.
void EditHistory::remember(std::vector<SceneEdit> reverts) {
  constexpr std::size_t kMaxChanges = 1000;
  if (undo_.size() == kMaxChanges) undo_.pop_front();
  undo_.push_back(std::move(reverts));
}

}  // namespace penumbra
