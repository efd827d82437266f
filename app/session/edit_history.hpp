// Undo and reset of the objects that the user moved or added in a session.
#pragma once

#include <deque>
#include <set>
#include <string>
#include <vector>

#include "app/session/session.hpp"

namespace penumbra {

class EditHistory {
 public:
  // Call this before the first of the edits that one undo reverts: moves of this object.
  void begin_move(const Session& session, const std::string& object);
  // Call this after the user added an object.
  void note_added(const std::string& object);
  // Reverts the latest change. Returns a message for the user.
  [[nodiscard]] std::string undo(Session& session);
  // Puts objects back to the start of the session and removes those added since. An undo reverts
  // this. Returns a message for the user.
  [[nodiscard]] std::string reset(Session& session);
  // Does the same, and then forgets all changes, so that none can be reverted.
  void start_again(Session& session);

 private:
  void remember(std::vector<SceneEdit> reverts);

  std::deque<std::vector<SceneEdit>> undo_;  // edits that revert each change, latest last
  std::set<std::string> added_;              // objects that reset() removes
};

}  // namespace penumbra
