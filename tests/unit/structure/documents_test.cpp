// Checks that the documents name every key of scenes and reports, and that every link and reference
// leads to a file and a heading.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

#include "support/paths.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

std::string text_of_file(const fs::path& file) {
  std::ifstream in(file);
  std::stringstream text;
  text << in.rdbuf();
  return text.str();
}

// Returns the first group of each match of the expression.
std::vector<std::string> all_matches(const std::string& text, const std::string& expression) {
  const std::regex regex(expression);
  std::vector<std::string> found;
  for (std::sregex_iterator match(text.begin(), text.end(), regex), end; match != end; ++match)
    found.push_back((*match)[1]);
  return found;
}

// Returns the words in a document's `code` spans.
std::set<std::string> words_in_code(const std::string& document) {
  std::set<std::string> words;
  for (const std::string& code : all_matches(document, "`([^`\n]+)`")) {
    for (const std::string& word : all_matches(code, R"(([\w$]+))")) words.insert(word);
  }
  return words;
}

// Returns the keys that do not occur in the document's `code` spans.
std::set<std::string> keys_missing_in(const char* document, const std::set<std::string>& keys) {
  const std::set<std::string> words =
      words_in_code(text_of_file(test::source_dir() / "docs" / document));
  std::set<std::string> missing;
  std::ranges::set_difference(keys, words, std::inserter(missing, missing.end()));
  return missing;
}

// A schema's keys are the names inside the braces of each "properties".
std::set<std::string> keys_of_schema(const std::string& schema) {
  std::set<std::string> keys;
  std::vector<bool> is_properties;  // for each open brace: whether it belongs to "properties"
  bool opens_properties = false;    // whether the next brace belongs to "properties"
  for (std::size_t at = 0; at < schema.size(); ++at) {
    if (schema[at] == '{') {
      is_properties.push_back(opens_properties);
      opens_properties = false;
    } else if (schema[at] == '}') {
      is_properties.pop_back();
    } else if (schema[at] == '"') {
      const std::size_t start = at + 1;
      for (++at; schema[at] != '"'; ++at) at += schema[at] == '\\' ? 1U : 0U;
      const std::string name = schema.substr(start, at - start);
      const bool is_key = schema.compare(at + 1, 1, ":") == 0;
      if (is_key && is_properties.back()) {
        keys.insert(name);
      } else if (is_key) {
        opens_properties = name == "properties";
      }
    }
  }
  return keys;
}

TEST(Documents, DescribeEverySceneKey) {
  const std::set<std::string> keys =
      keys_of_schema(text_of_file(test::source_dir() / "scenes" / "scene.schema.json"));
  EXPECT_THAT(keys, testing::IsSupersetOf({"$schema", "casters", "keyframes", "north_deg"}));
  EXPECT_THAT(keys, testing::Not(testing::Contains("additionalProperties")));
  EXPECT_THAT(keys_missing_in("scenes.md", keys), testing::IsEmpty());
}

// A source file that writes report keys, and the text around a key in it.
struct KeySource {
  const char* file;
  const char* key;
};
constexpr const char* kQuotedWord = R"re("([A-Za-z]\w*)")re";
constexpr const char* kFirstOfBraces = R"re(\{"([a-z]\w+)",)re";
constexpr std::array kKeySources = {
    KeySource{"app/report/run_report.cpp", kQuotedWord},
    KeySource{"app/report/split_half_report.cpp", R"re((?:\["|\{")([a-z]\w+)")re"},
    KeySource{"app/report/versions.cpp", kFirstOfBraces},
    KeySource{"app/capture/capture_stats.cpp", kFirstOfBraces},
    KeySource{"app/commands/shadow_text.cpp", kQuotedWord},
    KeySource{"core/camera/camera_file.cpp", R"re(add\("(\w+)")re"},
    KeySource{"core/camera/camera_file.cpp",
              R"re((calibrated_on|focus_position|standard_deviations|\w+_(?:px|m)): [{\[])re"},
    KeySource{"core/evaluation/pairing.cpp", R"re("(outside_truth|gap_too_long)")re"},
    KeySource{"core/geometry/tracking_reasons.cpp", kFirstOfBraces},
    KeySource{"render/render_work.hpp", kQuotedWord},
    KeySource{"render/render_work.cpp", kFirstOfBraces},
    KeySource{"render/scene/shadow_events.hpp", kQuotedWord},
    KeySource{"app/study/study_results.hpp", R"re((\w+),(?=[\w,]*"))re"},
    KeySource{"app/study/study_results.cpp", R"re((\w+_(?:low|high)(?:_[ms])?)[,\\])re"},
};

std::set<std::string> keys_of(const KeySource& source) {
  // Comments and #include lines have no keys.
  const std::regex comment(R"(//[^\n]*|#include[^\n]*)");
  const std::string code =
      std::regex_replace(text_of_file(test::source_dir() / source.file), comment, "");
  const std::vector<std::string> found = all_matches(code, source.key);
  return {found.begin(), found.end()};
}

TEST(Documents, DescribeEveryReportKey) {
  // The expressions also match these words of printed tables.
  const std::set<std::string> no_keys = {"error", "s"};
  for (const KeySource& source : kKeySources) {
    std::set<std::string> keys = keys_of(source);
    EXPECT_THAT(keys, testing::Not(testing::IsEmpty())) << source.file << ": " << source.key;
    std::erase_if(keys, [&](const std::string& key) { return no_keys.contains(key); });
    EXPECT_THAT(keys_missing_in("reports.md", keys), testing::IsEmpty()) << source.file;
  }
}

