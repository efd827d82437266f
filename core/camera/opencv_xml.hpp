// OpenCV FileStorage in XML, as the tree that its YAML gives. For .cpp files only: it brings
// yaml-cpp along.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns true if the text starts as XML does.
[[nodiscard]] bool is_xml(std::string_view text);

// Returns the map in <opencv_storage>. Elements named "_" are list items; a text of several words
// is a list, and words in quotes are one. An attribute type_id becomes an entry of its map. `name`
// is the file's name in errors.
[[nodiscard]] Result<YAML::Node> parse_opencv_xml(const std::string& text, const std::string& name);

}  // namespace penumbra
