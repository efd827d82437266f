// OpenCV FileStorage in XML, as the tree that its YAML gives. For the .cpp files of this folder: it
// brings yaml-cpp along.
#pragma once

#include <yaml-cpp/yaml.h>

#include <string>
#include <string_view>

#include "core/error.hpp"

namespace penumbra {

// Returns true if the text starts as XML does.
[[nodiscard]] bool is_xml(std::string_view text);

// The map that <opencv_storage> holds. Elements named "_" are the items of a list; a text of
// several words is a list of them, words in quotes are one. An attribute type_id is an entry of its
// map. `name` is the file's name in errors.
[[nodiscard]] Result<YAML::Node> parse_opencv_xml(const std::string& text, const std::string& name);

}  // namespace penumbra
