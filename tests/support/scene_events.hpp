// Reads one line of events.jsonl in the way that a recording's file is read.
#pragma once

#include <string>

#include "app/session/scene_edit.hpp"
#include "support/recording_folder.hpp"

namespace penumbra::test {

inline Result<SceneEvents> events_of(const std::string& line) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "events.jsonl";
  write_text(file, line + "\n");
  return load_scene_events(file);
}

}  // namespace penumbra::test
