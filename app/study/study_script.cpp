#include "app/study/study_script.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <tuple>
#include <utility>

#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/gl/context.hpp"

namespace penumbra {
namespace {

constexpr std::size_t kMaxScriptBytes = std::size_t{4} << 20U;
constexpr std::int64_t kMaxTrials = 1'000'000;
constexpr std::int64_t kMaxTime_ns = 86'400'000'000'000;  // a day
constexpr std::int64_t kNoTime = -1;
constexpr double kMaxCoordinate = 1e5;  // [m], [px]

using Words = std::span<const std::string_view>;

std::vector<std::string_view> split_words(std::string_view line) {
  constexpr std::string_view kBlanks = " \t\r";
  line = line.substr(0, line.find('#'));
  std::vector<std::string_view> words;
  std::size_t at = line.find_first_not_of(kBlanks);
  while (at != std::string_view::npos) {
    const std::size_t end = std::min(line.find_first_of(kBlanks, at), line.size());
    words.push_back(line.substr(at, end - at));
    at = line.find_first_not_of(kBlanks, end);
  }
  return words;
}

std::optional<Eigen::Vector3d> point_of(Words numbers) {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    const auto number = parse_number(numbers[i]);
    if (!number || !std::isfinite(*number) || std::abs(*number) > kMaxCoordinate)
      return std::nullopt;
    point[static_cast<Eigen::Index>(i)] = *number;
  }
  return point;
}

std::optional<ScriptPlace> place_of(Words words) {
  if (words.empty()) return std::nullopt;
  ScriptPlace place;
  if (words[0] == "ball" && words.size() == 1) {
    place.object = "ball";
    return place;
  }
  if (words[0] == "sphere" && words.size() == 2) {
    if (words[1] != "1" && words[1] != "2" && words[1] != "3") return std::nullopt;
    place.object = "sphere " + std::string(words[1]);
    return place;
  }
  using Kind = ScriptPlace::Kind;
  for (const auto& [word, kind, count] : {std::tuple{"table", Kind::table, std::size_t{4}},
                                          std::tuple{"by", Kind::by, std::size_t{4}},
                                          std::tuple{"pixel", Kind::pixel, std::size_t{3}}}) {
    if (words[0] != word || words.size() != count) continue;
    const auto point = point_of(words.subspan(1));
    if (!point) return std::nullopt;
    place.kind = kind;
    place.point = *point;
    return place;
  }
  return std::nullopt;
}

std::optional<int> button_of(std::string_view word) {
  if (word == "left") return WindowEvent::kLeft;
  if (word == "middle") return WindowEvent::kMiddle;
  if (word == "right") return WindowEvent::kRight;
  return std::nullopt;
}

// Parses the words of a line that follow its trial and time.
std::optional<ScriptAction> action_of(Words words) {
  using Kind = ScriptAction::Kind;
  ScriptAction action;
  if (words.size() == 1 && (words[0] == "release" || words[0] == "accept")) {
    action.kind = words[0] == "release" ? Kind::release : Kind::accept;
    return action;
  }
  Words place = words.subspan(1);
  if (words[0] == "click" || words[0] == "move") {
    action.kind = words[0] == "click" ? Kind::click : Kind::move;
  } else if (words[0] == "press" && words.size() > 1) {
    const auto button = button_of(words[1]);
    if (!button) return std::nullopt;
    action.kind = Kind::press;
    action.button = *button;
    place = words.subspan(2);
  } else {
    return std::nullopt;
  }
  const auto at = place_of(place);
  if (!at || (at->kind == ScriptPlace::Kind::by && action.kind != Kind::move)) return std::nullopt;
  action.place = *at;
  return action;
}

}  // namespace

Result<StudyScript> parse_study_script(std::string_view text, std::string name) {
  StudyScript script;
  script.name = std::move(name);
  bool held = false;
  int line_number = 0;
  while (!text.empty()) {
    ++line_number;
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::vector<std::string_view> words = split_words(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
    if (words.empty()) continue;
    const auto trial = parse_integer(words[0]);
    const std::int64_t at_ns =
        words.size() > 1 ? parse_seconds_as_ns(words[1]).value_or(kNoTime) : kNoTime;
    if (!trial || *trial < 1 || *trial > kMaxTrials || at_ns < 0 || at_ns > kMaxTime_ns ||
        words.size() < 3) {
      return fail(
          "{}: line {}: starts with no trial and time; write the trial's number from 1, the "
          "seconds since it is shown, and what is done, such as: 1 1.25 click sphere 2",
          script.name, line_number);
    }
    auto action = action_of(Words(words).subspan(2));
    if (!action) {
      return fail(
          "{}: line {}: names no action; write click PLACE, press left|middle|right PLACE, move "
          "PLACE, release or accept, and for PLACE: sphere 1..3, ball, table X Y Z, pixel U V, or "
          "after move: by DX DY DZ",
          script.name, line_number);
    }
    action->line = line_number;
    action->trial = static_cast<int>(*trial);
    action->at_ns = at_ns;
    const bool same_trial = !script.actions.empty() && script.actions.back().trial == action->trial;
    if (!script.actions.empty() && (script.actions.back().trial > action->trial ||
                                    (same_trial && script.actions.back().at_ns > action->at_ns))) {
      return fail("{}: line {}: is earlier than the line before; put the lines in order",
                  script.name, line_number);
    }
    if (!same_trial) held = false;
    using Kind = ScriptAction::Kind;
    if (held && (action->kind == Kind::press || action->kind == Kind::click)) {
      return fail("{}: line {}: presses a button while one is down; write release before it",
                  script.name, line_number);
    }
    const bool by = action->kind == Kind::move && action->place.kind == ScriptPlace::Kind::by;
    if (!held && (action->kind == Kind::release || by)) {
      return fail("{}: line {}: nothing is held there; write press before it in the same trial",
                  script.name, line_number);
    }
    if (action->kind == Kind::press) held = true;
    if (action->kind == Kind::release) held = false;
    script.actions.push_back(std::move(*action));
  }
  if (script.actions.empty()) {
    return fail("{}: holds no action; write lines such as: 1 1.25 click sphere 2", script.name);
  }
  return script;
}

Result<StudyScript> load_study_script(const std::filesystem::path& file) {
  PENUMBRA_TRY(const auto text, read_text_file(file, kMaxScriptBytes));
  return parse_study_script(text, file.string());
}

}  // namespace penumbra
