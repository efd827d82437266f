#include "app/capture/newest_image.hpp"

#include <exception>
#include <utility>

namespace penumbra {

NewestImage::NewestImage(LiveSource& source) : source_(source), capture_([this] { capture(); }) {}

NewestImage::~NewestImage() {
  source_.stop();
  newest_.close();
  capture_.join();
}

std::optional<Frame> NewestImage::take(std::chrono::milliseconds timeout) {
  const std::optional<CapturedImage> image = newest_.take(timeout);
  return image ? source_.decode(*image) : std::nullopt;
}

std::optional<Error> NewestImage::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

void NewestImage::capture() {
  try {
    for (;;) {
      auto image = source_.next_image();
      if (!image) {
        set_error(image.error());
        break;
      }
      if (!*image) break;
      newest_.put(std::move(**image));
    }
  } catch (const std::exception& error) {
    set_error({error.what()});
  }
  newest_.close();
}

void NewestImage::set_error(Error error) {
  const std::lock_guard lock(mutex_);
  error_ = std::move(error);
}

}  // namespace penumbra
