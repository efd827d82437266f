// penumbra target: a sheet to print at true scale, and the file that says what lies on it.

#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>

#include "app/capture/recording_source.hpp"
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

struct Target {
  TagBoard board;
  PageSize page;
  TagMap map;
  std::filesystem::path sheet;
  std::filesystem::path tags;
};

// Whatever is wrong here is wrong usage: nothing but the options is looked at.
Target target_of(const TargetOptions& options) {
  TagBoard board = options.board;
  const auto family = tag_family_from_string(options.family);
  if (!family) {
    throw CLI::ValidationError(
        "--family", fmt::format("'{}' is not known; use a family of libapriltag, such as tag36h11",
                                options.family));
  }
  board.family = *family;
  const auto page = page_size_from_string(options.page);
  if (!page) throw CLI::ValidationError("--page", page.error().message);
  auto map = tag_map_of(board, options.measured_mm / 100.0);
  if (!map) throw CLI::ValidationError(map.error().message);
  if (const auto fits = check_fits(board, *page); !fits) {
    throw CLI::ValidationError(fits.error().message);
  }
  std::filesystem::path tags = options.tags;
  if (tags.empty()) tags = options.output.parent_path() / "tags.yaml";
  if (same_path(options.output, tags)) {
    throw CLI::ValidationError(
        "--output", fmt::format("{}: is the file of the tags too (--tags); name two files",
                                options.output.string()));
  }
  return {board, *page, std::move(*map), options.output, tags};
}

Result<ExitCode> run_target(const TargetOptions& options, const Target& target) {
  const std::filesystem::path& tags_file = target.tags;
  for (const std::filesystem::path& file : {target.sheet, target.tags}) {
    const std::filesystem::path folder = std::filesystem::absolute(file).parent_path();
    if (is_recording(folder)) {
      return fail("{}: lies in the recording {}; name a place outside it", file.string(),
                  folder.string());
    }
  }
  auto sheet = OutputFile::create(target.sheet);
  if (!sheet) return tl::unexpected(sheet.error());
  auto tags = OutputFile::create(tags_file);
  if (!tags) return tl::unexpected(tags.error());
  if (const auto written = write_tag_board(sheet->partial(), target.board, target.page); !written) {
    return tl::unexpected(written.error());
  }
  if (const auto written = save_tag_map(tags->partial(), target.map); !written) {
    return tl::unexpected(written.error());
  }
  if (const auto done = sheet->commit(); !done) return tl::unexpected(done.error());
  if (const auto done = tags->commit(); !done) return tl::unexpected(done.error());
  fmt::print("sheet: {}\ntags: {}\n", target.sheet.string(), tags_file.string());
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
  command->add_option("--columns", board.columns, "Tags across")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command->add_option("--rows", board.rows, "Tags down")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command
      ->add_option("--tag-size", board.tag_size_m,
                   "Edge of a tag's black square, white margin not included [m]")
      ->check(CLI::Range(0.001, 2.0))
      ->capture_default_str();
  command->add_option("--pitch", board.pitch_m, "From one tag's centre to the next [m]")
      ->check(CLI::Range(0.001, 10.0))
      ->capture_default_str();
  command
      ->add_option("--measured", options->measured_mm,
                   "What the sheet's 100 mm ruler measures on paper [mm]: scales tags.yaml")
      ->check(CLI::Range(50.0, 200.0))
      ->capture_default_str();
  command->footer(
      "Example:\n"
      "  penumbra target --output sheet.pdf --page a4\n"
      "  penumbra target --output sheet.pdf --page a4 --measured 99.2");
  command->callback([options, &chosen] {
    chosen = [options, target = target_of(*options)] { return run_target(*options, target); };
  });
}

}  // namespace penumbra
