// Runs the command lines in the documents as written, on the bundled data.
//
// A line that needs other data or devices ends in a comment that begins with "needs", such as
// "# needs a camera". A fenced block whose first line names a file ("```json my-scene.json") has
// the contents of the file.

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

#include "replay_support.hpp"

namespace penumbra::test {
namespace {

struct Document {
  std::vector<std::string> command_lines;
  std::map<std::string, std::string> files;  // file name -> contents
};

// Reads the fenced blocks. Joins each line that ends in a backslash with the next one.
Document read_document(const std::filesystem::path& file) {
  constexpr std::string_view kFence = "```";
  constexpr std::string_view kProgram = "penumbra ";
  Document document;
  bool in_block = false;
  std::string* contents = nullptr;  // contents of the block's file
  std::string joined;
  for (const std::string& line : lines_of(bytes_of(file))) {
    if (line.starts_with(kFence)) {
      in_block = !in_block;
      const std::size_t blank = line.find(' ');
      contents = in_block && blank != std::string::npos ? &document.files[line.substr(blank + 1)]
                                                        : nullptr;
    } else if (contents != nullptr) {
      *contents += line + "\n";
    } else if (in_block && (!joined.empty() || line.starts_with(kProgram))) {
      joined += line;
      if (joined.ends_with('\\')) {
        joined.pop_back();
        continue;
      }
      document.command_lines.push_back(std::exchange(joined, {}));
    }
  }
  return document;
}

struct DocumentCase {
  const char* name;
  const char* file;
  int min_lines;  // detects a document that was read incompletely
};
// Lists every document with command lines. Each is a separate test, so that they run in parallel.
constexpr std::array kDocuments = {DocumentCase{"Readme", "README.md", 9},
                                   DocumentCase{"Usage", "docs/usage.md", 18},
                                   DocumentCase{"Live", "docs/live.md", 2},
                                   DocumentCase{"Kiosk", "docs/kiosk.md", 1},
                                   DocumentCase{"Studies", "docs/studies.md", 2},
                                   DocumentCase{"Shadows", "docs/shadows.md", 4},
                                   DocumentCase{"Tracking", "docs/tracking.md", 1},
                                   DocumentCase{"Calibration", "docs/calibration.md", 3},
                                   DocumentCase{"Install", "docs/install.md", 0},
                                   DocumentCase{"Rendering", "docs/rendering.md", 0},
                                   DocumentCase{"Scenes", "docs/scenes.md", 0},
                                   DocumentCase{"Files", "docs/files.md", 0},
                                   DocumentCase{"Reports", "docs/reports.md", 0}};
class DocumentedCommands : public testing::TestWithParam<DocumentCase> {};
INSTANTIATE_TEST_SUITE_P(Documents, DocumentedCommands, testing::ValuesIn(kDocuments),
                         [](const auto& instance) { return std::string(instance.param.name); });

TEST_P(DocumentedCommands, RunAsShown) {
  const std::filesystem::path file = source_dir() / GetParam().file;
  ASSERT_TRUE(std::filesystem::exists(file)) << file;
  const Document document = read_document(file);
  const TemporaryFolder folder;
  for (const char* data : {"recordings", "scenes"})
    std::filesystem::create_directory_symlink(source_dir() / data, folder.path() / data);
  for (const auto& [name, contents] : document.files)
    std::ofstream(folder.path() / name) << contents;
  int lines = 0;
  for (const std::string& line : document.command_lines) {
    if (line.find("# needs ") != std::string::npos) continue;
    ++lines;
    const std::string command = "\"$0\"" + line.substr(line.find(' '));
    const ProgramResult result =
        run_program("/bin/sh", {"-c", command, program().string()}, {}, folder.path());
    EXPECT_EQ(result.exit_code, 0) << GetParam().file << ": " << line << "\n" << result.err;
  }
  EXPECT_GE(lines, GetParam().min_lines);
}

TEST(DocumentedCommandsList, HasEveryDocumentWithCommands) {
  std::vector<std::filesystem::path> files = {"README.md"};
  for (const auto& entry : std::filesystem::directory_iterator(source_dir() / "docs"))
    if (entry.path().extension() == ".md") files.push_back("docs" / entry.path().filename());
  for (const std::filesystem::path& file : files) {
    const bool listed =
        std::ranges::find(kDocuments, file, &DocumentCase::file) != kDocuments.end();
    EXPECT_TRUE(listed || read_document(source_dir() / file).command_lines.empty()) << file;
  }
}

}  // namespace
}  // namespace penumbra::test
