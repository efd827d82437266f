// One slot between two threads: the newest item waits in it, an older one that nobody took is
// dropped and counted. So what is taken is always fresh, and memory stays bounded.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <mutex>
#include <optional>
#include <utility>

namespace penumbra {

template <class T>
class Mailbox {
 public:
  // Never waits for the reader. After close() the item is let go.
  void put(T item) {
    std::optional<T> older;  // destroyed after the lock is given back: it may be a frame's buffer
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return;
      if (slot_) ++dropped_;
      older = std::exchange(slot_, std::optional<T>(std::move(item)));
    }
    changed_.notify_all();
  }

  // Waits until the slot is empty, then fills it: nothing is dropped. False once closed.
  [[nodiscard]] bool hand_over(T item) {
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return closed_ || !slot_; });
      if (closed_) return false;
      slot_.emplace(std::move(item));
    }
    changed_.notify_all();
    return true;
  }

  // Waits until the slot is empty: for a giver that makes its item only then. False once closed.
  [[nodiscard]] bool wait_until_empty() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || !slot_; });
    return !closed_;
  }

  // The newest item; nothing when `patience` ended first, or when the box is closed and empty.
  [[nodiscard]] std::optional<T> take(std::chrono::milliseconds patience) {
    std::optional<T> item;
    {
      std::unique_lock lock(mutex_);
      changed_.wait_for(lock, patience, [this] { return closed_ || slot_; });
      item = std::exchange(slot_, std::nullopt);
    }
    changed_.notify_all();
    return item;
  }

  // Nothing comes in any more; what is in the slot can still be taken. Wakes everyone.
  void close() {
    {
      const std::lock_guard lock(mutex_);
      closed_ = true;
    }
    changed_.notify_all();
  }

  // Closed, and nothing is left to take.
  [[nodiscard]] bool finished() const {
    const std::lock_guard lock(mutex_);
    return closed_ && !slot_;
  }
  [[nodiscard]] std::uint64_t dropped() const {
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<T> slot_;      // guarded by mutex_
  std::uint64_t dropped_ = 0;  // guarded by mutex_
  bool closed_ = false;        // guarded by mutex_
};

}  // namespace penumbra
