// Standard input, output and error that are closed, full, or go away with their terminal or reader.
#pragma once

#include <cstdint>

#include "core/error.hpp"

namespace penumbra {

// Makes a failing standard stream harmless. Call it first in main(), before any thread and any log.
// - Opens /dev/null in place of a closed descriptor 0, 1 or 2, so that no output file takes its
//   number and receives what is printed.
// - Ignores SIGPIPE and SIGXFSZ: such a write fails with an error instead.
// - Replaces stdout and stderr by streams that drop what cannot be written. A failing write reports
//   success to its caller, because fmt::print() throws otherwise.
// - Drops lines of standard error that a stalled reader does not take within 0.2 s. Once it reads
//   again, it finds their number.
void secure_standard_streams();

// Flushes stdout. Fails with the first error of writing to it since secure_standard_streams().
[[nodiscard]] Result<void> flush_standard_output();

// Lines that could not be written to standard error. By any thread.
[[nodiscard]] std::int64_t dropped_log_lines();

}  // namespace penumbra
