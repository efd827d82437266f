// Checks the dependency rules of #include directives between modules (core <- tracking <- calib,
// core <- render, all <- app, all <- library, all <- tests) and between the folders inside a
// module.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "support/paths.hpp"

namespace penumbra {
namespace {

using Arrows = std::map<std::string, std::set<std::string>>;

// Module -> other modules whose headers it may include.
const Arrows kAllowed = {
    {"core", {}},
    {"tracking", {"core"}},
    {"calib", {"core", "tracking"}},
    {"render", {"core"}},
    {"library", {"core", "tracking", "calib", "render"}},
    {"python", {}},  // only the public headers
    {"app", {"core", "tracking", "calib", "render"}},
    {"tools", {"core", "tracking", "calib", "render", "app"}},
};

// Module -> prefixes of library headers that it must not include.
const std::map<std::string, std::vector<std::string>> kForbiddenLibraries = {
    {"core", {"epoxy", "GL/", "GLFW", "opencv2", "ceres", "apriltag"}},
    {"tracking", {"epoxy", "GL/", "EGL/", "GLFW", "linux/videodev2"}},
    {"calib", {"epoxy", "GL/", "EGL/", "GLFW", "linux/videodev2"}},
    {"render", {"apriltag", "ceres", "opencv2", "linux/videodev2"}},
    {"library", {"epoxy", "GL/", "EGL/", "GLFW", "linux/videodev2"}},
};

// Rule inside a module: files whose path matches the first expression must not include headers that
// match the second.
struct FolderRule {
  std::regex file, header;
};
const std::vector<FolderRule>& folder_rules() {
  static const std::vector<FolderRule> rules = [] {
    constexpr std::pair<const char*, const char*> kRules[] = {
        {"calib/survey/.*", "calib/refinement/.*"},
        {"render/shadow/.*", "render/passes/.*"},
        {"render/(scene|model)/.*", "render/shadow/.*"},
        {"render/gl/.*", "render/(?!gl/).*"},
        // The library, and the part of render that it links (penumbra_shadow), have no OpenGL.
        {"(library|render/shadow)/.*",
         R"(render/(?!shadow/|model/|scene/(scene|plane_frame|plane_outline|technique|layered_constants)\.hpp).*)"},
        {"tracking/alignment/.*", R"(tracking/[^/]+\.hpp)"},  // the trackers
        {"app/capture/.*", "app/output/.*"},
        {"app/output/.*", "app/capture/.*"},
        {"app/session/.*", "app/(run|window|output|report|recording)/.*"},
        {"app/(window|output|report)/.*", "app/run/.*"},
    };
    std::vector<FolderRule> made;
    for (const auto& [file, header] : kRules)
      made.push_back({std::regex(file), std::regex(header)});
    return made;
  }();
  return rules;
}

// Returns true if the header belongs to another pass than the file.
bool is_another_pass(const std::string& file, const std::string& header) {
  static const std::regex pass(R"(render/passes/(\w+_pass)\.\w+)");
  std::smatch of_file;
  std::smatch of_header;
  return std::regex_match(file, of_file, pass) && std::regex_match(header, of_header, pass) &&
         of_file[1] != of_header[1];
}

bool breaks_folder_rule(const std::string& file, const std::string& header) {
  return is_another_pass(file, header) ||
         std::ranges::any_of(folder_rules(), [&](const FolderRule& rule) {
           return std::regex_match(file, rule.file) && std::regex_match(header, rule.header);
         });
}

std::vector<std::string> violations_in(const std::string& module, const std::string& name,
                                       const std::string& text) {
  std::vector<std::string> found;
  static const std::regex include_line(R"(^\s*#\s*include\s*([<"])([^>"]+)[>"])");
  std::istringstream lines(text);
  std::string line;
  while (std::getline(lines, line)) {
    std::smatch match;
    if (!std::regex_search(line, match, include_line)) continue;
    const std::string target = match[2];
    if (match[1] == "\"") {
      if (breaks_folder_rule(name, target)) found.push_back(name + " includes " + target);
      const std::string other = target.substr(0, target.find('/'));
      if (other == module || kAllowed.count(other) == 0) {
        if (other == "tests") found.push_back(name + " includes " + target);
        continue;
      }
      if (kAllowed.at(module).count(other) == 0) found.push_back(name + " includes " + target);
    } else if (const auto forbidden = kForbiddenLibraries.find(module);
               forbidden != kForbiddenLibraries.end()) {
      for (const std::string& start : forbidden->second) {
        if (target.rfind(start, 0) == 0) found.push_back(name + " includes <" + target + ">");
      }
    }
  }
  return found;
}

TEST(IncludeRules, HoldInWholeTree) {
  std::vector<std::string> found;
  int files = 0;
  for (const auto& [module, allowed] : kAllowed) {
    const std::filesystem::path folder = test::source_dir() / module;
    if (!std::filesystem::is_directory(folder)) continue;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
      const std::string extension = entry.path().extension().string();
      if (extension != ".hpp" && extension != ".cpp") continue;
      ++files;
      std::ifstream in(entry.path());
      std::stringstream text;
      text << in.rdbuf();
      const std::string name = std::filesystem::relative(entry.path(), test::source_dir()).string();
      for (std::string& violation : violations_in(module, name, text.str()))
        found.push_back(std::move(violation));
    }
  }
  EXPECT_GT(files, 20);
  EXPECT_THAT(found, testing::IsEmpty());
}

