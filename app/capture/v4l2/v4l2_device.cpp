#include "app/capture/v4l2/v4l2_device.hpp"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <functional>

#include "app/capture/camera_trouble.hpp"
#include "core/text/text.hpp"

namespace penumbra {
namespace {

namespace fs = std::filesystem;

// Maximum length of a list; a broken driver's lists may be endless.
constexpr unsigned kMaxEntries = 256;

double rate_of(const v4l2_fract& interval) {
  return interval.numerator > 0 ? static_cast<double>(interval.denominator) / interval.numerator
                                : 0.0;
}

void add_rates(const V4l2Device& device, std::uint32_t fourcc, V4l2Size& size) {
  std::vector<double>& rates = size.rates;
  for (unsigned i = 0; i < kMaxEntries; ++i) {
    v4l2_frmivalenum entry{};
    entry.index = i;
    entry.pixel_format = fourcc;
    entry.width = static_cast<std::uint32_t>(size.max_width);
    entry.height = static_cast<std::uint32_t>(size.max_height);
    if (device.call(VIDIOC_ENUM_FRAMEINTERVALS, &entry) != 0) break;
    if (entry.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
      size.any_rate = true;
      rates.push_back(rate_of(entry.stepwise.min));  // the shortest interval
      rates.push_back(rate_of(entry.stepwise.max));
      break;
    }
    rates.push_back(rate_of(entry.discrete));
  }
  std::erase_if(rates, [](double rate) { return !(rate > 0.0); });
  std::ranges::sort(rates, std::greater());
  rates.erase(std::ranges::unique(rates).begin(), rates.end());
}

std::vector<V4l2Size> sizes_of(const V4l2Device& device, std::uint32_t fourcc) {
  std::vector<V4l2Size> sizes;
  for (unsigned i = 0; i < kMaxEntries; ++i) {
    v4l2_frmsizeenum entry{};
    entry.index = i;
    entry.pixel_format = fourcc;
    if (device.call(VIDIOC_ENUM_FRAMESIZES, &entry) != 0) break;
    V4l2Size size;
    if (entry.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
      size.width = size.max_width = static_cast<int>(entry.discrete.width);
      size.height = size.max_height = static_cast<int>(entry.discrete.height);
    } else {
      size.width = static_cast<int>(entry.stepwise.min_width);
      size.height = static_cast<int>(entry.stepwise.min_height);
      size.max_width = static_cast<int>(entry.stepwise.max_width);
      size.max_height = static_cast<int>(entry.stepwise.max_height);
    }
    add_rates(device, fourcc, size);
    sizes.push_back(std::move(size));
    if (entry.type != V4L2_FRMSIZE_TYPE_DISCRETE) break;
  }
  return sizes;
}

// Returns true if a user can set the control.
bool is_setting(const v4l2_queryctrl& about) {
  constexpr std::uint32_t kNotSettable =
      V4L2_CTRL_FLAG_READ_ONLY | V4L2_CTRL_FLAG_INACTIVE | V4L2_CTRL_FLAG_VOLATILE;
  const auto of_class = V4L2_CTRL_ID2CLASS(about.id);
  const bool common = (of_class == V4L2_CTRL_CLASS_USER || of_class == V4L2_CTRL_CLASS_CAMERA) &&
                      !V4L2_CTRL_DRIVER_PRIV(about.id);
  return common && (about.flags & kNotSettable) == 0;
}

}  // namespace

std::string v4l2_text(std::span<const std::uint8_t> field) {
  const auto* begin = reinterpret_cast<const char*>(field.data());
  return without_control_characters(std::string(begin, strnlen(begin, field.size())));
}

std::string fourcc_text(std::uint32_t fourcc) {
  std::string text;
  for (int i = 0; i < 4; ++i) {
    const char c = static_cast<char>((fourcc >> (8 * i)) & 0x7FU);
    if (c > ' ') text.push_back(c);
  }
  return text;
}

std::string v4l2_open_error(const fs::path& path, int error) {
  const std::string name = path.string();
  switch (error) {
    case ENOENT:
    case ENODEV:
    case ENXIO:
      return fmt::format("{}: no such camera; plug it in, or see what there is: penumbra devices",
                         name);
    case EACCES:
    case EPERM:
      return fmt::format("{}: no permission to use the camera; {}", name, kJoinVideoGroup);
    case EBUSY:
      return fmt::format(
          "{}: another program uses the camera; close that one (fuser -v {} names it)", name, name);
    default:
      return fmt::format(
          "{}: cannot be opened: {}; unplug the camera and plug it in again, or see the kernel's "
          "log (dmesg)",
          name, message_of(error));
  }
}

std::string v4l2_call_error(const fs::path& path, const char* call, int error) {
  const std::string what = fmt::format("{}: {} fails: {}", path.string(), call, message_of(error));
  switch (error) {
    case ENOSPC:
      return fmt::format("{}: {}", path.string(), kFreeBandwidth);
    case EINVAL:
      return what + "; choose another --format or --size, and see the kernel's log (dmesg)";
    case ENOMEM:
      return what + "; close other programs, or choose a smaller --size";
    case EPIPE:
      return what + "; its media pipeline is not set up: open the camera through libcamera";
    case EIO:
    case EPROTO:
    case ETIMEDOUT:
    case EILSEQ:
    case EOVERFLOW:
      return what + "; try another USB port or cable, and see the kernel's log (dmesg)";
    default:
      return fault_of(error) == CaptureFault::io_error ? what + "; see the kernel's log (dmesg)"
                                                       : v4l2_open_error(path, error);
  }
}

std::string multi_planar_error(const fs::path& path, const std::string& card) {
  return fmt::format(
      "{}: has only V4L2's multi-planar interface ({}), which is not read; open the camera through "
      "libcamera (penumbra devices lists libcamera:0 and so on)",
      path.string(), card);
}

Result<V4l2Device> V4l2Device::open(const fs::path& path) {
  std::error_code ignored;
  V4l2Device device;
  device.path_ = path;
  device.descriptor_ = ::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC);
  if (device.descriptor_ < 0) return fail("{}", v4l2_open_error(path, errno));
  v4l2_capability about{};
  const int error =
      fs::is_character_file(path, ignored) ? device.call(VIDIOC_QUERYCAP, &about) : ENOTTY;
  if (error == ENOTTY || error == EINVAL) {
    return fail("{}: is not a camera; see what there is: penumbra devices", path.string());
  }
  if (error != 0) return fail("{}", v4l2_open_error(path, error));
  device.identity_ = {v4l2_text(about.driver), v4l2_text(about.card), v4l2_text(about.bus_info)};
  const std::uint32_t can =
      (about.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? about.device_caps : about.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0) {
    if ((can & V4L2_CAP_VIDEO_CAPTURE_MPLANE) != 0) {
      return fail("{}", multi_planar_error(path, device.identity_.card));
    }
    const char* what = (can & V4L2_CAP_META_CAPTURE) != 0 ? "gives data about frames, not frames"
                                                          : "gives no frames";
    return fail("{}: {} ({}); see what there is: penumbra devices", path.string(), what,
                device.identity_.card);
  }
  if ((can & V4L2_CAP_STREAMING) == 0) {
    return fail("{}: can't stream ({}); see what there is: penumbra devices", path.string(),
                device.identity_.card);
  }
  return device;
}

