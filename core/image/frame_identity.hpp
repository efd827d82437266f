// Recognises a frame that comes again.
#pragma once

#include <cstdint>
#include <memory>

#include "core/image/frame.hpp"

namespace penumbra {

// Frames are immutable, so a frame with the same pixels and the same living owner is the same.
class FrameIdentity {
 public:
  void remember(const Frame& frame) {
    owner_ = frame.owner;
    data_ = frame.planes[0].data;
  }
  // Returns true if the frame is the one that was remembered; false if it has no owner.
  [[nodiscard]] bool matches(const Frame& frame) const {
    return frame.owner && !owner_.expired() && !owner_.owner_before(frame.owner) &&
           !frame.owner.owner_before(owner_) && frame.planes[0].data == data_;
  }

 private:
  std::weak_ptr<const void> owner_;
  const std::uint8_t* data_ = nullptr;
};

}  // namespace penumbra
