// Keeps the program running if a standard stream is closed or full, or loses its reader.
#pragma once

#include <cstdint>

#include "core/error.hpp"

namespace penumbra {

// Makes a failing standard stream harmless. Call it first in main(), before any thread and any log.
// - Opens /dev/null in place of a closed descriptor 0, 1 or 2, so that no output file gets that
//   number and receives the printed text.
// - Ignores SIGPIPE and SIGXFSZ: the write fails with an error instead.
// - Replaces stdout and stderr by streams that drop what cannot be written. A failing write reports
//   success to its caller, because fmt::print() throws otherwise.
// - Drops a line of standard error if a stalled reader does not read it within 0.2 s. Once it reads
//   again, a message reports the number of dropped lines.
void secure_standard_streams();

// Flushes stdout. Fails with the first error of a write to stdout since secure_standard_streams().
[[nodiscard]] Result<void> flush_standard_output();

// Returns the number of lines that could not be written to standard error. Thread-safe.
[[nodiscard]] std::int64_t dropped_log_lines();

}  // namespace penumbra
