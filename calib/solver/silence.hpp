// Silences the log of Ceres.
#pragma once

namespace penumbra {

// Silences Ceres' warnings on standard error about steps that it rejects. The first call must not
// run beside a solver in another thread; main() makes it.
void silence_solver();

}  // namespace penumbra
