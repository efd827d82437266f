// Joins warnings of the same kind into one line.
#pragma once

#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <string_view>
#include <vector>

namespace penumbra::gltf {

class Notes {
 public:
  // `text` describes a problem and its consequence; the second argument is the problem's JSON path.
  // `expected` notes concern valid content; only a model without visible content reports them.
  void add(std::string_view text, const std::string& json_path, bool expected = false) {
    const auto note = std::ranges::find(notes_, text, &Note::text);
    if (note == notes_.end()) {
      notes_.push_back({std::string(text), json_path, 1, expected});
    } else {
      ++note->count;
      note->expected = note->expected && expected;
    }
  }

  // Returns the line of the first note, expected or not; empty if there is no note.
  [[nodiscard]] std::string first_line() const {
    return notes_.empty() ? "" : line_of(notes_.front());
  }

  // Appends one line per kind: the first JSON path, and the number of others.
  void append_to(std::vector<std::string>& lines) const {
    for (const Note& note : notes_) {
      if (!note.expected) lines.push_back(line_of(note));
    }
  }

 private:
  struct Note {
    std::string text;
    std::string first_json_path;
    std::size_t count = 0;
    bool expected = false;
  };
  static std::string line_of(const Note& note) {
    const std::string more = note.count > 1 ? fmt::format(" (and {} more)", note.count - 1) : "";
    return fmt::format("{}{}: {}", note.first_json_path, more, note.text);
  }

  std::vector<Note> notes_;
};

}  // namespace penumbra::gltf
