// penumbra target: writes a sheet to print at true scale and the file that describes it.

#include <fmt/ranges.h>

#include <array>
#include <memory>

#include "app/commands/options.hpp"
#include "app/output/output_file.hpp"
#include "app/recording/recording_source.hpp"
#include "calib/target/target_sheet.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

struct TargetOptions {
  std::filesystem::path output;
  std::filesystem::path tags;  // empty: beside the sheet
  std::string page = "a4";
  std::string family = "tag36h11";
  std::string dictionary;  // used instead of the family
  std::optional<double> measured_mm;
  std::string type = "tags";
  int first_id = 0;
  // Empty values: the type's defaults.
  std::optional<int> columns;
  std::optional<int> rows;
  std::optional<double> tag_size_m;
  std::optional<double> pitch_m;
  std::optional<double> spacing;
  std::optional<double> square_m;
};

constexpr double kRulerMm = 100.0;  // nominal length of the ruler on the sheet

struct ChosenSheet {
  SheetTarget target;
  SheetFormat format = SheetFormat::pdf;
  PageSize page;
  std::filesystem::path tags;
};

// Replaces default numbers of columns and rows (chessboard: of inner corners) by given numbers.
void set_grid(const TargetOptions& options, int& columns, int& rows) {
  columns = options.columns.value_or(columns);
  rows = options.rows.value_or(rows);
}

Result<SheetTarget> sheet_target_of(const TargetOptions& options, TagFamily family) {
  if (options.type == "aprilgrid") {
    PENUMBRA_TRY(AprilGrid grid, april_grid_of(family, options.tag_size_m, options.spacing));
    grid.rows = 4;
    set_grid(options, grid.columns, grid.rows);
    grid.first_id = options.first_id;
    return grid;
  }
  if (options.type == "charuco") {
    CharucoBoard board;
    set_grid(options, board.columns, board.rows);
    board.square_m = options.square_m.value_or(board.square_m);
    board.tag_m = options.tag_size_m.value_or(0.73 * board.square_m);
    board.family = family;
    board.first_id = options.first_id;
    return board;
  }
  if (options.type == "chessboard") {
    ChessboardSheet board;
    set_grid(options, board.inner_columns, board.inner_rows);
    board.square_m = options.square_m.value_or(board.square_m);
    return board;
  }
  PENUMBRA_TRY(TagBoard board, tag_board_of(family, options.tag_size_m, options.pitch_m));
  set_grid(options, board.columns, board.rows);
  board.first_id = options.first_id;
  return board;
}

void check_options_of_type(const CLI::App& command, const std::string& type) {
  if (command.count("--dictionary") > 0 && command.count("--family") > 0)
    usage_error("--dictionary", "replaces --family; give one of the two");
  struct Use {
    const char* option;
    std::vector<std::string_view> types;
  };
  static const std::array<Use, 7> kUses = {{{"--family", {"tags", "aprilgrid", "charuco"}},
                                            {"--dictionary", {"charuco"}},
                                            {"--first-id", {"tags", "aprilgrid", "charuco"}},
                                            {"--tag-size", {"tags", "aprilgrid", "charuco"}},
                                            {"--pitch", {"tags"}},
                                            {"--spacing", {"aprilgrid"}},
                                            {"--square", {"charuco", "chessboard"}}}};
  for (const Use& use : kUses) {
    if (command.count(use.option) == 0 || std::ranges::count(use.types, type) > 0) continue;
    usage_error(use.option, "a sheet of type {} has none (--type {} has)", type,
                fmt::join(use.types, ", "));
  }
}

