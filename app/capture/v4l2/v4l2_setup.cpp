#include "app/capture/v4l2/v4l2_setup.hpp"

#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "app/logging.hpp"

namespace penumbra {
namespace {

constexpr double kExposureStepsPerMs = 10.0;  // V4L2_CID_EXPOSURE_ABSOLUTE counts in 100 us

struct NumberControl {
  std::uint32_t id;
  const char* name;
  double steps_per_unit;
  const char* unit;  // with a blank before it, or empty
};
constexpr NumberControl kFocus{V4L2_CID_FOCUS_ABSOLUTE, "focus", 1.0, ""};
constexpr NumberControl kExposure{V4L2_CID_EXPOSURE_ABSOLUTE, "exposure", kExposureStepsPerMs,
                                  " ms"};
constexpr NumberControl kGain{V4L2_CID_GAIN, "gain", 1.0, ""};
constexpr NumberControl kWhiteBalance{V4L2_CID_WHITE_BALANCE_TEMPERATURE, "white balance", 1.0,
                                      " K"};

std::int32_t in_steps(double value) {
  constexpr double kMost = std::numeric_limits<std::int32_t>::max();
  return static_cast<std::int32_t>(std::lround(std::clamp(value, -kMost, kMost)));
}

void set_number(const V4l2Device& device, const NumberControl& control, double asked, bool report) {
  const std::int32_t steps = in_steps(asked * control.steps_per_unit);
  if (!device.set_control(control.id, steps)) {
    const auto range = device.range(control.id);
    if (!report) return;
    if (!range) {
      log_warning("{}: the camera has no {} to set; it stays as it is", device.path().string(),
                  control.name);
      return;
    }
    log_warning("{}: {} {:.6g}{} is refused and stays as it is; it takes {:.6g} to {:.6g}{}",
                device.path().string(), control.name, asked, control.unit,
                range->minimum / control.steps_per_unit, range->maximum / control.steps_per_unit,
                control.unit);
    return;
  }
  const auto got = device.control(control.id);
  if (!report || !got || *got == steps) return;
  log_warning("{}: {}", device.path().string(),
              changed_control_text(control.name, control.steps_per_unit, control.unit, asked, *got,
                                   device.range(control.id)));
}

void set_switch(const V4l2Device& device, const char* name, std::uint32_t id, std::int32_t value,
                bool report) {
  const bool done = device.set_control(id, value);
  if (report && !done) {
    log_warning("{}: the camera has no {} to set; it stays as it is", device.path().string(), name);
  }
}

std::string text_of(const v4l2_rect& r) {
  return fmt::format("{}x{}+{}+{}", r.width, r.height, r.left, r.top);
}

bool equal(const v4l2_rect& a, const v4l2_rect& b) {
  return a.left == b.left && a.top == b.top && a.width == b.width && a.height == b.height;
}

std::optional<v4l2_rect> selection(const V4l2Device& device, std::uint32_t target) {
  v4l2_selection about{};
  about.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  about.target = target;
  if (device.call(VIDIOC_G_SELECTION, &about) != 0) return std::nullopt;
  return about.r;
}

void reset_selection(const V4l2Device& device, const char* name, std::uint32_t target,
                     std::uint32_t default_target) {
  const auto now = selection(device, target);
  const auto whole = selection(device, default_target);
  if (!now || !whole || equal(*now, *whole)) return;
  v4l2_selection wanted{};
  wanted.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  wanted.target = target;
  wanted.r = *whole;
  (void)device.call(VIDIOC_S_SELECTION, &wanted);
  const auto then = selection(device, target);
  if (then && equal(*then, *now)) {
    log_warning(
        "{}: its {} of {} can't be set back to {}; the view differs from the calibrated one",
        device.path().string(), name, text_of(*now), text_of(*whole));
  } else {
    log_info("{}: {} set back from {} to {}", device.path().string(), name, text_of(*now),
             text_of(then.value_or(*whole)));
  }
}

void reset_number(const V4l2Device& device, const char* name, std::uint32_t id) {
  const auto now = device.control(id);
  const auto range = device.range(id);
  if (!now || !range || *now == range->usual) return;
  if (device.set_control(id, range->usual) && device.control(id) == range->usual) {
    log_info("{}: {} set back from {} to {}", device.path().string(), name, *now, range->usual);
  } else {
    log_warning(
        "{}: its {} of {} can't be set back to {}; the view differs from the calibrated one",
        device.path().string(), name, *now, range->usual);
  }
}

}  // namespace

void reset_view(const V4l2Device& device) {
  reset_selection(device, "crop", V4L2_SEL_TGT_CROP, V4L2_SEL_TGT_CROP_DEFAULT);
  reset_selection(device, "compose", V4L2_SEL_TGT_COMPOSE, V4L2_SEL_TGT_COMPOSE_DEFAULT);
  reset_number(device, "zoom", V4L2_CID_ZOOM_ABSOLUTE);
  reset_number(device, "pan", V4L2_CID_PAN_ABSOLUTE);
  reset_number(device, "tilt", V4L2_CID_TILT_ABSOLUTE);
}

Result<void> fill_frame(const V4l2Device& device, std::uint32_t width, std::uint32_t height) {
  const v4l2_rect frame{0, 0, width, height};
  auto filled = selection(device, V4L2_SEL_TGT_COMPOSE);
  if (!filled || equal(*filled, frame)) return {};
  v4l2_selection wanted{};
  wanted.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  wanted.target = V4L2_SEL_TGT_COMPOSE;
  wanted.r = frame;
  (void)device.call(VIDIOC_S_SELECTION, &wanted);
  filled = selection(device, V4L2_SEL_TGT_COMPOSE);
  if (!filled || equal(*filled, frame)) return {};
  return fail(
      "{}: fills only {} of its frames of {}x{}, as another program set it; reset it (v4l2-ctl -d "
      "{} --set-selection target=compose,left=0,top=0,width={},height={}) or choose another --size",
      device.path().string(), text_of(*filled), width, height, device.path().string(), width,
      height);
}

std::optional<std::string> field_problem(std::uint32_t field) {
  switch (field) {
    case V4L2_FIELD_NONE:
    case V4L2_FIELD_ANY:
      return std::nullopt;
    case V4L2_FIELD_INTERLACED:
    case V4L2_FIELD_INTERLACED_TB:
    case V4L2_FIELD_INTERLACED_BT:
      return "gives interlaced frames, which show two moments in alternate rows";
    case V4L2_FIELD_SEQ_TB:
    case V4L2_FIELD_SEQ_BT:
      return "gives both fields of an interlaced frame one below the other";
    default:
      return "gives single fields of an interlaced frame";
  }
}

std::string no_format_text(const std::filesystem::path& path,
                           const std::vector<V4l2Format>& offered, const std::string& requested) {
  std::string names;
  for (const V4l2Format& format : offered) {
    names += (names.empty() ? "" : ", ") + fourcc_text(format.fourcc);
  }
  if (names.empty()) names = "no format";
  if (!requested.empty()) {
    return fmt::format("{}: gives no {}, but {}; choose another --format", path.string(), requested,
                       names);
  }
  return fmt::format(
      "{0}: gives {1}, and none of NV12, YU12, YUYV, MJPEG and GREY, which can be read; open it "
      "through libcamera, or convert it (ffmpeg -f v4l2 -i {0} -pix_fmt yuyv422 -f v4l2 to a "
      "v4l2loopback device)",
      path.string(), names);
}

std::optional<std::string> input_problem(const V4l2Device& device) {
  int index = 0;
  if (device.call(VIDIOC_G_INPUT, &index) != 0 || index < 0) return std::nullopt;
  v4l2_input input{};
  input.index = static_cast<std::uint32_t>(index);
  if (device.call(VIDIOC_ENUMINPUT, &input) != 0) return std::nullopt;
  constexpr std::array<std::pair<std::uint32_t, const char*>, 3> kProblems = {{
      {V4L2_IN_ST_NO_POWER, "is switched off"},
      {V4L2_IN_ST_NO_SIGNAL, "has no signal"},
      {V4L2_IN_ST_NO_H_LOCK | V4L2_IN_ST_NO_V_LOCK | V4L2_IN_ST_NO_STD_LOCK | V4L2_IN_ST_NO_SYNC,
       "has a signal that the device can't lock on"},
  }};
  for (const auto& [bits, what] : kProblems) {
    if ((input.status & bits) == 0) continue;
    const std::string name(reinterpret_cast<const char*>(input.name),
                           strnlen(reinterpret_cast<const char*>(input.name), sizeof input.name));
    return fmt::format(
        "input {} ({}) {}; connect and switch on its source, or choose another input (v4l2-ctl -d "
        "{} --list-inputs)",
        index, on_one_line(name), what, device.path().string());
  }
  return std::nullopt;
}

std::string changed_control_text(const std::string& name, double steps_per_unit,
                                 const std::string& unit, double asked, std::int32_t got,
                                 const std::optional<V4l2Range>& range) {
  std::string text = fmt::format("{}: the camera gives {:.6g}{} for {:.6g}{}", name,
                                 got / steps_per_unit, unit, asked, unit);
  if (range) {
    text += fmt::format("; it takes {:.6g} to {:.6g}{}", range->minimum / steps_per_unit,
                        range->maximum / steps_per_unit, unit);
  }
  return text;
}

void set_controls(const V4l2Device& device, const CameraControls& requested, bool report) {
  (void)device.set_control(V4L2_CID_FOCUS_AUTO, 0);
  if (requested.focus) set_number(device, kFocus, *requested.focus, report);
  if (requested.auto_exposure) {
    if (!device.set_control(V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_AUTO)) {
      set_switch(device, "automatic exposure", V4L2_CID_EXPOSURE_AUTO,
                 V4L2_EXPOSURE_APERTURE_PRIORITY, report);
    }
  } else if (requested.exposure_ms) {
    (void)device.set_control(V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL);
    set_number(device, kExposure, *requested.exposure_ms, report);
  }
  if (requested.gain) {
    (void)device.set_control(V4L2_CID_AUTOGAIN, 0);
    set_number(device, kGain, *requested.gain, report);
  }
  if (requested.auto_white_balance) {
    set_switch(device, "automatic white balance", V4L2_CID_AUTO_WHITE_BALANCE, 1, report);
  }
  if (requested.white_balance_k) {
    (void)device.set_control(V4L2_CID_AUTO_WHITE_BALANCE, 0);
    set_number(device, kWhiteBalance, *requested.white_balance_k, report);
  }
}

}  // namespace penumbra