V4l2Device::V4l2Device(V4l2Device&& other) noexcept {
  *this = std::move(other);
}

V4l2Device& V4l2Device::operator=(V4l2Device&& other) noexcept {
  std::swap(path_, other.path_);
  std::swap(identity_, other.identity_);
  std::swap(descriptor_, other.descriptor_);
  return *this;
}

V4l2Device::~V4l2Device() {
  if (descriptor_ >= 0) close(descriptor_);
}

int V4l2Device::call(unsigned long request, void* argument) const {
  while (ioctl(descriptor_, request, argument) != 0) {
    if (errno != EINTR) return errno;
  }
  return 0;
}

std::vector<V4l2Format> V4l2Device::formats() const {
  std::vector<V4l2Format> formats;
  for (unsigned i = 0; i < kMaxEntries; ++i) {
    v4l2_fmtdesc entry{};
    entry.index = i;
    entry.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    if (call(VIDIOC_ENUM_FMT, &entry) != 0) break;
    formats.push_back(
        {entry.pixelformat, v4l2_text(entry.description), sizes_of(*this, entry.pixelformat)});
  }
  return formats;
}

int V4l2Device::request_buffers(unsigned& count) const {
  v4l2_requestbuffers request{};
  request.count = count;
  request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  request.memory = V4L2_MEMORY_MMAP;
  const int error = call(VIDIOC_REQBUFS, &request);
  count = request.count;
  return error;
}

