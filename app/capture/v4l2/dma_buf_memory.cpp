#include "app/capture/v4l2/dma_buf_memory.hpp"

#include <linux/dma-buf.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <utility>

namespace penumbra {
namespace {

void sync_caches(int descriptor, std::uint64_t flags) {
  dma_buf_sync sync{};
  sync.flags = flags | DMA_BUF_SYNC_READ;
  // What fails here is a signal in between, or a device that is gone: its pictures stay as they
  // are.
  while (ioctl(descriptor, DMA_BUF_IOCTL_SYNC, &sync) != 0 && errno == EINTR) {
  }
}

}  // namespace

tl::expected<DmaBufMemory, int> DmaBufMemory::map(int descriptor, std::size_t length) {
  static std::atomic<std::uint64_t> last_number{0};
  DmaBufMemory memory(descriptor);
  void* start = mmap(nullptr, length, PROT_READ, MAP_SHARED, descriptor, 0);
  if (start == MAP_FAILED) return tl::unexpected(errno);
  memory.bytes_ = {static_cast<const std::uint8_t*>(start), length};
  memory.number_ = ++last_number;
  return memory;
}

DmaBufMemory::DmaBufMemory(DmaBufMemory&& other) noexcept
    : bytes_(std::exchange(other.bytes_, {})),
      descriptor_(std::exchange(other.descriptor_, -1)),
      number_(other.number_) {}

DmaBufMemory& DmaBufMemory::operator=(DmaBufMemory&& other) noexcept {
  std::swap(bytes_, other.bytes_);
  std::swap(descriptor_, other.descriptor_);
  std::swap(number_, other.number_);
  return *this;
}

DmaBufMemory::~DmaBufMemory() {
  if (!bytes_.empty()) munmap(const_cast<std::uint8_t*>(bytes_.data()), bytes_.size());
  if (descriptor_ >= 0) close(descriptor_);
}

void DmaBufMemory::begin_reading() const {
  sync_caches(descriptor_, DMA_BUF_SYNC_START);
}

void DmaBufMemory::end_reading() const {
  sync_caches(descriptor_, DMA_BUF_SYNC_END);
}

}  // namespace penumbra
