// The buffers that a camera's driver fills, lent to frames. A frame's last owner returns its
// buffer, on any thread and also after the camera was closed: every lent buffer keeps the ring
// alive.
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
    std::function<bool(unsigned index)> queue;  // for filling; false: the driver refused
    std::function<void()> release;              // frees all the memory, once, at the end
  };

  [[nodiscard]] static std::shared_ptr<BufferRing> create(
      std::vector<std::span<const std::uint8_t>> buffers, Driver driver);
  BufferRing(const BufferRing&) = delete;
  BufferRing& operator=(const BufferRing&) = delete;
  ~BufferRing();

  // Queues every buffer. False: the driver refused one.
  [[nodiscard]] bool queue_all();
  // Takes a buffer that the driver has filled; the last copy of the result queues it again.
  [[nodiscard]] std::shared_ptr<const void> lend(unsigned index);
  [[nodiscard]] std::span<const std::uint8_t> buffer(unsigned index) const {
    return buffers_[index];
  }
  [[nodiscard]] std::size_t size() const { return buffers_.size(); }
  // Number of buffers that the driver has to fill.
  [[nodiscard]] std::size_t in_driver() const;
  // The driver refused a returned buffer: the stream must be restarted.
  [[nodiscard]] bool refused() const;
  // Ends all calls of the driver; returned buffers stay here.
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
