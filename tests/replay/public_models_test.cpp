// The OBJ and glTF models of Debian's assimp-testmodels, collected from public bug reports. Each
// must have the area in the table, or be rejected for the reason in the table. The short form tests
// every sixth model of the two large folders, the nightly form all.
#include <gmock/gmock.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <optional>
#include <regex>
#include <sstream>

#include "core/text/text.hpp"
#include "replay_support.hpp"
#include "support/test_form.hpp"

namespace penumbra::test {
namespace {

namespace fs = std::filesystem;

const fs::path kModels = "/usr/share/assimp/models";
// Planes far below the models, so that they clip none. Projections are along the vertical and an
// oblique direction, as in tests/reference/model_areas.py.
constexpr const char* kVerticalPlane = "0 0 1 0 0 -1000000";
constexpr const char* kObliquePlane = "0.6 0.48 0.64 -600000 -480000 -640000";

// A row of tests/reference/public_models.csv. For a partly readable file, the row may have both
// areas and a reason; either result passes.
struct ExpectedModel {
  bool in_debian_12 = true;
  std::optional<double> vertical_cm2;
  std::optional<double> oblique_cm2;
  double extent_m = 0.0;
  std::string message;  // regular expression for the error; empty if none is expected
};

std::map<std::string, ExpectedModel> expected_models() {
  std::map<std::string, ExpectedModel> models;
  std::ifstream table(source_dir() / "tests" / "reference" / "public_models.csv");
  std::string line;
  std::getline(table, line);
  EXPECT_EQ(line, "file,debian,vertical_cm2,oblique_cm2,extent_m,message,remark");
  while (std::getline(table, line)) {
    std::istringstream row(line);
    std::vector<std::string> cells(7);
    for (std::string& cell : cells) std::getline(row, cell, ',');
    ExpectedModel& model = models[cells[0]];
    model.in_debian_12 = cells[1] == "12";
    model.vertical_cm2 = parse_number(cells[2]);
    model.oblique_cm2 = parse_number(cells[3]);
    model.extent_m = parse_number(cells[4]).value_or(0.0);
    model.message = cells[5];
    EXPECT_EQ(model.vertical_cm2.has_value(), model.oblique_cm2.has_value()) << line;
    EXPECT_TRUE(model.vertical_cm2 || !model.message.empty()) << line;
  }
  return models;
}

bool is_model(const fs::path& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension == ".obj" || extension == ".gltf" || extension == ".glb";
}

// Returns the models' names as written in the table.
std::vector<std::string> installed_models() {
  std::vector<std::string> names;
  for (const auto& entry : fs::recursive_directory_iterator(kModels)) {
    if (entry.is_regular_file() && is_model(entry.path())) {
      names.push_back(entry.path().lexically_relative(kModels).string());
    }
  }
  std::ranges::sort(names);
  return names;
}

// Expects exit code 0 with warnings of one line each, or exit code 1 with one error that names the
// file.
void expect_one_line_messages(const ProgramResult& result, const std::string& name) {
  if (result.exit_code != 0) {
    expect_failure(result, {name});
    return;
  }
  for (const std::string& line : lines_of(result.err)) {
    EXPECT_TRUE(line.starts_with("penumbra: warning: ")) << line;
  }
}

// CI runs scripts/setup, which installs the package. Elsewhere the tests may be skipped.
bool is_required() {
  return std::getenv("CI") != nullptr;
}

class PublicModels : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    if (fs::is_directory(kModels)) return;
    if (is_required()) FAIL() << "CI is set, but assimp-testmodels is missing (scripts/setup)";
    GTEST_SKIP() << "the package assimp-testmodels is missing (scripts/setup installs it)";
  }
  // Returns the area of the model's projection onto the plane [cm2]; nullopt if the file is
  // rejected. `name`: as in the table, or a path.
  std::optional<double> shadow_area(const std::string& name, const std::string& plane,
                                    const ExpectedModel& expected) {
    const fs::path output = folder_.path() / "shadow.json";
    const ProgramResult result = penumbra(
        {"shadow", kModels / name, "--technique", "simple", "--plane", plane, "--output", output});
    expect_one_line_messages(result, name);
    if (result.exit_code != 0) {
      EXPECT_FALSE(expected.message.empty()) << result.err;
      EXPECT_TRUE(std::regex_search(result.err, std::regex(expected.message)))
          << result.err << " does not contain " << expected.message;
      return std::nullopt;
    }
    EXPECT_TRUE(expected.vertical_cm2) << "must be rejected: " << expected.message;
    return 1e4 * read_json(output)["layers"]["shadow"]["area"].get<double>();
  }
  void expect_kernels(const std::string& name, bool readable) {
    const fs::path output = folder_.path() / "kernels.json";
    const ProgramResult result = penumbra({"kernels", kModels / name, "--output", output});
    expect_one_line_messages(result, name);
    EXPECT_EQ(result.exit_code, readable ? 0 : 1) << result.err;
    if (!readable || result.exit_code != 0) return;
    const auto kernels = read_json(output)["kernels"];
    EXPECT_GT(kernels.size(), 0U);
    EXPECT_EQ(kernels.size() % 3, 0U);
    for (const auto& number : kernels) ASSERT_TRUE(std::isfinite(number.get<double>()));
  }
  // Returns the path of the .glb that `kernels` writes; nullopt if the kernels of this model need a
  // .json file.
  std::optional<std::string> with_kernels(const std::string& name) {
    const std::string output = folder_.path() / "kernels.glb";
    const ProgramResult result = penumbra({"kernels", kModels / name, "--output", output});
    expect_one_line_messages(result, name);
    if (result.exit_code == 0) return output;
    EXPECT_THAT(result.err, testing::HasSubstr("store the kernels in a .json file"));
    return std::nullopt;
  }

