#include "app/report/rate_meter.hpp"

#include <algorithm>

namespace penumbra {

void RateMeter::add(double at_ms) {
  at_ms_.push_back(at_ms);
  if (at_ms_.size() > kMostPictures) at_ms_.pop_front();
}

double RateMeter::per_s(double now_ms) const {
  if (at_ms_.size() < 2 || !(at_ms_.back() > at_ms_.front())) return 0.0;
  const auto intervals = static_cast<double>(at_ms_.size() - 1);
  const double measured = intervals / (at_ms_.back() - at_ms_.front());
  const double at_most = (intervals + 1.0) / std::max(now_ms - at_ms_.front(), 1e-9);
  return 1e3 * std::min(measured, at_most);
}

}  // namespace penumbra
