// The commands of the program: each adds itself to the command line and says what to run.
#pragma once

#include <functional>

#include "core/error.hpp"

namespace CLI {
class App;
}

namespace penumbra {

// What the process tells its caller. A command returns success (also when it was ended early by
// Ctrl-C or SIGTERM: that is how a session ends, and its files are whole); main() makes the others
// from an Error and from a command line that makes no sense.
enum class ExitCode : int {
  success = 0,
  failure = 1,
  usage = 2,
};

// Filled while the command line is parsed, run afterwards.
using ChosenCommand = std::function<Result<ExitCode>()>;

void add_demo_command(CLI::App& program, ChosenCommand& chosen);
void add_replay_command(CLI::App& program, ChosenCommand& chosen);
void add_live_command(CLI::App& program, ChosenCommand& chosen);
void add_devices_command(CLI::App& program, ChosenCommand& chosen);
void add_evaluate_command(CLI::App& program, ChosenCommand& chosen);
void add_shadow_command(CLI::App& program, ChosenCommand& chosen);
void add_target_command(CLI::App& program, ChosenCommand& chosen);
void add_calibrate_command(CLI::App& program, ChosenCommand& chosen);
void add_map_command(CLI::App& program, ChosenCommand& chosen);
void add_kernels_command(CLI::App& program, ChosenCommand& chosen);
void add_simulate_command(CLI::App& program, ChosenCommand& chosen);
void add_study_command(CLI::App& program, ChosenCommand& chosen);

}  // namespace penumbra