// The public headers use only the standard library and each other.
TEST(IncludeRules, KeepPublicHeadersSelfContained) {
  const std::regex include_line(R"(^\s*#\s*include\s*(.*)$)");
  const std::regex allowed(R"(<(\w+|penumbra/\w+\.hpp)>)");
  std::vector<std::string> found;
  int files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(test::source_dir() / "include" / "penumbra")) {
    ++files;
    std::ifstream in(entry.path());
    for (std::string line; std::getline(in, line);) {
      std::smatch match;
      if (std::regex_match(line, match, include_line) && !std::regex_match(match.str(1), allowed))
        found.push_back(entry.path().filename().string() + " includes " + match.str(1));
    }
  }
  EXPECT_GE(files, 8);
  EXPECT_THAT(found, testing::IsEmpty());
}

TEST(IncludeRules, DetectPlantedViolations) {
  EXPECT_THAT(
      violations_in("render", "render/x.cpp", "#include \"tracking/detection/tag_detector.hpp\"\n"),
      testing::SizeIs(1));
  EXPECT_THAT(violations_in("core", "core/x.hpp", "  #  include \"render/scene/scene.hpp\"\n"),
              testing::SizeIs(1));
  EXPECT_THAT(violations_in("tracking", "tracking/x.cpp", "#include <epoxy/gl.h>\n"),
              testing::SizeIs(1));
  EXPECT_THAT(violations_in("app", "app/x.cpp", "#include \"tests/support/paths.hpp\"\n"),
              testing::SizeIs(1));
  EXPECT_THAT(violations_in("tracking", "tracking/x.cpp",
                            "#include \"core/image/frame.hpp\"\n#include <ceres/ceres.h>\n"),
              testing::IsEmpty());
}

TEST(IncludeRules, DetectPlantedViolationsInsideModules) {
  const std::vector<std::pair<std::string, std::string>> bad = {
      {"render/shadow/masks/x.cpp", "render/passes/layers/mask_quad.hpp"},
      {"render/scene/scene_file.cpp", "render/shadow/layers/layered_penumbra.hpp"},
      {"render/model/x.hpp", "render/shadow/kernels/kernel_file.hpp"},
      {"render/gl/texture.hpp", "render/model/model.hpp"},
      {"render/gl/x.cpp", "render/translucency.hpp"},
      {"render/passes/received_shadow_pass.cpp", "render/passes/shadow_pass.hpp"},
      {"tracking/alignment/x.cpp", "tracking/table_tracker.hpp"},
      {"app/capture/x.cpp", "app/output/video_writer.hpp"},
      {"app/output/x.cpp", "app/capture/recording.hpp"},
      {"library/x.cpp", "app/report/versions.hpp"},
      {"python/x.cpp", "core/image/frame.hpp"},
      {"library/x.cpp", "render/gl/texture.hpp"},
      {"library/x.cpp", "render/scene/scene_json.hpp"},
      {"render/shadow/x.cpp", "render/compositor.hpp"},
  };
  for (const auto& [file, header] : bad) {
    EXPECT_THAT(
        violations_in(file.substr(0, file.find('/')), file, "#include \"" + header + "\"\n"),
        testing::SizeIs(1))
        << file << " includes " << header;
  }
  EXPECT_THAT(violations_in("render", "render/passes/shadow_pass.cpp",
                            "#include \"render/passes/shadow_pass.hpp\"\n"
                            "#include \"render/shadow/layers/twist.hpp\"\n"),
              testing::IsEmpty());
}

}  // namespace
}  // namespace penumbra
