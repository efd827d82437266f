// A camera's newest image, for slow readers: a thread waits for the camera and drops images that
// were not taken.
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

class NewestImage {
 public:
  // `source` outlives this; the destructor stops it.
  explicit NewestImage(LiveSource& source);
  NewestImage(const NewestImage&) = delete;
  NewestImage& operator=(const NewestImage&) = delete;
  ~NewestImage();

  // Empty if no image came in time, or a damaged one.
  [[nodiscard]] std::optional<Frame> take(std::chrono::milliseconds patience);
  // No more images will come; error() is set if the source failed.
  [[nodiscard]] bool finished() const { return newest_.finished(); }
  [[nodiscard]] std::optional<Error> error() const;

 private:
  void capture();
  void set_error(Error error);

  LiveSource& source_;
  Mailbox<CapturedImage> newest_;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_;         // last: it uses the others
};

}  // namespace penumbra
