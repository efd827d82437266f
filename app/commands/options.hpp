// Options that several commands share.
#pragma once

#include <optional>
#include <string>

#include "app/run_outputs.hpp"
#include "render/shadow/technique.hpp"
#include "tracking/table_tracker.hpp"

namespace CLI {
class App;
}

namespace penumbra {

// --shadow and --kernels. "cocl" is the layered technique with one kernel per object.
struct ShadowChoice {
  std::optional<ShadowTechnique> technique;
  std::optional<KernelSource> kernels;
};
void add_shadow_options(CLI::App& command, ShadowChoice& choice);

// --tracking.
void add_tracking_option(CLI::App& command, TrackingMode& mode);

// --output, --poses, --poses-all and --report.
void add_output_options(CLI::App& command, OutputRequest& request);

// Every word that --shadow takes, from the list in render/shadow/technique.hpp.
[[nodiscard]] std::string known_techniques();
// Every word that --kernels takes, from the same place.
[[nodiscard]] std::string known_kernels();

// Every word that --kernels takes.
[[nodiscard]] std::string known_kernels();

// --version and --log-level.
void add_common_options(CLI::App& command);

}  // namespace penumbra
