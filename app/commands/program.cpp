// The command line of the program.

#include "app/commands/options.hpp"

namespace penumbra {

std::unique_ptr<CLI::App> make_program(ChosenCommand& chosen) {
  auto program = std::make_unique<CLI::App>(
      "Handheld augmented reality over a table with AprilTags, with layered penumbrae", "penumbra");
  program->formatter(make_help_formatter());  // applies to every command
  add_common_options(*program);
  program->require_subcommand(1);
  program->footer(
      "Exit codes: 0 success (also when ended by Ctrl-C while frames run), 1 failure, 2 wrong "
      "usage.\n\n"
      "Example:\n"
      "  penumbra demo");
  for (const auto add :
       {add_demo_command, add_replay_command, add_live_command, add_setup_command,
        add_devices_command, add_evaluate_command, add_shadow_command, add_target_command,
        add_calibrate_command, add_map_command, add_kernels_command, add_import_command,
        add_simulate_command, add_study_command}) {
    add(*program, chosen);
  }
  return program;
}

}  // namespace penumbra
