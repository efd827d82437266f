// penumbra target: a sheet to print at true scale, and the file that says what lies on it.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>

#include "app/commands/command.hpp"
#include "app/commands/options.hpp"
#include "app/output/output_file.hpp"
#include "calib/target_sheet.hpp"

namespace penumbra {
namespace {

struct TargetOptions {
  std::filesystem::path output;
  std::filesystem::path tags;  // beside the sheet when empty
  std::string page = "a4";
  std::string family = "tag36h11";
  double measured_mm = 100.0;
  TagBoard board;
};

Result<ExitCode> run_target(const TargetOptions& options) {
  TagBoard board = options.board;
  const auto family = tag_family_from_string(options.family);
  if (!family) {
    return fail("--family: '{}' is not known; use a family of libapriltag, such as tag36h11",
                options.family);
  }
  board.family = *family;
  const auto page = page_size_from_string(options.page);
  if (!page) return fail_in("--page", page.error());
  const auto map = tag_map_of(board, options.measured_mm / 100.0);
  if (!map) return tl::unexpected(map.error());

  std::filesystem::path tags_file = options.tags;
  if (tags_file.empty()) tags_file = options.output.parent_path() / "tags.yaml";
  auto sheet = OutputFile::create(options.output);
  if (!sheet) return tl::unexpected(sheet.error());
  auto tags = OutputFile::create(tags_file);
  if (!tags) return tl::unexpected(tags.error());
  if (const auto written = write_tag_board(sheet->partial(), board, *page); !written) {
    return tl::unexpected(written.error());
  }
  if (const auto written = save_tag_map(tags->partial(), *map); !written) {
    return tl::unexpected(written.error());
  }
  if (const auto done = sheet->commit(); !done) return tl::unexpected(done.error());
  if (const auto done = tags->commit(); !done) return tl::unexpected(done.error());
  fmt::print("sheet: {}\ntags: {}\n", options.output.string(), tags_file.string());
  if (options.measured_mm == 100.0) {
    fmt::print(
        "Print at 100 %. Measure the ruler: if it is not 100 mm, say so with --measured MM.\n");
  }
  return ExitCode::success;
}

}  // namespace

void add_target_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App* command = program.add_subcommand(
      "target", "Make a sheet of tags to print at true scale, with its tags.yaml");
  add_common_options(*command);
  const auto options = std::make_shared<TargetOptions>();
  TagBoard& board = options->board;
  command->add_option("--output", options->output, "The sheet")->required()->type_name("FILE.pdf");
  command
      ->add_option("--tags", options->tags,
                   "What lies on the sheet (default: tags.yaml beside the sheet)")
      ->type_name("FILE.yaml");
  command
      ->add_option("--page", options->page,
                   "a0 to a5, letter, legal, tabloid, or WIDTHxHEIGHT in millimetres")
      ->capture_default_str();
  command->add_option("--family", options->family, "Tag family")->capture_default_str();
  command->add_option("--first-id", board.first_id, "Id of the top left tag")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->add_option("--columns", board.columns, "Tags across")->capture_default_str();
  command->add_option("--rows", board.rows, "Tags down")->capture_default_str();
  command
      ->add_option("--tag-size", board.tag_size_m,
                   "Edge of a tag's black square, white margin not included [m]")
      ->capture_default_str();
  command->add_option("--pitch", board.pitch_m, "From one tag's centre to the next [m]")
      ->capture_default_str();
  command
      ->add_option("--measured", options->measured_mm,
                   "What the sheet's 100 mm ruler measures on paper [mm]: scales tags.yaml")
      ->capture_default_str();
  command->footer(
      "Example:\n"
      "  penumbra target --output sheet.pdf --page a4\n"
      "  penumbra target --output sheet.pdf --page a4 --measured 99.2");
  command->callback([options, &chosen] { chosen = [options] { return run_target(*options); }; });
}

}  // namespace penumbra
