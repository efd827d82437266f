// Lends a camera driver's buffers to frames. The last owner of a frame returns its buffer, on any
// thread and even after the camera is closed: every lent buffer keeps the ring alive.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <vector>

namespace penumbra {

class BufferRing : public std::enable_shared_from_this<BufferRing> {
 public:
  struct Driver {
    std::function<bool(unsigned index)> queue;  // false: the driver refused the buffer
    std::function<void()> release;              // frees all memory; called once, at the end
  };

  [[nodiscard]] static std::shared_ptr<BufferRing> create(
      std::vector<std::span<const std::uint8_t>> buffers, Driver driver);
  BufferRing(const BufferRing&) = delete;
  BufferRing& operator=(const BufferRing&) = delete;
  ~BufferRing();

  // Queues all buffers. Returns false if the driver refuses one.
  [[nodiscard]] bool queue_all();
  // Lends a buffer that the driver has filled. The last copy of the result queues it again.
  [[nodiscard]] std::shared_ptr<const void> lend(unsigned index);
  [[nodiscard]] std::span<const std::uint8_t> buffer(unsigned index) const {
    return buffers_[index];
  }
  [[nodiscard]] std::size_t size() const { return buffers_.size(); }
  // Number of buffers that are queued in the driver.
  [[nodiscard]] std::size_t in_driver() const;
  // Returns true if the driver refused a returned buffer; the stream must then be restarted.
  [[nodiscard]] bool refused() const;
  // Stops all calls to the driver; buffers that are returned later are not queued.
  void close();

 private:
  BufferRing(std::vector<std::span<const std::uint8_t>> buffers, Driver driver);
  void return_buffer(unsigned index);

  const std::vector<std::span<const std::uint8_t>> buffers_;
  const Driver driver_;
  mutable std::mutex mutex_;
  std::size_t in_driver_ = 0;  // guarded by mutex_
  bool refused_ = false;       // guarded by mutex_
  bool closed_ = false;        // guarded by mutex_
};

}  // namespace penumbra
