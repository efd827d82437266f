#include "app/capture/v4l2/buffer_memory.hpp"

#include <fcntl.h>
#include <linux/dma-buf.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <utility>

#include "core/propagate.hpp"

namespace penumbra {
namespace {

void sync_caches(int descriptor, std::uint64_t flags) {
  if (descriptor < 0) return;
  dma_buf_sync sync{};
  sync.flags = flags | DMA_BUF_SYNC_READ;
  // Any other error means that the device was removed; its memory stays readable.
  while (ioctl(descriptor, DMA_BUF_IOCTL_SYNC, &sync) != 0 && errno == EINTR) {
  }
}

// Errors are errnos.
tl::expected<std::span<const std::uint8_t>, int> map_bytes(int descriptor, std::size_t length,
                                                           off_t offset) {
  void* start = mmap(nullptr, length, PROT_READ, MAP_SHARED, descriptor, offset);
  if (start == MAP_FAILED) return tl::unexpected(errno);
  return std::span(static_cast<const std::uint8_t*>(start), length);
}

}  // namespace

tl::expected<BufferMemory, int> BufferMemory::map(int descriptor, std::size_t length) {
  static std::atomic<std::uint64_t> last_number{0};
  BufferMemory memory;
  memory.descriptor_ = descriptor;
  PENUMBRA_TRY(memory.bytes_, map_bytes(descriptor, length, 0));
  memory.number_ = ++last_number;
  return memory;
}

tl::expected<BufferMemory, int> BufferMemory::map(const V4l2Device& device, unsigned index,
                                                  bool share) {
  v4l2_buffer about{};
  about.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  about.memory = V4L2_MEMORY_MMAP;
  about.index = index;
  if (const int error = device.call(VIDIOC_QUERYBUF, &about); error != 0) {
    return tl::unexpected(error);
  }
  if (share) {
    v4l2_exportbuffer requested{};
    requested.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    requested.index = index;
    requested.flags = O_CLOEXEC | O_RDWR;  // some GPU drivers map imports read-write
    if (device.call(VIDIOC_EXPBUF, &requested) == 0) {
      if (auto memory = map(requested.fd, about.length)) return memory;
    }
  }
  BufferMemory memory;
  PENUMBRA_TRY(memory.bytes_,
               map_bytes(device.descriptor(), about.length, static_cast<off_t>(about.m.offset)));
  return memory;
}

BufferMemory::BufferMemory(BufferMemory&& other) noexcept {
  *this = std::move(other);
}

BufferMemory& BufferMemory::operator=(BufferMemory&& other) noexcept {
  std::swap(bytes_, other.bytes_);
  std::swap(descriptor_, other.descriptor_);
  std::swap(number_, other.number_);
  return *this;
}

BufferMemory::~BufferMemory() {
  if (!bytes_.empty()) munmap(const_cast<std::uint8_t*>(bytes_.data()), bytes_.size());
  if (descriptor_ >= 0) close(descriptor_);
}

void BufferMemory::begin_reading() const {
  sync_caches(descriptor_, DMA_BUF_SYNC_START);
}

void BufferMemory::end_reading() const {
  sync_caches(descriptor_, DMA_BUF_SYNC_END);
}

}  // namespace penumbra
