// A Video4Linux device: its identity, formats and controls.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/error.hpp"

namespace penumbra {

struct V4l2Size {
  int width = 0;   // [px]
  int height = 0;  // [px]
  // Any size from this one up to max_width x max_height, where the driver lists a range.
  int max_width = 0;
  int max_height = 0;
  // [1/s], the highest first; all of them, or where any up to the highest can be set, `any_rate`
  // and both ends. None where the driver does not say. Of a range of sizes: of its largest.
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

// A control of those that every camera may have (brightness, gain, exposure, ...) and its value.
struct V4l2Setting {
  std::uint32_t id = 0;
  std::int32_t value = 0;
  bool is_switch = false;  // or a menu, for example of automatic modes
};
struct V4l2Controls {
  std::vector<std::pair<std::string, std::int64_t>> named;  // all that are numbers
  // Controls that a user can set: not those that the camera adjusts or that only its driver has.
  std::vector<V4l2Setting> settings;
};

// Range of a numeric control, in its own steps.
struct V4l2Range {
  std::int32_t minimum = 0;
  std::int32_t maximum = 0;
  std::int32_t usual = 0;  // the driver's default
};

struct V4l2Identity {
  std::string driver, card, bus;
};

// An open device; closed by the destructor.
class V4l2Device {
 public:
  // Errors say what to do: no such device, no permission (the video group), not a camera.
  [[nodiscard]] static Result<V4l2Device> open(const std::filesystem::path& path);
  V4l2Device(V4l2Device&& other) noexcept;
  V4l2Device& operator=(V4l2Device&& other) noexcept;
  ~V4l2Device();

  // ioctl that goes on after signals. 0, or the error's number.
  [[nodiscard]] int call(unsigned long request, void* argument) const;
  [[nodiscard]] int descriptor() const { return descriptor_; }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }
  [[nodiscard]] const V4l2Identity& identity() const { return identity_; }

  [[nodiscard]] std::vector<V4l2Format> formats() const;
  // Returns true while another program has its buffers: it can't stream then.
  [[nodiscard]] bool busy() const;
  // Nothing where the device goes, or does not answer, meanwhile.
  [[nodiscard]] std::optional<V4l2Controls> controls() const;
  // As far as they are other now and can be set: switches first, for while something is automatic
  // many drivers take no value for it.
  void restore(const std::vector<V4l2Setting>& settings) const;
  // Its value; nothing where there is no such control.
  [[nodiscard]] std::optional<std::int32_t> control(std::uint32_t id) const;
  // Nothing where there is no such control.
  [[nodiscard]] std::optional<V4l2Range> range(std::uint32_t id) const;
  // False: there is no such control, or it can't be set to that.
  bool set_control(std::uint32_t id, std::int32_t value) const;

 private:
  V4l2Device() = default;
  std::filesystem::path path_;
  V4l2Identity identity_;
  int descriptor_ = -1;
};

// /dev/video*, in the order of their numbers.
[[nodiscard]] std::vector<std::filesystem::path> list_v4l2_paths();
[[nodiscard]] std::string fourcc_text(std::uint32_t fourcc);
// Describes the fault and its remedy where opening the device fails with this error (an errno).
[[nodiscard]] std::string v4l2_help(const std::filesystem::path& path, int error);
// The same where `call` (an ioctl or what is done with it) fails on an open device.
[[nodiscard]] std::string v4l2_call_help(const std::filesystem::path& path, const char* call,
                                         int error);

// Message for a device that has the multi-planar interface alone.
[[nodiscard]] std::string multi_planar_text(const std::filesystem::path& path,
                                            const std::string& card);

}  // namespace penumbra
