// Parses OpenCV FileStorage XML into the same tree as its YAML. Include in .cpp files only, because
// it includes yaml-cpp.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Checks the start of the text only.
[[nodiscard]] bool is_xml(std::string_view text);

// Returns the map in <opencv_storage>. Elements named "_" are list items. Text of several words is
// a list; a quoted string is one item. An attribute type_id becomes an entry of its element's map.
// `name` is the file's name in errors.
[[nodiscard]] Result<YAML::Node> parse_opencv_xml(const std::string& text, const std::string& name);

}  // namespace penumbra
