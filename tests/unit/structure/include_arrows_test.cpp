// Holds the modules to the arrows between them: core <- tracking <- calib, core <- render, all <-
// app, all <- tests.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace penumbra {
namespace {

using Arrows = std::map<std::string, std::set<std::string>>;

// Module -> modules whose headers it may include (its own are always allowed).
const Arrows kAllowed = {
    {"core", {}},
    {"tracking", {"core"}},
    {"calib", {"core", "tracking"}},
    {"render", {"core"}},
    {"app", {"core", "tracking", "calib", "render"}},
    {"tools", {"core", "tracking", "calib", "render", "app"}},
};

// Libraries that must stay on one side: module -> headers it may not include, by the start of their
// names.
const std::map<std::string, std::vector<std::string>> kForbiddenLibraries = {
    {"core", {"epoxy", "GL/", "GLFW", "opencv2", "ceres", "apriltag"}},
    {"tracking", {"epoxy", "GL/", "EGL/", "GLFW", "linux/videodev2"}},
    {"calib", {"epoxy", "GL/", "EGL/", "GLFW", "linux/videodev2"}},
    {"render", {"apriltag", "ceres", "opencv2", "linux/videodev2"}},
};

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

TEST(IncludeArrows, HoldOverTheWholeTree) {
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

TEST(IncludeArrows, PlantedViolationsAreFound) {
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

}  // namespace
}  // namespace penumbra
