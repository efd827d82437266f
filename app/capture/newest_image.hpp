// Provides slow readers with a camera's newest image: a thread waits for the camera and replaces an
// unread image by the next one.
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
  // `source` must outlive this object; the destructor stops it.
  explicit NewestImage(LiveSource& source);
  NewestImage(const NewestImage&) = delete;
  NewestImage& operator=(const NewestImage&) = delete;
  ~NewestImage();

  // Returns nullopt if no image arrived in time, or if it is damaged.
  [[nodiscard]] std::optional<Frame> take(std::chrono::milliseconds timeout);
  // Returns true if no more images will arrive; error() is set if the source failed.
  [[nodiscard]] bool finished() const { return newest_.finished(); }
  [[nodiscard]] std::optional<Error> error() const;

 private:
  void capture();
  void set_error(Error error);

  LiveSource& source_;
  Mailbox<CapturedImage> newest_;
  mutable std::mutex mutex_;
  std::optional<Error> error_;  // guarded by mutex_
  std::thread capture_;         // declared last, because the thread uses the other members
};

}  // namespace penumbra
