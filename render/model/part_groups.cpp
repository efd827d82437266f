#include "render/model/part_groups.hpp"

#include <algorithm>
#include <cstddef>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

// Wildcard match: * matches any characters, ? one. Backtracks only to the most recent *.
bool matches(std::string_view pattern, std::string_view name) {
  std::size_t p = 0, n = 0;
  std::size_t star = std::string_view::npos, star_name = 0;
  while (n < name.size()) {
    if (p < pattern.size() && pattern[p] == '*') {
      star = p++;
      star_name = n;
    } else if (p < pattern.size() && (pattern[p] == '?' || pattern[p] == name[n])) {
      ++p;
      ++n;
    } else if (star != std::string_view::npos) {
      p = star + 1;
      n = ++star_name;
    } else {
      return false;
    }
  }
  return pattern.find_first_not_of('*', p) == std::string_view::npos;
}

}  // namespace

std::vector<bool> nodes_of_group(const Model& model, const std::string& group) {
  std::vector<bool> members(model.nodes.size(), group == kGroupOfAll);
  for (std::size_t i = 0; i < members.size(); ++i) {
    const ModelNode& node = model.nodes[i];
    // Parents precede their children.
    const bool inherited = node.parent >= 0 && members[static_cast<std::size_t>(node.parent)];
    const auto named = [&group](const std::string& name) {
      return !name.empty() && matches(group, name);
    };
    members[i] = members[i] || inherited || named(node.name) || named(node.mesh);
  }
  return members;
}

Result<void> check_groups(const Model& model, std::span<const std::string> groups) {
  for (const std::string& group : groups) {
    if (group == kGroupOfAll) continue;
    const std::vector<bool> members = nodes_of_group(model, group);
    if (std::ranges::find(members, true) != members.end()) continue;
    constexpr std::size_t kMaxNames = 12;
    std::vector<std::string> names;
    for (const ModelNode& node : model.nodes) {
      const std::string& name = node.name.empty() ? node.mesh : node.name;
      if (!name.empty() && std::ranges::find(names, name) == names.end()) {
        names.push_back(names.size() < kMaxNames ? shortened(name, 60) : "...");
      }
      if (names.size() > kMaxNames) break;
    }
    return fail("group \"{}\": the model \"{}\" has no such node, mesh or object; {}",
                shortened(group, 60), model.name,
                names.empty() ? "it names none: give all"
                              : fmt::format("there are: all, {}", fmt::join(names, ", ")));
  }
  return {};
}

}  // namespace penumbra
