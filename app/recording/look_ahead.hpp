// Produces items in order on a thread, a few ahead of the reader.
#pragma once

#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "core/error.hpp"

namespace penumbra {

// The end or the first error is returned in order, and all later calls of next() return it again.
// The destructor waits only for the item that is being produced.
template <class T>
class LookAhead {
 public:
  using Item = Result<std::optional<T>>;  // nullopt: the end

  // `make` is called by one thread at a time. With depth 0 there is no thread: next() calls `make`.
  LookAhead(std::function<Item()> make, int depth)
      : make_(std::move(make)), depth_(depth > 0 ? static_cast<std::size_t>(depth) : 0) {
    if (depth_ > 0) thread_ = std::thread([this] { run(); });
  }
  LookAhead(const LookAhead&) = delete;
  LookAhead& operator=(const LookAhead&) = delete;
  ~LookAhead() {
    {
      const std::lock_guard lock(mutex_);
      stop_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

  // Call this from one thread at a time.
  [[nodiscard]] Item next() {
    if (ended_) return error_ ? Item(tl::unexpected(*error_)) : Item(std::optional<T>());
    Item item = depth_ == 0 ? make_guarded() : take();
    ended_ = is_last(item);
    if (!item) error_ = item.error();
    return item;
  }

 private:
  static bool is_last(const Item& item) { return !item || !item->has_value(); }

  Item make_guarded() {
    try {
      return make_();
    } catch (const std::exception& error) {
      return fail("{}", error.what());
    }
  }

  Item take() {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [this] { return !made_.empty(); });
    Item item = std::move(made_.front());
    made_.pop_front();
    lock.unlock();
    changed_.notify_all();
    return item;
  }

  void run() {
    while (true) {
      {
        std::unique_lock lock(mutex_);
        changed_.wait(lock, [this] { return stop_ || made_.size() < depth_; });
        if (stop_) return;
      }
      Item item = make_guarded();
      const bool last = is_last(item);
      {
        const std::lock_guard lock(mutex_);
        made_.push_back(std::move(item));
      }
      changed_.notify_all();
      if (last) return;
    }
  }

  const std::function<Item()> make_;
  const std::size_t depth_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Item> made_;  // guarded by mutex_
  bool stop_ = false;      // guarded by mutex_
  bool ended_ = false;
  std::optional<Error> error_;  // error that ended the sequence
  std::thread thread_;
};

}  // namespace penumbra