// Converts the options, rejecting wrong ones. Reads no file.
ChosenSheet target_of(const TargetOptions& options) {
  const auto family =
      tag_family_from_string(options.dictionary.empty() ? options.family : options.dictionary);
  if (!options.dictionary.empty() && (!family || !aruco_dictionary_of(*family))) {
    usage_error(
        "--dictionary",
        "'{}' is not known; name 4x4, 5x5 or 6x6 with 50, 100, 250 or 1000 markers, such as "
        "4x4_50",
        options.dictionary);
  }
  if (!family) usage_error("--family", "{}", unknown_tag_family(options.family));
  const auto chosen = sheet_target_of(options, *family);
  if (!chosen) usage_error("--family", "{}", chosen.error().message);
  const SheetTarget& target = *chosen;
  const auto page = page_size_from_string(options.page);
  if (!page) usage_error("--page", "{}", page.error().message);
  if (const auto fits = check_fits(target, *page); !fits) {
    throw CLI::ValidationError(fits.error().message);
  }
  if (!options.output.has_extension() && !is_stream(options.output)) {
    usage_error("--output", "{}: end it in .pdf, .svg or .png", options.output.string());
  }
  const auto format = sheet_format_of(options.output);
  if (!format) usage_error("--output", "{}", format.error().message);
  std::filesystem::path tags = options.tags;
  if (tags.empty())
    tags = options.output.parent_path() / (options.type == "tags" ? "tags.yaml" : "target.yaml");
  if (!is_stream(tags) && same_path(options.output, tags)) {
    usage_error("--output", "{}: is the file of the tags too (--tags); name two files",
                options.output.string());
  }
  return {target, *format, *page, tags};
}

bool exists_as_file(const std::filesystem::path& path) {
  std::error_code ignored;
  return !is_stream(path) && std::filesystem::exists(path, ignored);
}

// Returns true if the file `old` exists and its content differs from the replacement's.
bool would_change(const std::filesystem::path& old, const std::filesystem::path& replacement) {
  if (!exists_as_file(old)) return false;
  constexpr std::size_t kMaxBytes = 16'000'000;
  const auto before = read_text_file(old, kMaxBytes);
  const auto after = read_text_file(replacement, kMaxBytes);
  return !before || !after || *before != *after;
}

// Returns the ruler length [mm] in the file of an earlier run. Returns nullopt if that file is
// missing or describes another sheet.
std::optional<double> measured_before(const ChosenSheet& target) {
  if (!exists_as_file(target.tags)) return std::nullopt;
  const auto scale = printed_scale_of(target.tags, target.target);
  return scale ? std::optional(kRulerMm * *scale) : std::nullopt;
}

// Fails if the target file exists with other content, unless --tags names it or only the measured
// ruler length changes.
Result<void> check_replaceable(const TargetOptions& options, const ChosenSheet& target,
                               const std::filesystem::path& replacement) {
  if (!options.tags.empty() || !would_change(target.tags, replacement)) return {};
  const auto before = measured_before(target);
  if (!before) {
    return fail(
        "{}: exists with other content; name it with --tags to replace it, or name another file",
        target.tags.string());
  }
  if (options.measured_mm) return {};
  return fail(
      "{0}: is of this sheet with a ruler of {1:g} mm; keep that with --measured {1:g}, or measure "
      "again and give what the ruler measures now",
      target.tags.string(), *before);
}

void print_target(const TargetOptions& options, const ChosenSheet& target,
                  std::optional<double> before) {
  const double measured_mm = options.measured_mm.value_or(kRulerMm);
  fmt::print("sheet: {}\n{}: {}\n", options.output.string(),
             options.type == "tags" ? "tags" : "target", target.tags.string());
  if (options.measured_mm) {
    fmt::print(
        "ruler: {:g} mm on paper{}: the lengths in the file are {:.3f} % of those in the sheet\n",
        measured_mm,
        before && *before != measured_mm ? fmt::format(" (before: {:g} mm)", *before)
                                         : std::string(),
        100.0 * measured_mm / kRulerMm);
  } else {
    fmt::print(
        "Print at 100 %. Measure the ruler: if it is not 100 mm, give its length with --measured "
        "MM.\n");
  }
}

