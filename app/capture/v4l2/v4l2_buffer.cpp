#include "app/capture/v4l2/v4l2_buffer.hpp"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/mman.h>

#include <cerrno>
#include <utility>

namespace penumbra {

tl::expected<V4l2Buffer, int> V4l2Buffer::map(const V4l2Device& device, unsigned index,
                                              bool share) {
  v4l2_buffer about{};
  about.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  about.memory = V4L2_MEMORY_MMAP;
  about.index = index;
  if (const int error = device.call(VIDIOC_QUERYBUF, &about); error != 0) {
    return tl::unexpected(error);
  }
  V4l2Buffer buffer;
  if (share) {
    v4l2_exportbuffer requested{};
    requested.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    requested.index = index;
    requested.flags = O_CLOEXEC | O_RDWR;  // some GPU drivers map what they import for both
    if (device.call(VIDIOC_EXPBUF, &requested) == 0) {
      if (auto memory = DmaBufMemory::map(requested.fd, about.length)) {
        buffer.shared_ = std::move(*memory);
        return buffer;
      }
      // Exported, but not for the processor.
    }
  }
  void* start = mmap(nullptr, about.length, PROT_READ, MAP_SHARED, device.descriptor(),
                     static_cast<off_t>(about.m.offset));
  if (start == MAP_FAILED) return tl::unexpected(errno);
  buffer.own_ = {static_cast<const std::uint8_t*>(start), about.length};
  return buffer;
}

V4l2Buffer::V4l2Buffer(V4l2Buffer&& other) noexcept
    : shared_(std::move(other.shared_)), own_(std::exchange(other.own_, {})) {}

V4l2Buffer& V4l2Buffer::operator=(V4l2Buffer&& other) noexcept {
  std::swap(shared_, other.shared_);
  std::swap(own_, other.own_);
  return *this;
}

V4l2Buffer::~V4l2Buffer() {
  if (!own_.empty()) munmap(const_cast<std::uint8_t*>(own_.data()), own_.size());
}

void V4l2Buffer::begin_reading() const {
  if (shared_) shared_->begin_reading();
}

void V4l2Buffer::end_reading() const {
  if (shared_) shared_->end_reading();
}

}  // namespace penumbra
