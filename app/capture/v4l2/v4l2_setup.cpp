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

struct NumberControl {
  std::uint32_t id;
  const char* name;
  double steps_per_unit;  // the control's steps in one unit of the option
  const char* unit;       // with a leading space, or empty
};
constexpr NumberControl kFocus{V4L2_CID_FOCUS_ABSOLUTE, "focus", 1.0, ""};
constexpr NumberControl kExposure{V4L2_CID_EXPOSURE_ABSOLUTE, "exposure", 10.0, " ms"};  // 100 us
constexpr NumberControl kGain{V4L2_CID_GAIN, "gain", 1.0, ""};
constexpr NumberControl kWhiteBalance{V4L2_CID_WHITE_BALANCE_TEMPERATURE, "white balance", 1.0,
                                      " K"};

void warn_of_missing(const V4l2Device& device, const char* name) {
  log_warning("{}: the camera has no {} to set; it stays as it is", device.path().string(), name);
}

void set_number(const V4l2Device& device, const NumberControl& control, double requested,
                bool report) {
  constexpr double kMaxValue = std::numeric_limits<std::int32_t>::max();
  const auto steps = static_cast<std::int32_t>(
      std::lround(std::clamp(requested * control.steps_per_unit, -kMaxValue, kMaxValue)));
  const bool done = device.set_control(control.id, steps);
  // If the camera does not report the value, it counts as set.
  const std::int32_t given = done ? device.control(control.id).value_or(steps) : steps;
  if (!report || (done && given == steps)) return;
  std::optional<ControlRange> range;
  if (const auto in_steps = device.range(control.id)) {
    range = {in_steps->minimum / control.steps_per_unit,
             in_steps->maximum / control.steps_per_unit};
  }
  if (done) {
    log_warning("{}: {}", device.path().string(),
                changed_control_text(control.name, control.unit, requested,
                                     given / control.steps_per_unit, range));
  } else if (range) {
    log_warning("{}: {} {:.6g}{} is refused and stays as it is; it takes {:.6g} to {:.6g}{}",
                device.path().string(), control.name, requested, control.unit, range->lowest,
                range->highest, control.unit);
  } else {
    warn_of_missing(device, control.name);
  }
}

void set_switch(const V4l2Device& device, const char* name, std::uint32_t id, std::int32_t value,
                bool report) {
  if (!device.set_control(id, value) && report) warn_of_missing(device, name);
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

void set_selection(const V4l2Device& device, std::uint32_t target, const v4l2_rect& rectangle) {
  v4l2_selection requested{};
  requested.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  requested.target = target;
  requested.r = rectangle;
  (void)device.call(VIDIOC_S_SELECTION, &requested);
}

void report_reset(const V4l2Device& device, const char* name, bool done, const std::string& before,
                  const std::string& after) {
  if (done) {
    log_info("{}: {} set back from {} to {}", device.path().string(), name, before, after);
  } else {
    log_warning(
        "{}: its {} of {} can't be set back to {}; the view differs from the calibrated one",
        device.path().string(), name, before, after);
  }
}

void reset_selection(const V4l2Device& device, const char* name, std::uint32_t target,
                     std::uint32_t default_target) {
  const auto now = selection(device, target);
  const auto preset = selection(device, default_target);
  if (!now || !preset || equal(*now, *preset)) return;
  set_selection(device, target, *preset);
  const auto then = selection(device, target);
  const bool done = !then || !equal(*then, *now);
  report_reset(device, name, done, text_of(*now), text_of(done ? then.value_or(*preset) : *preset));
}

void reset_number(const V4l2Device& device, const char* name, std::uint32_t id) {
  const auto now = device.control(id);
  const auto range = device.range(id);
  if (!now || !range || *now == range->default_value) return;
  const bool done =
      device.set_control(id, range->default_value) && device.control(id) == range->default_value;
  report_reset(device, name, done, std::to_string(*now), std::to_string(range->default_value));
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
  set_selection(device, V4L2_SEL_TGT_COMPOSE, frame);
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
    return fmt::format(
        "input {} ({}) {}; connect and switch on its source, or choose another input (v4l2-ctl -d "
        "{} --list-inputs)",
        index, v4l2_text(input.name), what, device.path().string());
  }
  return std::nullopt;
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
