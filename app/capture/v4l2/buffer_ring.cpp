#include "app/capture/v4l2/buffer_ring.hpp"

#include <utility>

#include "core/assert.hpp"

namespace penumbra {

std::shared_ptr<BufferRing> BufferRing::create(std::vector<std::span<const std::uint8_t>> buffers,
                                               Driver driver) {
  return std::shared_ptr<BufferRing>(new BufferRing(std::move(buffers), std::move(driver)));
}

BufferRing::BufferRing(std::vector<std::span<const std::uint8_t>> buffers, Driver driver)
    : buffers_(std::move(buffers)), driver_(std::move(driver)) {}

BufferRing::~BufferRing() {
  if (driver_.release) driver_.release();
}

bool BufferRing::queue_all() {
  const std::lock_guard lock(mutex_);
  PENUMBRA_ASSERT(in_driver_ == 0 && !closed_);
  for (unsigned i = 0; i < buffers_.size(); ++i) {
    if (!driver_.queue(i)) return false;
    ++in_driver_;
  }
  return true;
}

std::shared_ptr<const void> BufferRing::lend(unsigned index) {
  PENUMBRA_ASSERT(index < buffers_.size());
  {
    const std::lock_guard lock(mutex_);
    PENUMBRA_ASSERT(in_driver_ > 0);
    --in_driver_;
  }
  // Resets `ring` explicitly: a weak_ptr to the result would keep this deleter and the ring alive.
  return {buffers_[index].data(), [ring = shared_from_this(), index](const void*) mutable {
            ring->return_buffer(index);
            ring.reset();
          }};
}

void BufferRing::return_buffer(unsigned index) {
  // Holds the lock during the call, so that no thread is in the driver after close().
  const std::lock_guard lock(mutex_);
  if (closed_) return;
  if (driver_.queue(index)) {
    ++in_driver_;
  } else {
    refused_ = true;
  }
}

std::size_t BufferRing::in_driver() const {
  const std::lock_guard lock(mutex_);
  return in_driver_;
}

bool BufferRing::refused() const {
  const std::lock_guard lock(mutex_);
  return refused_;
}

void BufferRing::close() {
  const std::lock_guard lock(mutex_);
  closed_ = true;
}

}  // namespace penumbra
