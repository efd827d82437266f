// A Video4Linux device: its identity, formats and controls.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

struct V4l2Size {
  int width = 0;   // [px]
  int height = 0;  // [px]
  // Upper end if the driver lists a range of sizes, else equal to `width` and `height`.
  int max_width = 0;
  int max_height = 0;
  // Frame rates [1/s] in descending order: all rates, or both ends of a range if `any_rate`. Empty
  // if the driver does not report them. For a range of sizes: the rates at its largest size.
  std::vector<double> rates;
  bool any_rate = false;

  [[nodiscard]] double fastest() const { return rates.empty() ? 0.0 : rates.front(); }
  [[nodiscard]] bool covers(int w, int h) const {
    return w >= width && w <= max_width && h >= height && h <= max_height;
  }
};

struct V4l2Format {
  std::uint32_t fourcc = 0;
  std::string description;
  std::vector<V4l2Size> sizes;
};

// A standard control (brightness, gain, exposure, ...) and its value.
struct V4l2Setting {
  std::uint32_t id = 0;
  std::int32_t value = 0;
  bool is_switch = false;  // a switch or a menu, for example of automatic modes
};
struct V4l2Controls {
  std::vector<std::pair<std::string, std::int64_t>> named;  // all readable numbers and switches
  std::vector<V4l2Setting> settings;                        // controls that a user can set
};

// Range of a numeric control, in the control's own steps.
struct V4l2Range {
  std::int32_t minimum = 0;
  std::int32_t maximum = 0;
  std::int32_t default_value = 0;  // the driver's default
};

struct V4l2Identity {
  std::string driver, card, bus;
};

// An open device; closed by the destructor.
class V4l2Device {
 public:
  // Fails if there is no such device or camera, or if the user lacks the permission (group video).
  [[nodiscard]] static Result<V4l2Device> open(const std::filesystem::path& path);
  V4l2Device(V4l2Device&& other) noexcept;
  V4l2Device& operator=(V4l2Device&& other) noexcept;
  ~V4l2Device();

  // Calls ioctl() and repeats it after signals. Returns 0 or the errno.
  [[nodiscard]] int call(unsigned long request, void* argument) const;
  [[nodiscard]] int descriptor() const { return descriptor_; }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] const V4l2Identity& identity() const { return identity_; }

  [[nodiscard]] std::vector<V4l2Format> formats() const;
  // VIDIOC_REQBUFS for mapped buffers. Sets `count` to the granted number. Returns 0 or the errno.
  [[nodiscard]] int request_buffers(unsigned& count) const;
  // Returns true while another program owns the device's buffers; this program can't stream then.
  [[nodiscard]] bool busy() const;
  // Returns nullopt if the device disappears or does not answer.
  [[nodiscard]] std::optional<V4l2Controls> controls() const;
  // Sets the controls whose values differ from `settings`: switches first, because many drivers
  // refuse a value while its automatic mode is on.
  void restore(const std::vector<V4l2Setting>& settings) const;
  // control() and range() return nullopt if there is no such control.
  [[nodiscard]] std::optional<std::int32_t> control(std::uint32_t id) const;
  [[nodiscard]] std::optional<V4l2Range> range(std::uint32_t id) const;
  // Returns false if there is no such control, or if it refuses the value.
  bool set_control(std::uint32_t id, std::int32_t value) const;

 private:
  V4l2Device() = default;
  std::filesystem::path path_;
  V4l2Identity identity_;
  int descriptor_ = -1;
};

// Lists /dev/video* in the order of their numbers.
[[nodiscard]] std::vector<std::filesystem::path> list_v4l2_paths();
[[nodiscard]] std::string fourcc_text(std::uint32_t fourcc);
// Returns a text field of a V4L2 struct as one line.
[[nodiscard]] std::string v4l2_text(std::span<const std::uint8_t> field);
// Describes why opening the device failed with this errno, and the remedy.
[[nodiscard]] std::string v4l2_open_error(const std::filesystem::path& path, int error);
// Describes why a `call` (an ioctl or its purpose) failed on an open device, and the remedy.
[[nodiscard]] std::string v4l2_call_error(const std::filesystem::path& path, const char* call,
                                          int error);
// Error message for a device that has only the multi-planar interface.
[[nodiscard]] std::string multi_planar_error(const std::filesystem::path& path,
                                             const std::string& card);

}  // namespace penumbra
