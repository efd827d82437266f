// Checks that debian/ agrees with the lists of the project: packages.txt, the exported symbols, the
// version.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <regex>
#include <set>
#include <sstream>
#include <string>

#include "support/paths.hpp"

namespace penumbra {
namespace {

std::string text_of(const char* file) {
  std::ifstream in(test::source_dir() / file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

// Returns the packages of packages.txt that a build without tests needs.
std::set<std::string> packages_to_build() {
  std::istringstream lines(text_of("packages.txt"));
  std::set<std::string> packages;
  for (std::string line; std::getline(lines, line) && line.rfind("# tests", 0) != 0;) {
    if (!line.empty() && line[0] != '#') packages.insert(line);
  }
  return packages;
}

std::set<std::string> build_depends() {
  const std::string control = text_of("debian/control");
  const std::size_t start = control.find("Build-Depends:");
  const std::string field = control.substr(start, control.find("\nStandards-Version:") - start);
  static const std::regex entry(R"(\n ([a-z0-9][a-z0-9.+-]+))");
  std::set<std::string> packages;
  for (std::sregex_iterator match(field.begin(), field.end(), entry), end; match != end; ++match)
    packages.insert((*match)[1]);
  return packages;
}

TEST(Packages, BuildDependsAreThoseOfPackageList) {
  std::set<std::string> expected = packages_to_build();
  expected.erase("g++");  // Debian's build-essential, never listed
  expected.insert("debhelper-compat");
  expected.insert("dh-sequence-python3");
  EXPECT_THAT(expected, testing::Contains("libceres-dev"));
  EXPECT_EQ(build_depends(), expected);
}

// dpkg-gensymbols compares the list with the library, but only while packages are built.
TEST(Packages, SymbolsAreTheExportedOnes) {
  std::set<std::string> symbols;
  std::istringstream lines(text_of("debian/libpenumbra0.symbols"));
  static const std::regex symbol(R"re( \(c\+\+\)"(.*)@PENUMBRA_0" [0-9.]+~)re");
  std::smatch match;
  for (std::string line; std::getline(lines, line);) {
    if (std::regex_match(line, match, symbol)) symbols.insert(match[1]);
  }
  std::set<std::string> exported;
  lines = std::istringstream(text_of("library/exported-symbols.txt"));
  for (std::string line; std::getline(lines, line);) exported.insert(line);
  EXPECT_THAT(exported, testing::Not(testing::IsEmpty()));
  EXPECT_EQ(symbols, exported);
}

TEST(Packages, ChangelogHasVersionOfProgram) {
  const std::string cmake = text_of("CMakeLists.txt");
  const std::string changelog = text_of("debian/changelog");
  std::smatch version;
  ASSERT_TRUE(std::regex_search(cmake, version, std::regex(R"(VERSION (\d+\.\d+\.\d+) )")));
  EXPECT_THAT(changelog, testing::StartsWith("penumbra (" + version[1].str() + ") "));
}

}  // namespace
}  // namespace penumbra
