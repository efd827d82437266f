// One slot between two threads that holds the newest item. A newer item replaces an unread one.
#pragma once

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <utility>

namespace penumbra {

template <class T>
class Mailbox {
 public:
  // Never waits for the reader. Drops the item after close().
  void put(T item) {
    std::optional<T> older;  // destroyed after the lock is released: it may return a buffer
    {
      const std::lock_guard lock(mutex_);
      if (closed_) return;
      older = std::exchange(slot_, std::optional<T>(std::move(item)));
    }
    changed_.notify_all();
  }

  // Waits until the slot is empty, then fills it, so no item is dropped. Returns false once closed.
  [[nodiscard]] bool put_when_empty(T item) {
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return closed_ || !slot_; });
      if (closed_) return false;
      slot_.emplace(std::move(item));
    }
    changed_.notify_all();
    return true;
  }

  // Waits until the slot is empty, so that a writer makes a fresh item. Returns false once closed.
  [[nodiscard]] bool wait_until_empty() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return closed_ || !slot_; });
    return !closed_;
  }

  // Waits for an item. Returns nullopt after `timeout`, or if the mailbox is closed and empty.
  [[nodiscard]] std::optional<T> take(std::chrono::milliseconds timeout) {
    std::optional<T> item;
    {
      std::unique_lock lock(mutex_);
      changed_.wait_for(lock, timeout, [this] { return closed_ || slot_; });
      item = std::exchange(slot_, std::nullopt);
    }
    changed_.notify_all();
    return item;
  }

  // Rejects further items; an item in the slot can still be taken. Wakes all threads.
  void close() {
    {
      const std::lock_guard lock(mutex_);
      closed_ = true;
    }
    changed_.notify_all();
  }

  // Returns true if the mailbox is closed and empty.
  [[nodiscard]] bool finished() const {
    const std::lock_guard lock(mutex_);
    return closed_ && !slot_;
  }

 private:
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  std::optional<T> slot_;  // guarded by mutex_
  bool closed_ = false;    // guarded by mutex_
};

}  // namespace penumbra
