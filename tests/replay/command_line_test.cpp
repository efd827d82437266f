// The command line: help, versions, exit codes.

#include <gmock/gmock.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <map>
#include <regex>
#include <set>

#include "core/camera/camera_file.hpp"
#include "core/geometry/trajectory.hpp"
#include "core/text/text.hpp"
#include "render/scene/technique.hpp"
#include "replay_support.hpp"

namespace penumbra::test {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// Returns the names under "Subcommands:" in the program's help.
std::vector<std::string> commands_of(const std::string& help) {
  std::vector<std::string> commands;
  const std::vector<std::string> lines = lines_of(help);
  auto line = std::ranges::find(lines, "Subcommands:");
  while (line != lines.end() && ++line != lines.end() && line->starts_with("  ")) {
    const std::string name = line->substr(2, line->find(' ', 2) - 2);
    if (!name.empty()) commands.push_back(name);  // other lines continue a description
  }
  return commands;
}

TEST(CommandLine, PrintsHelpWithExampleForEveryCommand) {
  const ProgramResult overview = penumbra({"--help"});
  EXPECT_EQ(overview.exit_code, 0);
  EXPECT_THAT(overview.out, HasSubstr("Example:\n  penumbra demo"));
  const std::vector<std::string> commands = commands_of(overview.out);
  EXPECT_THAT(commands, testing::IsSupersetOf({"demo", "replay", "live", "study"}));
  for (const std::string& command : commands) {
    const ProgramResult help = penumbra({command, "--help"});
    EXPECT_EQ(help.exit_code, 0);
    EXPECT_THAT(help.out, HasSubstr("Example:\n  penumbra " + command));
    EXPECT_THAT(help.out, HasSubstr("--log-level"));
    EXPECT_EQ(help.err, "");
  }
}

// Returns the option names, such as "--output", in a command's help.
std::set<std::string> options_in(const std::string& help) {
  static const std::regex option(R"(^  (?:-\w,)?(--[a-z-]+))");
  std::set<std::string> names;
  for (const std::string& line : lines_of(help)) {
    std::smatch match;
    if (std::regex_search(line, match, option)) names.insert(match[1]);
  }
  return names;
}

// The options' names are in column 2, their descriptions in column 28: after two blanks, or on the
// next lines.
TEST(CommandLine, KeepsHelpNarrowBriefAndGrouped) {
  constexpr std::size_t kMaxMainOptions = 10;
  const std::string overview = penumbra({"--help"}).out;
  std::vector<std::string> helps = {overview};
  for (const std::string& command : commands_of(overview))
    helps.push_back(penumbra({command, "--help"}).out);
  static const std::regex heading("[A-Z][a-z ]+:");
  for (const std::string& help : helps) {
    std::string group;
    std::map<std::string, std::size_t> sizes;
    std::vector<std::string> groups;
    std::string option;
    int description_lines = 0;
    for (const std::string& line : lines_of(help)) {
      EXPECT_LE(line.size(), 100U) << line;
      if (std::regex_match(line, heading)) groups.push_back(group = line);
      if (line.starts_with("  -")) {
        option = line;
        ++sizes[group];
        description_lines = line.find("  ", 2) != std::string::npos ? 1 : 0;
      } else if (line.starts_with(std::string(28, ' '))) {
        ++description_lines;
      }
      EXPECT_LE(description_lines, 2) << option << "\n" << line;
    }
    EXPECT_THAT(groups, testing::Contains("General:")) << help;
    EXPECT_FALSE(sizes.contains("") || sizes.contains("Options:")) << help;
    EXPECT_LE(sizes["Main options:"], kMaxMainOptions) << help;
    const std::size_t general = help.find("\nGeneral:\n");
    EXPECT_EQ(help.find("\n  -", help.find("--log-level", general)), std::string::npos)
        << "general options must come last: " << help;
  }
}

// Returns the options that docs/usage.md documents for a command: in the tables of that command's
// section, and of the sections whose text before the table names it ("options of `replay` and
// `live`").
std::set<std::string> documented_options(const std::string& command) {
  // Matches whole names, so that "--light-mode" does not count as "--light".
  static const std::regex option(R"(--[a-z]+(?:-[a-z]+)*)");
  std::set<std::string> names;
  bool in_section = false;
  for (const std::string& line : lines_of(bytes_of(source_dir() / "docs" / "usage.md"))) {
    if (line.starts_with("## ")) {
      in_section = line == "## " + command || line == "## Common options";
    } else if (!line.starts_with("| ")) {
      const bool names_command = line.find("ptions of ") != std::string::npos &&
                                 line.find("`" + command + "`") != std::string::npos;
      in_section = in_section || names_command;
    } else if (in_section) {
      const std::string first_cell = line.substr(2, line.find(" | ") - 2);
      names.insert(std::sregex_token_iterator(first_cell.begin(), first_cell.end(), option), {});
    }
  }
  return names;
}

TEST(CommandLine, HasEveryOptionDocumented) {
  for (const std::string& command : commands_of(penumbra({"--help"}).out)) {
    const std::set<std::string> named = documented_options(command);
    std::set<std::string> options = options_in(penumbra({command, "--help"}).out);
    EXPECT_THAT(options, testing::IsSupersetOf({"--help", "--version"})) << command;
    std::set<std::string> missing;
    std::ranges::set_difference(options, named, std::inserter(missing, missing.end()));
    EXPECT_THAT(missing, testing::IsEmpty()) << "penumbra " << command << " --help";
  }
}

TEST(CommandLine, PrintsVersionInOneLine) {
  const ProgramResult version = penumbra({"--version"});
  EXPECT_EQ(version.exit_code, 0);
  EXPECT_THAT(version.out, testing::MatchesRegex("penumbra [0-9]+\\.[0-9]+\\.[0-9]+\n"));
  EXPECT_EQ(penumbra({"replay", "--version"}).out, version.out);
}

class CommandLineUsage : public testing::TestWithParam<std::vector<std::string>> {};
INSTANTIATE_TEST_SUITE_P(
    Arguments, CommandLineUsage,
    testing::Values(
        std::vector<std::string>{}, std::vector<std::string>{"sing"},
        std::vector<std::string>{"replay"},
        std::vector<std::string>{"replay", "r", "--no-such-option"},
        std::vector<std::string>{"replay", "r", "second"},
        std::vector<std::string>{"replay", "r", "--shadow", "pink"},
        std::vector<std::string>{"replay", "r", "--kernels", "pink"},
        std::vector<std::string>{"replay", "r", "--light-mode", "pink"},
        std::vector<std::string>{"replay", "r", "--light-mode", "fixed", "--kernels", "cocl"},
        std::vector<std::string>{"replay", "r", "--light-mode", "fixed", "--shadow", "cocl"},
        std::vector<std::string>{"replay", "r", "--shadow", "cocl", "--kernels", "k.json"},
        std::vector<std::string>{"replay", "r", "--proxy", "some"},
        std::vector<std::string>{"replay", "r", "--translucency", "glass"},
        std::vector<std::string>{"live", "--translucency", "glass"},
        std::vector<std::string>{"replay", "r", "--compare", "layered"},
        std::vector<std::string>{"replay", "r", "--compare", "layered,pink"},
        std::vector<std::string>{"replay", "r", "--compare", "layered,layered"},
        std::vector<std::string>{"replay", "r", "--compare", "layered,"},
        std::vector<std::string>{"replay", "r", "--compare", "layered", "simple"},
        std::vector<std::string>{"replay", "r", "--compare", "layered,hard", "--shadow", "hard"},
        std::vector<std::string>{"replay", "r", "--compare",
                                 "none,simple,walls,hard,cocl,layered,field,volume,none"},
        std::vector<std::string>{"replay", "r", "--tracking", "pink"},
        std::vector<std::string>{"replay", "r", "--frames", "9:3"},
        std::vector<std::string>{"replay", "r", "--threads", "0"},
        std::vector<std::string>{"replay", "r", "--threads", "many"},
        std::vector<std::string>{"replay", "r", "--poses-all"},
        std::vector<std::string>{"replay", "r", "--output", "video.avi"},
        std::vector<std::string>{"live", "--fps", "nan"},
        std::vector<std::string>{"live", "--duration", "0"},
        std::vector<std::string>{"live", "--duration", "NaN"},
        std::vector<std::string>{"map", "r", "--tag-size", "nan", "--output", "t.yaml"},
        std::vector<std::string>{"sing", "--help"},
        std::vector<std::string>{"replay", "r", "--log-level", "loud"},
        std::vector<std::string>{"demo", "--output", "folder"},
        std::vector<std::string>{"demo", "--light-mode", "fixed", "--shadow", "cocl"},
        std::vector<std::string>{"shadow"}, std::vector<std::string>{"kernels"},
        std::vector<std::string>{"kernels", "m.obj"},
        std::vector<std::string>{"kernels", "m.obj", "--output", "k.txt"},
        std::vector<std::string>{"kernels", "m.obj", "--output", "k.json", "--up", "1"},
        std::vector<std::string>{"kernels", "m.obj", "--output", "k.json", "--up", "0,0,0"},
        std::vector<std::string>{"shadow", "m.obj", "--technique", "pink"},
        std::vector<std::string>{"shadow", "m.obj", "--technique", "hard"},
        std::vector<std::string>{"shadow", "m.obj", "--light", "0 0 1 1"},
        std::vector<std::string>{"shadow", "m.obj", "--kernels", "pink"},
        std::vector<std::string>{"shadow", "m.obj", "--light-mode", "pink"},
        std::vector<std::string>{"shadow", "m.obj", "--proxy", "auto", "--technique", "field"},
        std::vector<std::string>{"shadow", "m.obj", "--light-height", "-1"},
        std::vector<std::string>{"shadow", "m.obj", "--light-height", "nan"},
        std::vector<std::string>{"shadow", "m.obj", "--light-height", "inf"},
        std::vector<std::string>{"shadow", "m.obj", "--light-ratio", "0"},
        std::vector<std::string>{"shadow", "m.obj", "--magnification", "2"},
        std::vector<std::string>{"shadow", "m.obj", "--magnification", "1", "--workspace-height",
                                 "0.3"},
        std::vector<std::string>{"shadow", "m.obj", "--pose", "0 0 0"},
        std::vector<std::string>{"shadow", "m.obj", "--pose", "0 0 0 0 0 0 0"},
        std::vector<std::string>{"shadow", "m.obj", "--plane", "0 0 0 0 0 0"},
        std::vector<std::string>{"shadow", "m.obj", "--up", "x"},
        std::vector<std::string>{"shadow", "m.obj", "--output", "layers.gif"},
        std::vector<std::string>{"replay", ""},
        std::vector<std::string>{"replay", "r", "--output", ""}, std::vector<std::string>{"target"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--tags", "x.pdf"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--tags", "./x.pdf"},
        std::vector<std::string>{"target", "--output", "tags.yaml"},
        std::vector<std::string>{"target", "--output", "x.jpg"},
        std::vector<std::string>{"target", "--output", "x.docx"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--page", "b9"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--page", "30x30"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--family", "tag1"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--measured", "9"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--measured", "nan"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--columns", "0"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--rows", "101"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--tag-size", "-1"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--pitch", "0.04"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--first-id", "580"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--square", "0.03"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--spacing", "0.3"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--type", "aprilgrid", "--pitch",
                                 "0.05"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--type", "chessboard", "--family",
                                 "tag36h11"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--dictionary", "4x4_50"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--type", "charuco", "--dictionary",
                                 "9x9_50"},
        std::vector<std::string>{"target", "--output", "x.pdf", "--type", "charuco", "--dictionary",
                                 "4x4_50", "--family", "tag36h11"},
        std::vector<std::string>{"calibrate", "pictures", "--target", "t.yaml", "--output",
                                 "c.yaml", "--keep", "views"},
        std::vector<std::string>{"replay", "r", "--refine-map", "folder"},
        std::vector<std::string>{"replay", "r", "--refine-map", "r.yaml", "--report", "r.yaml"},
        std::vector<std::string>{"replay", "r", "--refine-map", "--poses-from", "groundtruth"},
        std::vector<std::string>{"evaluate"},
        std::vector<std::string>{"evaluate", "--estimated", "a.tum"},
        std::vector<std::string>{"evaluate", "--split-half", "r", "--plot", "halves.png"}),
    [](const auto& test) {
      std::string name = fmt::format("{}", fmt::join(test.param, "_"));
      std::ranges::replace_if(
          name, [](unsigned char c) { return std::isalnum(c) == 0; }, '_');
      return name.empty() ? std::string("NoArguments") : name;
    });

TEST_P(CommandLineUsage, RejectsWrongUsageWithExitCode2AndOneLine) {
  const ProgramResult result = penumbra(GetParam());
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_EQ(result.out, "");
  ASSERT_EQ(lines_of(result.err).size(), 1U) << result.err;
  EXPECT_THAT(result.err, testing::StartsWith("penumbra: error: "));
  EXPECT_THAT(result.err, HasSubstr("--help"));
}

TEST(CommandLine, ReportsUnitAndExampleForInvalidLength) {
  struct Case {
    std::vector<std::string> arguments;
    const char* message;
  };
  using Arguments = std::vector<std::string>;
  for (const Case& c :
       {Case{Arguments{"target", "--output", "x.pdf", "--measured", "99.2mm"},
             "--measured: is '99.2mm'; give millimetres from 50 to 200: 99.2"},
        Case{Arguments{"target", "--output", "x.pdf", "--measured", "99,2"},
             "is '99,2'; give millimetres from 50 to 200: 99.2"},
        Case{Arguments{"target", "--output", "x.pdf", "--measured", "0.0992"},
             "give millimetres from 50 to 200: 99.2 for 0.0992 m"},
        Case{Arguments{"target", "--output", "x.pdf", "--measured", "9.92 cm"},
             "give millimetres from 50 to 200: 99.2 for 9.92 cm"},
        Case{Arguments{"target", "--output", "x.pdf", "--tag-size", "40"},
             "--tag-size: is '40'; give metres from 0.001 to 2: 0.04 for 40 mm"},
        Case{Arguments{"target", "--output", "x.pdf", "--tag-size", "40mm"},
             "give metres from 0.001 to 2: 0.04 for 40 mm"},
        Case{Arguments{"target", "--output", "x.pdf", "--pitch", "5.5cm"},
             "give metres from 0.001 to 10: 0.055 for 5.5 cm"},
        Case{Arguments{"target", "--output", "x.pdf", "--tag-size", "0,04"},
             "give metres from 0.001 to 2: 0.04"},
        Case{Arguments{"target", "--output", "x.pdf", "--tag-size", "big"},
             "--tag-size: is 'big'; give metres from 0.001 to 2 (see"},
        Case{Arguments{"map", "r", "--anchor", "0", "--output", "t.yaml", "--tag-size", "40"},
             "--tag-size: is '40'; give metres from 0.001 to 10: 0.04 for 40 mm"}}) {
    const ProgramResult result = penumbra(c.arguments);
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_THAT(result.err, HasSubstr(c.message));
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
  }
}

TEST(CommandLine, ReportsWhichNumberAnOptionExpects) {
  using Arguments = std::vector<std::string>;
  for (const auto& [arguments, message] : std::vector<std::pair<Arguments, std::string>>{
           {{"replay", "r", "--threads", "many"}, "is not a whole number from 1 to 1024"},
           {{"replay", "r", "--pose-budget", "low"}, "is not a number of pixels above 0"},
           {{"live", "--fps", "nan"}, "is not a number from 0.1 to 1000"},
           {{"live", "--duration", "-1"}, "is not a number from 0.001 to 1000000000"},
           {{"target", "--output", "x.pdf", "--columns", "2.5"}, "is not a whole number from 1"},
           {{"study", "--experiment", "drag", "--seed", "x"}, "is not a whole number from 0"},
           {{"calibrate", "r", "--focus-position", "inf"}, "is not a number"},
           {{"shadow", "m.obj", "--magnification", "big"}, "is not a number"}}) {
    const ProgramResult result = penumbra(arguments);
    EXPECT_EQ(result.exit_code, 2);
    const std::string& option = arguments[arguments.size() - 2];
    EXPECT_THAT(result.err, HasSubstr(option + ": " + arguments.back() + ": " + message));
    EXPECT_EQ(lines_of(result.err).size(), 1U) << result.err;
  }
}

TEST(CommandLine, RejectsCameraFileNamesOfOtherFormats) {
  for (const char* name : {"camera.json", "camera.XML", "c.cameramodel"}) {
    const ProgramResult result =
        penumbra({"calibrate", "r", "--target", "t.yaml", "--output", name});
    EXPECT_EQ(result.exit_code, 2) << name;
    EXPECT_THAT(result.err, HasSubstr("camera files are written as YAML"));
  }
  const ProgramResult small = penumbra({"setup", "table", "--page", "a5"});
  EXPECT_EQ(small.exit_code, 2);
  EXPECT_THAT(small.err, HasSubstr("does not fit on a page"));
}

TEST(CommandLine, AcceptsEveryKernelSource) {
  for (const auto& entry : kKernelSourceNames) {
    const ProgramResult result =
        penumbra({"replay", "no-such-recording", "--kernels", std::string(entry.name)});
    EXPECT_THAT(result.err, HasSubstr("no-such-recording")) << entry.name;
    EXPECT_THAT(result.err, testing::Not(HasSubstr("--kernels"))) << entry.name;
  }
  EXPECT_THAT(penumbra({"replay", "r", "--kernels", "pink"}).err,
              HasSubstr("known: auto, smooth, per-axis, cocl"));
}

TEST(CommandLine, ListsKnownTechniquesForUnknownTechnique) {
  const ProgramResult result = penumbra({"replay", "r", "--shadow", "pink"});
  EXPECT_THAT(result.err, HasSubstr("pink"));
  EXPECT_THAT(result.err, HasSubstr("none, simple, cocl, layered"));
}

TEST(CommandLine, ListsKnownTranslucenciesForUnknownTranslucency) {
  const ProgramResult result = penumbra({"replay", "r", "--translucency", "glass"});
  EXPECT_THAT(result.err, HasSubstr("glass"));
  EXPECT_THAT(result.err, HasSubstr("auto, blend, mesh, retexture, geometry-mesh"));
}

TEST(CommandLine, ListsKnownCommandsForUnknownCommand) {
  const ProgramResult result = penumbra({"bogus"});
  EXPECT_EQ(result.exit_code, 2);
  EXPECT_THAT(result.err, HasSubstr("'bogus' is not a command"));
  for (const char* command : {"demo", "replay", "evaluate", "target"}) {
    EXPECT_THAT(result.err, HasSubstr(command));
  }
}

TEST(CommandLine, SuggestsSimilarOptionForUnknownOption) {
  for (const std::string option : {"--traking", "--trackin", "--trakcing"}) {
    const ProgramResult result = penumbra({"replay", "r", option, "fast"});
    EXPECT_EQ(result.exit_code, 2);
    EXPECT_THAT(result.err, HasSubstr(option + ": no such option; did you mean --tracking?"));
    EXPECT_THAT(penumbra({"replay", "r", option + "=fast"}).err,
                HasSubstr(option + ": no such option; did you mean --tracking?"));
  }
  const ProgramResult dissimilar = penumbra({"replay", "r", "--bogus"});
  EXPECT_THAT(dissimilar.err, HasSubstr("--bogus: no such option (see penumbra replay --help)"));
  // A misspelt global option, before the command.
  EXPECT_THAT(penumbra({"--log-levle", "debug", "replay", "r"}).err,
              HasSubstr("--log-levle: no such option; did you mean --log-level?"));
  // Words that are not misspelt, and other errors, give no suggestion.
  EXPECT_THAT(penumbra({"map", "--recording", "r", "--output", "t.yaml"}).err,
              testing::Not(HasSubstr("did you mean")));
  EXPECT_THAT(penumbra({"replay", "--frames", "3", "--", "r"}).err,
              HasSubstr("is not a range A:B"));
  EXPECT_THAT(penumbra({"replay", "--"}).err, HasSubstr("RECORDING is required"));
  EXPECT_THAT(penumbra({"replay", "--", "r", "second"}).err, HasSubstr("second"));
}

TEST(CommandLine, AcceptsHelpAsCommand) {
  for (const char* command : {"replay", "live", "simulate"}) {
    const ProgramResult named = penumbra({"help", command});
    EXPECT_EQ(named.exit_code, 0);
    EXPECT_EQ(named.out, penumbra({command, "--help"}).out);
    EXPECT_THAT(named.out, HasSubstr(command));
  }
  const ProgramResult all = penumbra({"help"});
  EXPECT_EQ(all.exit_code, 0);
  EXPECT_EQ(all.out, penumbra({"--help"}).out);
  EXPECT_EQ(penumbra({"help", "help"}).out, all.out);
  EXPECT_EQ(penumbra({"help", "--log-level"}).out, all.out);
  const std::string replay = penumbra({"replay", "--help"}).out;
  EXPECT_EQ(penumbra({"help", "replay", "--output"}).out, replay) << "the command must not run";
  EXPECT_EQ(penumbra({"help", "replay", "r", "--shadow", "bogus"}).out, replay);
  const ProgramResult unknown = penumbra({"help", "bogus"});
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_THAT(unknown.err, HasSubstr("'bogus' is not a command"));
}

// Tracking options have no effect with given poses; --pose-budget has no effect with detection.
TEST(CommandLine, ReportsOptionsWithoutEffect) {
  const ProgramResult given =
      penumbra({"replay", "no-such-recording", "--poses-from", "groundtruth", "--tracking", "fast",
                "--pose-budget", "0.1"});
  EXPECT_THAT(given.err, HasSubstr("--tracking: has no effect with --poses-from"));
  EXPECT_THAT(given.err, HasSubstr("--pose-budget: has no effect with --poses-from"));
  EXPECT_THAT(
      penumbra({"study", "--experiment", "heights", "--techniques", "simple", "--participant", "1",
                "--plan", "--poses-from", "groundtruth", "--tracking", "fast"})
          .err,
      HasSubstr("--tracking: has no effect with --poses-from"));
  const ProgramResult detected =
      penumbra({"replay", "no-such-recording", "--tracking", "detect", "--pose-budget", "0.1"});
  EXPECT_THAT(detected.err, HasSubstr("--pose-budget: has no effect with --tracking detect"));
}

TEST(CommandLine, RejectsEmptyOptionValues) {
  EXPECT_THAT(penumbra({"replay", "r", "--output", ""}).err, HasSubstr("--output: is empty"));
  EXPECT_THAT(penumbra({"replay", "r", "--scene="}).err, HasSubstr("--scene"));
  EXPECT_THAT(penumbra({"replay", ""}).err, HasSubstr("RECORDING: is empty"));
}

TEST(TargetCommand, WritesSheetAndTagMap) {
  const TemporaryFolder folder;
  const std::filesystem::path sheet = folder.path() / "sheet.pdf";
  ASSERT_EQ(penumbra({"target", "--output", sheet}).exit_code, 0);
  EXPECT_TRUE(bytes_of(sheet).starts_with("%PDF"));
  EXPECT_THAT(bytes_of(folder.path() / "tags.yaml"), HasSubstr("tag36h11"));
  EXPECT_EQ(contents_of(folder.path()).size(), 2U);
}

TEST(TargetCommand, KeepsDifferentTagMapUnlessNamedExplicitly) {
  const TemporaryFolder folder;
  const std::filesystem::path sheet = folder.path() / "sheet.pdf";
  const std::filesystem::path tags = folder.path() / "tags.yaml";
  ASSERT_EQ(penumbra({"target", "--output", sheet}).exit_code, 0);
  EXPECT_EQ(penumbra({"target", "--output", sheet}).exit_code, 0)
      << "writing the same sheet again must succeed";
  const auto before = contents_of(folder.path());
  const std::vector<std::string> other = {"target", "--output", sheet, "--columns", "3"};
  expect_failure(penumbra(other), {"tags.yaml", "--tags"});
  EXPECT_EQ(contents_of(folder.path()), before);
  std::vector<std::string> named = other;
  named.insert(named.end(), {"--tags", tags});
  EXPECT_EQ(penumbra(named).exit_code, 0);
  EXPECT_NE(contents_of(folder.path()), before);
}

TEST(TargetCommand, RejectsRecordingAsOutputFolder) {
  const TemporaryFolder folder;
  std::ofstream(folder.path() / "timestamps.csv") << "frame,timestamp_s,file\n";
  std::ofstream(folder.path() / "tags.yaml") << "precious";
  expect_failure(penumbra({"target", "--output", folder.path() / "sheet.pdf"}),
                 {"sheet.pdf", "recording"});
  EXPECT_EQ(bytes_of(folder.path() / "tags.yaml"), "precious");
  EXPECT_EQ(contents_of(folder.path()).size(), 2U);
}

TEST(CommandLine, FailsOnMissingResources) {
  expect_failure(penumbra({"demo", "--kernels", "/nowhere/k.json"}), {"/nowhere/k.json"});
  expect_failure(penumbra({"demo"}, {"PENUMBRA_RESOURCES=/nowhere"}),
                 {"PENUMBRA_RESOURCES", "/nowhere"});
}

TEST(EvaluateCommand, ReportsZeroErrorForIdenticalTrajectories) {
  const std::string truth = bundled("tabletop") + "/groundtruth.tum";
  const std::string camera = bundled("tabletop") + "/camera.yaml";
  const ProgramResult result = penumbra(
      {"evaluate", "--estimated", truth, "--groundtruth", truth, "--camera", camera, "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto json = nlohmann::json::parse(result.out, nullptr, false);
  ASSERT_TRUE(json.is_object()) << result.out;
  EXPECT_EQ(json["frames_with_pose"], 120);
  EXPECT_EQ(json["share_with_pose"], 1.0);
  EXPECT_LT(json["overlay_px"]["max"].get<double>(), 1e-9);
  EXPECT_LT(json["jitter_px"].get<double>(), 1e-9);
  const ProgramResult table =
      penumbra({"evaluate", "--estimated", truth, "--groundtruth", truth, "--camera", camera});
  EXPECT_EQ(table.exit_code, 0);
  EXPECT_THAT(table.out, HasSubstr("judged frames with a pose: 120 of 120 (100.0 %)"));
  EXPECT_EQ(json["frames_estimated"], 120);
  EXPECT_EQ(json["frames_judged"], 120);
  EXPECT_EQ(json["share_judged"], 1.0);
  EXPECT_TRUE(json["not_judged"].empty());
}

// True poses at every third frame, from a clock that is 2 s ahead.
TEST(EvaluateCommand, InterpolatesTruthAndCountsUncoveredFrames) {
  const TemporaryFolder folder;
  const std::string camera = bundled("tabletop") + "/camera.yaml";
  std::string estimated;
  std::string truth;
  for (int i = 0; i < 30; ++i) {
    const std::string pose = std::to_string(0.01 * i) + " 0 0.5 1 0 0 0\n";
    estimated += std::to_string(0.03 * i) + " " + pose;
    if (i % 3 == 0 && i < 16) truth += std::to_string(2.0 + 0.03 * i) + " " + pose;
  }
  std::ofstream(folder.path() / "e.tum") << estimated;
  std::ofstream(folder.path() / "t.tum") << truth;
  const auto evaluate = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "evaluate",      "--estimated",           folder.path() / "e.tum",
        "--groundtruth", folder.path() / "t.tum", "--camera",
        camera};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return penumbra(arguments);
  };
  expect_failure(evaluate({}), {"e.tum", "30 outside the time of the ground truth", "2.000000000",
                                "--time-offset"});
  const ProgramResult result = evaluate({"--time-offset", "2", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto json = nlohmann::json::parse(result.out, nullptr, false);
  EXPECT_EQ(json["frames_estimated"], 30);
  EXPECT_EQ(json["frames_judged"], 16) << "frames up to the last true pose";
  EXPECT_EQ(json["not_judged"], nlohmann::json({{"outside_truth", 14}}));
  EXPECT_EQ(json["frames_with_truth"], 6);
  EXPECT_EQ(json["frames_with_pose"], 6);
  EXPECT_LE(json["share_with_pose"].get<double>(), 1.0);
  EXPECT_LT(json["translation_mm"]["max"].get<double>(), 1e-9);
  const ProgramResult without = evaluate({"--time-offset", "2", "--max-gap", "0.05"});
  ASSERT_EQ(without.exit_code, 0) << without.err;
  EXPECT_THAT(without.out, AllOf(HasSubstr("judged frames with a pose: 6 of 30 (20.0 %)"),
                                 HasSubstr("10 in a gap of the ground truth")));
  for (const char* wrong : {"-1", "nan", "1e99", "long"})
    EXPECT_EQ(evaluate({"--max-gap", wrong}).exit_code, 2) << wrong;
  EXPECT_EQ(evaluate({"--time-offset", "inf"}).exit_code, 2);
}

TEST(EvaluateCommand, ReadsSharedTrajectoryAndCameraFiles) {
  const std::filesystem::path shared = shared_dir();
  if (shared.empty()) GTEST_SKIP() << "no shared data beside the checkout";
  const std::filesystem::path cases = shared / "cases";
  const std::string tabletop = shared / "recordings" / "tabletop";
  const auto evaluate = [&](const std::filesystem::path& estimated,
                            const std::filesystem::path& truth, const std::string& camera) {
    return penumbra({"evaluate", "--estimated", cases / estimated, "--groundtruth", cases / truth,
                     "--camera", camera});
  };
  const std::filesystem::path times = "evaluate-times";
  const ProgramResult judged = evaluate(times / "estimate-30Hz.tum", times / "truth-100Hz.tum",
                                        cases / times / "camera.yaml");
  ASSERT_EQ(judged.exit_code, 0) << judged.err;
  EXPECT_THAT(judged.out, HasSubstr("judged frames with a pose: 20 of 20 (100.0 %)"));
  EXPECT_THAT(judged.out, HasSubstr("0.0255"));
  expect_failure(evaluate(times / "allsame.tum", times / "allsame.tum", tabletop + "/camera.yaml"),
                 {"allsame.tum", "line 2", "timestamps must increase"});
  expect_failure(
      evaluate(times / "ms.tum", tabletop + "/groundtruth.tum", tabletop + "/camera.yaml"),
      {"ms.tum", "milliseconds"});
  const std::filesystem::path marks = "tum-byte-order-mark";
  EXPECT_EQ(evaluate(marks / "bom.tum", marks / "bom.tum", tabletop + "/camera.yaml").exit_code, 0);
  expect_failure(evaluate(marks / "utf16.tum", marks / "bom.tum", tabletop + "/camera.yaml"),
                 {"utf16.tum", "UTF-16"});
  const ProgramResult euroc =
      evaluate(marks / "euroc.csv", marks / "bom.tum", tabletop + "/camera.yaml");
  EXPECT_EQ(euroc.exit_code, 0) << euroc.err;
  EXPECT_THAT(euroc.err, AllOf(HasSubstr("euroc.csv"), HasSubstr("body")));
  const ProgramResult warned =
      evaluate(marks / "bom.tum", marks / "bom.tum",
               cases / "camera-info-coefficients" / "ros_missing_model.yaml");
  EXPECT_EQ(warned.exit_code, 0) << warned.err;
  EXPECT_THAT(warned.err, HasSubstr("plumb_bob is assumed"));
}

// Common mistakes in files of true poses add one line to the output and do not change the numbers.
TEST(EvaluateCommand, HintsAtWrongUnitsQuaternionOrderAndDirection) {
  const TemporaryFolder folder;
  const std::string truth = bundled("tabletop") + "/groundtruth.tum";
  const auto written = load_trajectory(truth).value();
  const auto evaluate = [&](const char* name, const auto& change) {
    Trajectory other = written;
    for (StampedPose& pose : other.poses) pose.T_table_camera = change(pose.T_table_camera);
    const std::filesystem::path file = folder.path() / name;
    EXPECT_TRUE(save_trajectory(file, other));
    return penumbra({"evaluate", "--estimated", truth, "--groundtruth", file, "--camera",
                     bundled("tabletop") + "/camera.yaml"});
  };
  const auto millimetres = evaluate("mm.tum", [](const CameraPose& pose) {
    return CameraPose(pose.rotation(), 1000.0 * pose.translation());
  });
  EXPECT_EQ(millimetres.exit_code, 0);
  ASSERT_EQ(lines_of(millimetres.err).size(), 1U) << millimetres.err;
  EXPECT_THAT(millimetres.err, HasSubstr("mm.tum: the ground truth looks like it has positions in "
                                         "millimetres"));
  EXPECT_THAT(millimetres.out, HasSubstr("translation [mm]"));
  const auto inverse = evaluate("inverse.tum", [](const CameraPose& pose) {
    return CameraPose(pose.inverse().rotation(), pose.inverse().translation());
  });
  EXPECT_THAT(inverse.err, HasSubstr("inverse poses (T_camera_table)"));
  const auto w_first = evaluate("wxyz.tum", [](const CameraPose& pose) {
    const Eigen::Quaterniond& q = pose.rotation();
    return CameraPose(Eigen::Quaterniond(q.z(), q.w(), q.x(), q.y()), pose.translation());
  });
  EXPECT_THAT(w_first.err, HasSubstr("quaternions in the order w x y z"));
  EXPECT_EQ(evaluate("same.tum", [](const CameraPose& pose) { return pose; }).err, "");
}

TEST(EvaluateCommand, ReportsTimeOffset) {
  const std::string truth = bundled("tabletop") + "/groundtruth.tum";
  std::vector<std::string> arguments = {"evaluate",
                                        "--estimated",
                                        truth,
                                        "--groundtruth",
                                        truth,
                                        "--camera",
                                        bundled("tabletop") + "/camera.yaml",
                                        "--time-offset",
                                        "-0.25"};
  EXPECT_THAT(penumbra(arguments).out,
              HasSubstr("time offset added to the estimate: -0.250000000 s\n"));
  arguments.back() = "100";
  const ProgramResult apart = penumbra(arguments);
  EXPECT_EQ(apart.exit_code, 1);
  EXPECT_THAT(apart.err, HasSubstr("with --time-offset 100 added"));
  arguments.back() = "0";
  EXPECT_THAT(penumbra(arguments).out, testing::Not(HasSubstr("time offset")));
  arguments.emplace_back("--json");
  EXPECT_EQ(nlohmann::json::parse(penumbra(arguments).out)["time_offset_s"], 0.0);
}

TEST(ReplayCommand, UsesCameraOfCalibrationOption) {
  const TemporaryFolder folder;
  const auto replay = [&](const std::string& camera, const std::string& poses) {
    return penumbra({"replay", bundled("tabletop"), "--frames", "0:2", "--shadow", "none",
                     "--no-window", "--calibration", camera, "--poses", poses});
  };
  const auto text_of = [](const std::string& file) {
    return read_text_file(file, 1 << 20).value();
  };
  const std::string given = folder.path() / "given.tum";
  const std::string other = folder.path() / "other.tum";
  ASSERT_EQ(replay(bundled("tabletop") + "/camera.yaml", given).exit_code, 0);
  auto camera = load_camera(bundled("tabletop") + "/camera.yaml").value().parameters();
  camera.fx *= 1.01;
  camera.fy *= 1.01;
  const std::string file = folder.path() / "camera.yaml";
  ASSERT_TRUE(save_camera(file, CameraModel::make(camera).value()));
  ASSERT_EQ(replay(file, other).exit_code, 0);
  EXPECT_NE(text_of(given), text_of(other));
  expect_failure(replay(folder.path() / "absent.yaml", other), {"absent.yaml"});
}

TEST(EvaluateCommand, RequiresCameraNameForMultiCameraFile) {
  const TemporaryFolder folder;
  const std::string truth = bundled("tabletop") + "/groundtruth.tum";
  const std::string chain = folder.path() / "camchain.yaml";
  const auto camera = [](const char* name) {
    return std::string(name) +
           ":\n  camera_model: pinhole\n  distortion_coeffs: [0, 0, 0, 0]\n"
           "  distortion_model: radtan\n  intrinsics: [500, 500, 320, 240]\n"
           "  resolution: [640, 480]\n";
  };
  std::ofstream(chain) << camera("left") << camera("right");
  std::vector<std::string> arguments = {"evaluate", "--estimated", truth, "--groundtruth",
                                        truth,      "--camera",    chain};
  expect_failure(penumbra(arguments), {chain, "left, right", "--camera-name"});
  arguments.insert(arguments.end(), {"--camera-name", "right"});
  EXPECT_EQ(penumbra(arguments).exit_code, 0);
  arguments.back() = "cam2";
  expect_failure(penumbra(arguments), {chain, "cam2", "left, right"});
}

TEST(CommandLine, RejectsCameraNameWithoutCameraFile) {
  const ProgramResult calibrated = penumbra(
      {"calibrate", "views", "--target", "t.yaml", "--output", "c.yaml", "--camera-name", "left"});
  EXPECT_EQ(calibrated.exit_code, 2);
  EXPECT_THAT(calibrated.err, HasSubstr("--compare"));
  const ProgramResult study =
      penumbra({"study", "--experiment", "heights", "--camera-name", "left"});
  EXPECT_EQ(study.exit_code, 2);
  EXPECT_THAT(study.err, HasSubstr("--calibration"));
}

TEST(EvaluateCommand, MeasuresOneMillimetreErrorInOneFrame) {
  const TemporaryFolder folder;
  // One of the 120 frames is 1 mm higher.
  std::string moved;
  int line_number = 0;
  for (const std::string& line : lines_of(bytes_of(bundled("tabletop") + "/groundtruth.tum"))) {
    if (line.starts_with("#")) continue;
    double t = 0;
    double x = 0;
    double y = 0;
    double z = 0;
    int end = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "%lf %lf %lf %lf%n", &t, &x, &y, &z, &end), 4);
    if (++line_number == 60) z += 0.001;
    std::array<char, 200> head{};
    std::snprintf(head.data(), head.size(), "%.9f %.17g %.17g %.17g", t, x, y, z);
    moved += head.data() + line.substr(static_cast<std::size_t>(end)) + "\n";
  }
  std::ofstream(folder.path() / "moved.tum") << moved;
  const ProgramResult result =
      penumbra({"evaluate", "--estimated", folder.path() / "moved.tum", "--groundtruth",
                bundled("tabletop") + "/groundtruth.tum", "--camera",
                bundled("tabletop") + "/camera.yaml", "--json"});
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto json = nlohmann::json::parse(result.out, nullptr, false);
  EXPECT_NEAR(json["translation_mm"]["max"].get<double>(), 1.0, 1e-6);
  EXPECT_NEAR(json["translation_mm"]["rmse"].get<double>(), 1.0 / std::sqrt(120.0), 1e-6);
  EXPECT_LT(json["translation_mm"]["median"].get<double>(), 1e-9);
  EXPECT_GT(json["overlay_px"]["max"].get<double>(), 0.1);
}

TEST(EvaluateCommand, FailsInOneLineOnIncomparableFiles) {
  const TemporaryFolder folder;
  const std::string truth = bundled("tabletop") + "/groundtruth.tum";
  const std::string camera = bundled("tabletop") + "/camera.yaml";
  const std::string late = folder.path() / "late.tum";
  std::ofstream(late) << "9999.0 0 0 1 0 0 0 1\n";
  expect_failure(
      penumbra({"evaluate", "--estimated", late, "--groundtruth", truth, "--camera", camera}),
      {late, "no pose"});
  const std::string empty = folder.path() / "empty.tum";
  std::ofstream(empty) << "# timestamp tx ty tz qx qy qz qw\n";
  expect_failure(
      penumbra({"evaluate", "--estimated", empty, "--groundtruth", truth, "--camera", camera}),
      {empty, "holds no pose"});
  expect_failure(penumbra({"evaluate", "--estimated", folder.path() / "none.tum", "--groundtruth",
                           truth, "--camera", camera}),
                 {"none.tum"});
  const std::string not_finite = folder.path() / "nan.tum";
  std::ofstream(not_finite) << "0.0 0 0 1 0 0 0 1\n0.1 nan 0 1 0 0 0 1\n";
  expect_failure(
      penumbra({"evaluate", "--estimated", not_finite, "--groundtruth", truth, "--camera", camera}),
      {not_finite, "2"});
}

}  // namespace
}  // namespace penumbra::test
