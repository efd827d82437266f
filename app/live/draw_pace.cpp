#include "app/live/draw_pace.hpp"

#include <algorithm>

namespace penumbra {
namespace {

constexpr std::int64_t kSlack_ns = 1'000'000;  // threads do not wake at once

}  // namespace

std::optional<std::int64_t> DrawPace::Recent::least() const {
  if (count_ == 0) return std::nullopt;
  const auto end = values_.begin() + static_cast<std::ptrdiff_t>(std::min(count_, values_.size()));
  return *std::min_element(values_.begin(), end);
}

std::optional<std::int64_t> DrawPace::Recent::most() const {
  if (count_ == 0) return std::nullopt;
  const auto end = values_.begin() + static_cast<std::ptrdiff_t>(std::min(count_, values_.size()));
  return *std::max_element(values_.begin(), end);
}

void DrawPace::took(std::int64_t now_ns) {
  took_ns_ = now_ns;
}

void DrawPace::asked(std::int64_t now_ns) {
  if (took_ns_ && now_ns >= *took_ns_) drawings_.add(now_ns - *took_ns_);
  took_ns_.reset();
}

void DrawPace::prepared(std::int64_t duration_ns) {
  preparations_.add(duration_ns);
}

std::optional<std::int64_t> DrawPace::begin_at_ns() const {
  const auto drawing = drawings_.least();
  const auto preparation = preparations_.most();
  if (!took_ns_ || !drawing || !preparation) return std::nullopt;
  return *took_ns_ + std::max<std::int64_t>(*drawing - *preparation - kSlack_ns, 0);
}

}  // namespace penumbra
