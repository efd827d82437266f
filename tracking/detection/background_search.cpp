#include "tracking/detection/background_search.hpp"

#include <cstddef>
#include <cstring>
#include <utility>

#include "core/assert.hpp"
#include "core/propagate.hpp"

namespace penumbra {

BackgroundSearch::BackgroundSearch(TagSearch search, bool own_thread) : search_(std::move(search)) {
  if (own_thread) thread_ = std::thread([this] { serve(); });
}

Result<std::unique_ptr<BackgroundSearch>> BackgroundSearch::create(
    std::span<const TagFamily> families, std::optional<double> tone_exponent, bool own_thread) {
  PENUMBRA_TRY(TagSearch search, TagSearch::create(families, tone_exponent));
  return std::unique_ptr<BackgroundSearch>(new BackgroundSearch(std::move(search), own_thread));
}

BackgroundSearch::~BackgroundSearch() {
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    ends_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

void BackgroundSearch::begin(ImageView luma, std::int64_t timestamp_ns,
                             SearchResolution resolution) {
  PENUMBRA_ASSERT(idle() && !luma.empty());
  begun_ = true;
  const auto width = static_cast<std::size_t>(luma.width);
  pixels_.resize(width * static_cast<std::size_t>(luma.height));
  for (int y = 0; y < luma.height; ++y) {
    std::memcpy(pixels_.data() + static_cast<std::size_t>(y) * width, luma.row(y), width);
  }
  luma_ = {pixels_.data(), luma.width, luma.height, luma.width};
  timestamp_ns_ = timestamp_ns;
  resolution_ = resolution;
  if (!thread_.joinable()) return;
  {
    const std::lock_guard lock(mutex_);
    state_ = State::requested;
  }
  changed_.notify_all();
}

std::optional<PastTags> BackgroundSearch::take(bool wait) {
  if (idle()) return std::nullopt;
  if (!thread_.joinable()) {
    begun_ = false;
    return search();
  }
  {
    std::unique_lock lock(mutex_);
    if (wait) changed_.wait(lock, [this] { return state_ == State::done; });
    if (state_ != State::done) return std::nullopt;
    state_ = State::empty;
  }
  begun_ = false;
  return std::move(found_);
}

PastTags BackgroundSearch::search() {
  const Stopwatch watch;
  PastTags found;
  found.timestamp_ns = timestamp_ns_;
  search_.begin(luma_);
  found.tags = search_.tags(resolution_);
  found.time = watch.elapsed();
  return found;
}

void BackgroundSearch::serve() {
  while (true) {
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return ends_ || state_ == State::requested; });
      if (ends_) return;
    }
    found_ = search();
    {
      const std::lock_guard lock(mutex_);
      state_ = State::done;
    }
    changed_.notify_all();
  }
}

}  // namespace penumbra
