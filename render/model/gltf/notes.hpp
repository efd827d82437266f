// Warnings of the same kind, joined into one line.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace penumbra::gltf {

class Notes {
 public:
  // `text` describes what was found at `place` and the consequence. `expected`: valid content,
  // which is reported only if nothing remains to be shown.
  void add(std::string_view text, const std::string& place, bool expected = false) {
    const auto note =
        std::ranges::find_if(notes_, [&](const Note& known) { return known.text == text; });
    if (note == notes_.end()) {
      notes_.push_back({std::string(text), place, 1, expected});
    } else {
      ++note->count;
      note->expected = note->expected && expected;
    }
  }

  // The first line, also of what is expected; empty where there is none.
  [[nodiscard]] std::string first_line(const std::string& name) const {
    return notes_.empty() ? "" : line_of(notes_.front(), name);
  }

  // One line per kind: the first place, and how many more there are.
  [[nodiscard]] std::vector<std::string> lines(const std::string& name) const {
    std::vector<std::string> lines;
    for (const Note& note : notes_) {
      if (!note.expected) lines.push_back(line_of(note, name));
    }
    return lines;
  }

 private:
  struct Note {
    std::string text;
    std::string first_place;
    std::size_t count = 0;
    bool expected = false;
  };
  static std::string line_of(const Note& note, const std::string& name) {
    const std::string more = note.count > 1 ? fmt::format(" (and {} more)", note.count - 1) : "";
    return on_one_line(fmt::format("{}: {}{}: {}", name, note.first_place, more, note.text));
  }

  std::vector<Note> notes_;
};

}  // namespace penumbra::gltf
