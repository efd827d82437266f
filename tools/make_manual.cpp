// Writes the man pages and shell completions into a folder: make_manual FOLDER

#include <cstdio>
#include <filesystem>

#include "app/commands/options.hpp"
#include "core/text/text.hpp"
#include "tools/manual/manual.hpp"

namespace penumbra {
namespace {

bool write(const std::filesystem::path& file, const std::string& text) {
  const auto written = write_text_file(file, text);
  if (!written) std::fprintf(stderr, "make_manual: %s\n", written.error().message.c_str());
  return written.has_value();
}

int run(const std::filesystem::path& folder) {
  std::error_code ignored;
  std::filesystem::create_directories(folder / "man", ignored);
  std::filesystem::create_directories(folder / "completions", ignored);
  ChosenCommand chosen;
  const auto program = make_program(chosen);
  bool written = true;
  for (const auto& [name, text] : man_pages(*program))
    written = write(folder / "man" / name, text) && written;
  written = write(folder / "completions" / "penumbra.bash", bash_completion(*program)) && written;
  written = write(folder / "completions" / "_penumbra", zsh_completion(*program)) && written;
  written = write(folder / "completions" / "penumbra.fish", fish_completion(*program)) && written;
  return written ? 0 : 1;
}

}  // namespace
}  // namespace penumbra

int main(int argc, char** argv) {
  if (argc == 2) return penumbra::run(argv[1]);
  std::fputs("usage: make_manual FOLDER\n", stderr);
  return 2;
}