// Returns GitHub's anchor of a heading: lower-case letters, digits, - and _; blanks become -.
std::string anchor_of(const std::string& heading) {
  // A link contributes its text, not its target.
  const std::string plain =
      std::regex_replace(heading, std::regex(R"(\[([^\]]*)\]\([^)]*\))"), "$1");
  std::string anchor;
  for (const char c : plain) {
    const auto byte = static_cast<unsigned char>(c);
    if (std::isalnum(byte) != 0 || c == '-' || c == '_' || byte >= 0x80U) {
      anchor += static_cast<char>(std::tolower(byte));
    } else if (c == ' ') {
      anchor += '-';
    }
  }
  return anchor;
}

// Removes fenced code blocks.
std::string without_code_blocks(const std::string& document) {
  std::istringstream lines(document);
  std::string text;
  std::string line;
  bool in_block = false;
  while (std::getline(lines, line)) {
    const bool is_fence = line.starts_with("```");
    if (is_fence) in_block = !in_block;
    if (!in_block && !is_fence) text += line + "\n";
  }
  return text;
}

// Returns the anchors of a Markdown file. Repeated headings get -1, -2, ... appended.
std::set<std::string> anchors_in(const std::string& document) {
  std::set<std::string> anchors;
  std::map<std::string, int> repeats;
  for (const std::string& heading :
       all_matches("\n" + without_code_blocks(document), R"(\n#{1,6} +([^\n]*[^\s#]))")) {
    const std::string anchor = anchor_of(heading);
    const int repeat = repeats[anchor]++;
    anchors.insert(repeat == 0 ? anchor : anchor + "-" + std::to_string(repeat));
  }
  return anchors;
}

TEST(HeadingAnchors, MatchGitHub) {
  EXPECT_THAT(anchors_in("# Report of a run\ntext\n## `tags.yaml`, & more\n## Work\n## Work\n"
                         "```\n# no heading\n```\n#no heading\n"),
              testing::UnorderedElementsAre("report-of-a-run", "tagsyaml--more", "work", "work-1"));
}

// Returns why a link's target does not exist, or an empty string. Relative paths begin at `folder`.
std::string problem_of(const std::string& target, const fs::path& file, const fs::path& folder) {
  const std::size_t hash = target.find('#');
  const std::string path = target.substr(0, hash);
  const fs::path goal = path.empty() ? file : (folder / path).lexically_normal();
  const std::string name = fs::relative(file, test::source_dir()).string() + ": " + target;
  if (!fs::exists(goal)) return name + ": no such file";
  if (hash == std::string::npos) return {};
  return anchors_in(text_of_file(goal)).contains(target.substr(hash + 1))
             ? std::string()
             : name + ": no such heading";
}

// Returns the project's files with one of these extensions, without generated and shared files.
std::vector<fs::path> files_with(const std::set<std::string>& extensions) {
  static const std::set<std::string> kNotOurs = {"build", ".git", "recordings", "shared"};
  std::vector<fs::path> files;
  for (fs::recursive_directory_iterator entry(test::source_dir()), end; entry != end; ++entry) {
    if (entry->is_directory() && entry.depth() == 0 &&
        kNotOurs.contains(entry->path().filename().string())) {
      entry.disable_recursion_pending();
    } else if (entry->is_regular_file() &&
               extensions.contains(entry->path().extension().string())) {
      files.push_back(entry->path());
    }
  }
  return files;
}

TEST(Documents, HaveLinksToExistingFilesAndHeadings) {
  std::vector<std::string> problems;
  int links = 0;
  for (const fs::path& file : files_with({".md"})) {
    // These files are fragments that scripts/benchmark joins in another folder.
    if (file.parent_path().filename() == "benchmarks" &&
        file.parent_path().parent_path().filename() == "tests")
      continue;
    const std::string text = without_code_blocks(text_of_file(file));
    for (const std::string& target : all_matches(text, R"(\]\(([^)\s]+)\))")) {
      if (target.find("://") != std::string::npos || target.starts_with("mailto:")) continue;
      ++links;
      const std::string problem = problem_of(target, file, file.parent_path());
      if (!problem.empty()) problems.push_back(problem);
    }
  }
  EXPECT_GT(links, 20);
  EXPECT_THAT(problems, testing::IsEmpty());
}

TEST(Documents, HaveReferencesToExistingHeadings) {
  std::vector<std::string> problems;
  int references = 0;
  for (const fs::path& file : files_with({".md", ".hpp", ".cpp", ".glsl"})) {
    if (file.filename() == "documents_test.cpp") continue;
    std::istringstream lines(text_of_file(file));
    std::string line;
    while (std::getline(lines, line)) {
      if (line.find(".md#") == std::string::npos) continue;  // faster than the regex
      for (const std::string& target :
           all_matches(line, R"(\b((?:docs/[\w/-]+|[A-Z]+)\.md#[\w-]+))")) {
        ++references;
        const std::string problem = problem_of(target, file, test::source_dir());
        if (!problem.empty()) problems.push_back(problem);
      }
    }
  }
  EXPECT_GT(references, 50);
  EXPECT_THAT(problems, testing::IsEmpty());
}

}  // namespace
}  // namespace penumbra
