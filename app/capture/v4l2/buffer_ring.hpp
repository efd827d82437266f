// The buffers that a camera's driver fills, lent to frames. A frame's last owner gives its buffer
// back, on whatever thread that is and also after the camera was closed: the ring lives as long as
// anyone holds one of its buffers.
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
  // What the ring does with the memory and the driver: queue buffer `index` for filling (false: the
  // driver refused), and let all the memory go, once, at the very end.
  struct Driver {
    std::function<bool(unsigned index)> queue;
    std::function<void()> release;
  };

  [[nodiscard]] static std::shared_ptr<BufferRing> create(
      std::vector<std::span<const std::uint8_t>> buffers, Driver driver);
  BufferRing(const BufferRing&) = delete;
  BufferRing& operator=(const BufferRing&) = delete;
  ~BufferRing();

  // Gives every buffer to the driver. False: the driver refused one.
  [[nodiscard]] bool queue_all();
  // A buffer that the driver has filled; when the result and its copies are gone, the buffer goes
  // back to the driver.
  [[nodiscard]] std::shared_ptr<const void> lend(unsigned index);
  [[nodiscard]] std::span<const std::uint8_t> buffer(unsigned index) const {
    return buffers_[index];
  }
  [[nodiscard]] std::size_t size() const { return buffers_.size(); }
  // How many buffers the driver has to fill.
  [[nodiscard]] std::size_t in_driver() const;
  // Whether the driver refused a buffer that came back: the stream has to be set up again.
  [[nodiscard]] bool refused() const;
  // From now on buffers that come back stay here. The driver is not called any more.
  void close();

 private:
  BufferRing(std::vector<std::span<const std::uint8_t>> buffers, Driver driver);
  void give_back(unsigned index);

  const std::vector<std::span<const std::uint8_t>> buffers_;
  const Driver driver_;
  mutable std::mutex mutex_;
  std::size_t in_driver_ = 0;  // guarded by mutex_
  bool refused_ = false;       // guarded by mutex_
  bool closed_ = false;        // guarded by mutex_
};

}  // namespace penumbra
