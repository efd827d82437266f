// Lets the user interrupt a long solve.
#pragma once

#include <ceres/iteration_callback.h>

#include <stop_token>
#include <utility>

namespace penumbra {

// Terminates a Ceres solve after the iteration in which `stop` was requested; discard its solution.
class StopCallback final : public ceres::IterationCallback {
 public:
  explicit StopCallback(std::stop_token stop) : stop_(std::move(stop)) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& /*summary*/) override {
    return stop_.stop_requested() ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

 private:
  std::stop_token stop_;
};

}  // namespace penumbra
