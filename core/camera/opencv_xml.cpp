#include "core/camera/opencv_xml.hpp"

#include <tinyxml2.h>

#include <algorithm>
#include <set>

#include "core/text/text.hpp"

namespace penumbra {
namespace {

constexpr std::string_view kXmlBlank = " \t\r\n";

// Splits a text at blanks, except within double quotes.
std::vector<std::string> split_words(std::string_view text) {
  std::vector<std::string> words;
  while (true) {
    const std::size_t start = text.find_first_not_of(kXmlBlank);
    if (start == std::string_view::npos) return words;
    text.remove_prefix(start);
    const bool quoted = text.front() == '"' && text.find('"', 1) != std::string_view::npos;
    const std::size_t end =
        quoted ? text.find('"', 1) + 1 : std::min(text.find_first_of(kXmlBlank), text.size());
    words.emplace_back(quoted ? text.substr(1, end - 2) : text.substr(0, end));
    text.remove_prefix(end);
  }
}

Result<YAML::Node> node_of(const tinyxml2::XMLElement& element) {
  YAML::Node node;
  if (element.FirstChildElement() == nullptr) {
    const char* text = element.GetText();
    const std::vector<std::string> words = split_words(text == nullptr ? "" : text);
    if (words.size() == 1) return YAML::Node(words.front());
    for (const std::string& word : words) node.push_back(word);
    return node;
  }
  std::set<std::string> names;
  for (const auto* child = element.FirstChildElement(); child != nullptr;
       child = child->NextSiblingElement()) {
    Result<YAML::Node> value = node_of(*child);
    if (!value) return value;
    const std::string name = child->Name();
    if (name == "_" && (names.empty() || node.IsSequence())) {
      node.push_back(*value);
    } else if (names.insert(name).second && !node.IsSequence()) {
      node[name] = *value;
    } else {
      return fail("line {}: <{}> is there twice; keep one of them", child->GetLineNum(), name);
    }
  }
  if (const char* type = element.Attribute("type_id"); type != nullptr && node.IsMap())
    node["type_id"] = type;
  return node;
}

}  // namespace

bool is_xml(std::string_view text) {
  return trim(text).starts_with('<');
}

Result<YAML::Node> parse_opencv_xml(const std::string& text, const std::string& name) {
  tinyxml2::XMLDocument document;
  if (document.Parse(text.data(), text.size()) != tinyxml2::XML_SUCCESS) {
    return fail("{}: line {}: is not valid XML ({}); correct the line", name,
                std::max(document.ErrorLineNum(), 1), document.ErrorName());
  }
  const tinyxml2::XMLElement* root = document.FirstChildElement("opencv_storage");
  if (root == nullptr) {
    return fail(
        "{}: is XML, but no FileStorage of OpenCV (there is no <opencv_storage>); give a camera "
        "file of ROS, OpenCV, Kalibr or mrcal",
        name);
  }
  try {
    Result<YAML::Node> node = node_of(*root);
    if (!node) return fail_in(name, node.error());
    if (!node->IsMap()) return fail("{}: <opencv_storage> holds no named values", name);
    return node;
  } catch (const std::exception& error) {
    return fail("{}: is not readable as a FileStorage of OpenCV ({})", name, error.what());
  }
}

}  // namespace penumbra
