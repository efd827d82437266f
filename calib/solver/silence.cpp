#include "calib/solver/silence.hpp"

#include <glog/logging.h>

#include <algorithm>
#include <mutex>

namespace penumbra {

void silence_solver() {
  static std::once_flag once;
  std::call_once(once, [] {
    FLAGS_minloglevel = std::max(FLAGS_minloglevel, static_cast<int>(google::GLOG_ERROR));
  });
}

}  // namespace penumbra
