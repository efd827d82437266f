// Diagnostics on standard error, ours and the libraries'.
#pragma once

namespace penumbra {

// spdlog to standard error, warnings and above; what libav has to say goes to the debug level: its
// failures reach a person as errors of ours, once, and so do those of EGL's drivers.
void set_up_logging();

}  // namespace penumbra