  TemporaryFolder folder_;
};

// Tolerance: 1e-5 of the area, plus the area of edge-on faces at float precision.
void expect_area(const std::optional<double>& area, const std::optional<double>& expected,
                 double extent_m) {
  if (!area || !expected) return;
  EXPECT_NEAR(*area, *expected, 1e-5 * *expected + 1e-8 * 1e4 * extent_m * extent_m);
}

TEST_P(PublicModels, MatchReferenceAreas) {
  const std::string folder = GetParam();
  const auto models = expected_models();
  const bool is_large = folder == "OBJ" || folder == "glTF2";
  const int step = is_large && !nightly() ? 6 : 1;
  int number = 0;
  int tried = 0;
  int written = 0;  // number of .glb files
  for (const std::string& name : installed_models()) {
    if (!name.starts_with(folder + "/")) continue;
    SCOPED_TRACE(name);
    const auto row = models.find(name);
    if (row == models.end()) {
      ADD_FAILURE() << "is not in tests/reference/public_models.csv";
      continue;
    }
    if (number++ % step != 0) continue;
    ++tried;
    const ExpectedModel& expected = row->second;
    const auto vertical = shadow_area(name, kVerticalPlane, expected);
    expect_area(vertical, expected.vertical_cm2, expected.extent_m);
    const auto oblique = shadow_area(name, kObliquePlane, expected);
    expect_area(oblique, expected.oblique_cm2, expected.extent_m);
    EXPECT_EQ(vertical.has_value(), oblique.has_value());
    expect_kernels(name, vertical.has_value());
    if (!vertical) continue;
    const auto glb = with_kernels(name);
    if (!glb) continue;
    ++written;
    expect_area(shadow_area(*glb, kVerticalPlane, expected), expected.vertical_cm2,
                expected.extent_m);
  }
  EXPECT_GT(tried, 0);
  EXPECT_GE(step * written, is_large ? 10 : 0);
}

INSTANTIATE_TEST_SUITE_P(Folder, PublicModels, testing::Values("OBJ", "glTF", "glTF2", "invalid"),
                         [](const auto& folder) { return std::string(folder.param); });

TEST(PublicModelTable, ListsEveryInstalledModel) {
  if (!fs::is_directory(kModels)) {
    if (is_required()) FAIL() << "CI is set, but assimp-testmodels is missing (scripts/setup)";
    GTEST_SKIP() << "the package assimp-testmodels is missing (scripts/setup installs it)";
  }
  const auto models = expected_models();
  EXPECT_GE(models.size(), 80U);
  std::vector<std::string> named;
  std::vector<std::string> everywhere;
  for (const auto& [name, model] : models) {
    named.push_back(name);
    if (model.in_debian_12) everywhere.push_back(name);
  }
  const std::vector<std::string> installed = installed_models();
  EXPECT_THAT(named, testing::IsSupersetOf(installed));
  EXPECT_THAT(installed, testing::IsSupersetOf(everywhere));
}

}  // namespace
}  // namespace penumbra::test
