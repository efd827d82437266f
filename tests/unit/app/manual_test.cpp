#include "tools/manual/manual.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "app/commands/options.hpp"
#include "core/text/text.hpp"
#include "support/paths.hpp"
#include "support/run_program.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRemedy =
    "differs from the options; build the target make_manual and run it on packaging/";

std::string committed_text(const fs::path& file) {
  const auto text = read_text_file(file, 1 << 20);
  EXPECT_TRUE(text) << file << " is missing: " << kRemedy;
  return text.value_or(std::string());
}

class Manual : public testing::Test {
 protected:
  ChosenCommand chosen_;
  std::unique_ptr<CLI::App> program_ = make_program(chosen_);
  fs::path packaging_ = test::source_dir() / "packaging";
};

TEST_F(Manual, PagesAreThoseOfTheOptions) {
  const auto pages = man_pages(*program_);
  std::set<std::string> committed;
  for (const auto& entry : fs::directory_iterator(packaging_ / "man"))
    committed.insert(entry.path().filename());
  std::set<std::string> made;
  for (const auto& [name, text] : pages) {
    made.insert(name);
    EXPECT_EQ(committed_text(packaging_ / "man" / name), text) << name << ' ' << kRemedy;
  }
  EXPECT_EQ(committed, made);
}

TEST_F(Manual, CompletionsAreThoseOfTheOptions) {
  const fs::path folder = packaging_ / "completions";
  EXPECT_EQ(committed_text(folder / "penumbra.bash"), bash_completion(*program_)) << kRemedy;
  EXPECT_EQ(committed_text(folder / "_penumbra"), zsh_completion(*program_)) << kRemedy;
  EXPECT_EQ(committed_text(folder / "penumbra.fish"), fish_completion(*program_)) << kRemedy;
}

TEST_F(Manual, PagesDescribeEveryOption) {
  const auto pages = man_pages(*program_);
  for (const CLI::App* command : program_->get_subcommands(nullptr)) {
    const std::string& page = pages.at("penumbra-" + command->get_name() + ".1");
    for (const CLI::Option* option : command->get_options()) {
      for (const std::string& name : option->get_lnames()) {
        std::string escaped = "\\-\\-";
        for (const char c : name) escaped += c == '-' ? std::string("\\-") : std::string(1, c);
        EXPECT_THAT(page, testing::HasSubstr("\\fB" + escaped + "\\fR")) << command->get_name();
      }
    }
  }
}

TEST_F(Manual, BashCompletesCommandsOptionsAndValues) {
  const auto completed = [&](const std::string& words, int index) {
    const std::string script =
        "source '" + (packaging_ / "completions" / "penumbra.bash").string() + "'; COMP_WORDS=(" +
        words + "); COMP_CWORD=" + std::to_string(index) + "; _penumbra; echo \"${COMPREPLY[*]}\"";
    const auto result = test::run_program("/bin/bash", {"-c", script});
    EXPECT_EQ(result.exit_code, 0) << result.err;
    return result.out;
  };
  EXPECT_EQ(completed("penumbra cal", 1), "calibrate\n");
  EXPECT_EQ(completed("penumbra replay --group-p", 2), "--group-poses\n");
  EXPECT_EQ(completed("penumbra replay r --shadow wal", 4), "walls\n");
  EXPECT_EQ(completed("penumbra --vers", 1), "--version\n");
  EXPECT_EQ(completed("penumbra replay recor", 2), "\n") << "files are completed by the shell";
}

}  // namespace
}  // namespace penumbra
