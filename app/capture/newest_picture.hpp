// A camera's newest picture, for programs that look when they have time: one thread waits for the
// camera, and what comes before the last one was looked at takes its place.
#pragma once

#include <chrono>
#include <mutex>
#include <optional>
#include <thread>

#include "app/capture/live_source.hpp"
#include "app/capture/mailbox.hpp"
#include "core/error.hpp"
#include "core/image/frame.hpp"

namespace penumbra {

class NewestPicture {
 public:
  // `source` outlives it, and is stopped at its end.
  explicit NewestPicture(LiveSource& source);
  NewestPicture(const NewestPicture&) = delete;
  NewestPicture& operator=(const NewestPicture&) = delete;
  ~NewestPicture();

  // Nothing where none came in time, or the one that came is broken.
  [[nodiscard]] std::optional<Frame> take(std::chrono::milliseconds patience);
  // Whether there will be no more.
  [[nodiscard]] bool finished() const { return newest_.finished(); }
  // Why, where that is an error.
  [[nodiscard]] std::optional<Error> error() const;

 private:
  void capture();
  void set_error(Error error);

  LiveSource& source_;
  Mailbox<CapturedImage> newest_;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_;         // the last to begin: it uses the others
};

}  // namespace penumbra