bool V4l2Device::busy() const {
  // A request for no buffers is refused only while another descriptor owns some.
  unsigned none = 0;
  return request_buffers(none) == EBUSY;
}

std::optional<V4l2Controls> V4l2Device::controls() const {
  V4l2Controls controls;
  v4l2_queryctrl entry{};
  entry.id = V4L2_CTRL_FLAG_NEXT_CTRL;
  for (unsigned i = 0; i < kMaxEntries; ++i) {
    const int status = call(VIDIOC_QUERYCTRL, &entry);
    if (status == EINVAL || status == ENOTTY) break;  // no further control, or no controls at all
    if (status != 0) return std::nullopt;
    const bool is_switch = entry.type == V4L2_CTRL_TYPE_BOOLEAN ||
                           entry.type == V4L2_CTRL_TYPE_MENU ||
                           entry.type == V4L2_CTRL_TYPE_INTEGER_MENU;
    const bool readable =
        (entry.flags & (V4L2_CTRL_FLAG_DISABLED | V4L2_CTRL_FLAG_WRITE_ONLY)) == 0;
    if ((is_switch || entry.type == V4L2_CTRL_TYPE_INTEGER) && readable) {
      v4l2_control control{};
      control.id = entry.id;
      const int error = call(VIDIOC_G_CTRL, &control);
      // Gives up here, because a camera that hangs would time out once per control.
      if (error == ENODEV || error == EIO || error == ETIMEDOUT) return std::nullopt;
      if (error == 0) {
        controls.named.emplace_back(v4l2_text(entry.name), control.value);
        if (is_setting(entry)) controls.settings.push_back({entry.id, control.value, is_switch});
      }
    }
    entry.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
  }
  return controls;
}

void V4l2Device::restore(const std::vector<V4l2Setting>& settings) const {
  for (const bool switches : {true, false}) {
    for (const V4l2Setting& setting : settings) {
      if (setting.is_switch != switches) continue;
      const auto now = control(setting.id);
      if (now && *now != setting.value) (void)set_control(setting.id, setting.value);
    }
  }
}

std::optional<std::int32_t> V4l2Device::control(std::uint32_t id) const {
  v4l2_control control{};
  control.id = id;
  if (call(VIDIOC_G_CTRL, &control) != 0) return std::nullopt;
  return control.value;
}

std::optional<V4l2Range> V4l2Device::range(std::uint32_t id) const {
  v4l2_queryctrl about{};
  about.id = id;
  if (call(VIDIOC_QUERYCTRL, &about) != 0 || (about.flags & V4L2_CTRL_FLAG_DISABLED) != 0) {
    return std::nullopt;
  }
  return V4l2Range{about.minimum, about.maximum, about.default_value};
}

bool V4l2Device::set_control(std::uint32_t id, std::int32_t value) const {
  v4l2_control control{};
  control.id = id;
  control.value = value;
  return call(VIDIOC_S_CTRL, &control) == 0;
}

std::vector<fs::path> list_v4l2_paths() {
  std::vector<std::pair<std::int64_t, fs::path>> found;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator("/dev", error)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with("video")) continue;
    if (const auto number = parse_integer(std::string_view(name).substr(5))) {
      found.emplace_back(*number, entry.path());
    }
  }
  std::sort(found.begin(), found.end());
  std::vector<fs::path> paths;
  for (auto& [number, path] : found) paths.push_back(std::move(path));
  return paths;
}

}  // namespace penumbra