Result<ExitCode> run_target(const TargetOptions& options, const ChosenSheet& target) {
  for (const std::filesystem::path& file : {options.output, target.tags}) {
    if (is_stream(file)) continue;
    const std::filesystem::path folder = std::filesystem::absolute(file).parent_path();
    if (is_recording(folder)) {
      return fail("{}: lies in the recording {}; name a place outside it", file.string(),
                  folder.string());
    }
  }
  PENUMBRA_TRY(auto sheet, OutputFile::create(options.output));
  PENUMBRA_TRY(auto tags, OutputFile::create(target.tags));
  if (const auto written = write_sheet(sheet.partial(), target.target, target.page, target.format);
      !written) {
    return sheet.failed(written.error());
  }
  const double scale = options.measured_mm.value_or(kRulerMm) / kRulerMm;
  if (const auto written = save_target(tags.partial(), target.target, scale); !written) {
    return tags.failed(written.error());
  }
  PENUMBRA_TRY_VOID(check_replaceable(options, target, tags.partial()));
  const auto before = measured_before(target);
  PENUMBRA_TRY_VOID(commit_together(std::array{&sheet, &tags}));
  print_target(options, target, before);
  return ExitCode::success;
}

}  // namespace

void add_target_command(CLI::App& program, ChosenCommand& chosen) {
  CLI::App& command = add_command(
      program, "target", "Make a sheet to print at true scale, with the file that describes it",
      "Example:\n"
      "  penumbra target --output sheet.pdf --page a4\n"
      "  penumbra target --output sheet.pdf --page a4 --measured 99.2\n"
      "  penumbra target --type aprilgrid --output grid.pdf");
  const auto options = std::make_shared<TargetOptions>();
  add_option(command, "--output", "FILE", options->output,
             "The sheet, at true scale: .pdf, .svg or .png")
      ->required();
  add_option(command, "--tags", "FILE.yaml", options->tags,
             "Description of the sheet (default: tags.yaml or target.yaml beside it)");
  add_option(command, "--page", "PAGE", options->page,
             "a0 to a5, letter, legal, tabloid, or WIDTHxHEIGHT [mm]")
      ->capture_default_str();
  start_group(command, "Sheet");
  add_option(command, "--family", "FAMILY", options->family, "Tag family")->capture_default_str();
  add_option(command, "--dictionary", "NAME", options->dictionary,
             "charuco: ArUco's markers in place of a tag family: 4x4_50, 5x5_100, ...");
  add_text_option(
      command, "--type", "TYPE", [options](const std::string& type) { options->type = type; },
      "tags: a table to track on; aprilgrid, charuco, chessboard: to calibrate from")
      ->check(CLI::IsMember({"tags", "aprilgrid", "charuco", "chessboard"}).description(""))
      ->default_str(options->type);
  add_option(command, "--first-id", "ID", options->first_id, "Id of the first tag")
      ->check(whole_number())
      ->capture_default_str();
  add_option(command, "--columns", "N", options->columns,
             "Tags, squares or inner corners across (tags: 4, aprilgrid: 6, charuco: 8, "
             "chessboard: 9)")
      ->check(in_range(1, 100));
  add_option(command, "--rows", "N", options->rows,
             "Tags, squares or inner corners down (3, 4, 6, 6)")
      ->check(in_range(1, 100));
  add_option(command, "--tag-size", "METRES", options->tag_size_m,
             "Edge of a tag's black square [m] (default: by family; 0.04, aprilgrid: 0.03, "
             "charuco: 0.0219)")
      ->check(length_check("m", 0.001, 2.0));
  add_option(command, "--pitch", "METRES", options->pitch_m,
             "tags: from one's centre to the next [m] (default: 0.055, more for larger tags)")
      ->check(length_check("m", 0.001, 10.0));
  add_option(command, "--spacing", "RATIO", options->spacing,
             "aprilgrid: gap between tags over their size (default: by family, 0.3 or more)")
      ->check(in_range(0.01, 10.0));
  add_option(command, "--square", "METRES", options->square_m,
             "Edge of a square [m] (charuco: 0.03, chessboard: 0.022)")
      ->check(length_check("m", 0.001, 2.0));
  add_option(command, "--measured", "MM", options->measured_mm,
             "Measured length of the sheet's 100 mm ruler: scales the file, not the sheet")
      ->check(length_check("mm", 50.0, 200.0));
  put_first(command, {"--type", "--columns", "--rows", "--tag-size", "--square", "--measured"});
  command.callback([&command, options, &chosen] {
    claim_outputs(command, {"--output", "--tags"});
    check_options_of_type(command, options->type);
    chosen = [options, target = target_of(*options)] { return run_target(*options, target); };
  });
}

}  // namespace penumbra
