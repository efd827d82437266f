// penumbra devices: lists cameras with their formats, or the reason why a camera can't be used.

#include <fmt/ranges.h>

#include <algorithm>

#include "app/capture/camera_trouble.hpp"
#include "app/capture/libcamera_source.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"
#include "app/capture/v4l2/v4l2_setup.hpp"
#include "app/capture/v4l2/v4l2_source.hpp"
#include "app/commands/options.hpp"

namespace penumbra {
namespace {

std::string text_of(const V4l2Size& size) {
  std::string text = fmt::format("{}x{}", size.width, size.height);
  if (size.max_width != size.width || size.max_height != size.height) {
    text += fmt::format(" to {}x{}", size.max_width, size.max_height);
  }
  if (size.rates.empty()) return text;
  if (size.any_rate) {
    return text + fmt::format(" at {:.4g} to {:.4g}/s", size.rates.back(), size.rates.front());
  }
  return text + fmt::format(" at {:.4g}/s", fmt::join(size.rates, "/s, "));
}

// Removes the advice to run `penumbra devices` from a message.
std::string without_advice(std::string message) {
  for (const std::string_view advice : {"; plug it in, or see what there is: penumbra devices",
                                        "; see what there is: penumbra devices"}) {
    if (message.ends_with(advice)) message = message.substr(0, message.size() - advice.size());
  }
  return message;
}

Result<ExitCode> list_devices() {
  const auto paths = list_v4l2_paths();
  if (paths.empty()) {
    fmt::print(
        "no V4L2 camera: there is no /dev/video*; plug one in (in a container or a virtual "
        "machine: pass it on)\n");
  }
  for (const auto& path : paths) {
    const auto device = V4l2Device::open(path);
    if (!device) {
      fmt::print("v4l2:{}  can't be used\n  {}\n", path.string(),
                 without_advice(device.error().message));
      continue;
    }
    const V4l2Identity& about = device->identity();
    fmt::print("v4l2:{}  {} ({}, {})\n", path.string(), about.card, about.driver, about.bus);
    if (device->busy())
      fmt::print("  busy: another program uses it (fuser -v {} names it)\n", path.string());
    if (const auto problem = input_problem(*device)) fmt::print("  {}\n", *problem);
    const auto formats = device->formats();
    if (std::ranges::none_of(formats, reads_v4l2_format, &V4l2Format::fourcc)) {
      fmt::print("  can't be used: it gives no NV12, YU12, YUYV, MJPEG or GREY frames\n");
    }
    for (const V4l2Format& format : formats) {
      const bool read = reads_v4l2_format(format.fourcc);
      fmt::print("  {:<5} {}{}\n", fourcc_text(format.fourcc), format.description,
                 read ? "" : " (not read by penumbra)");
      for (const V4l2Size& size : format.sizes) fmt::print("        {}\n", text_of(size));
    }
  }
  const auto cameras = list_libcamera_cameras();
  if (!cameras) {
    fmt::print("{}\n", cameras.error().message);
    return ExitCode::success;
  }
  if (cameras->empty()) {
    const auto forbidden = forbidden_camera_device();
    fmt::print("no camera known to libcamera{}\n", forbidden ? ": " + *forbidden : "");
  }
  for (std::size_t i = 0; i < cameras->size(); ++i) {
    const LibcameraCamera& about = (*cameras)[i];
    fmt::print("libcamera:{}  {} ({})\n", i, about.model.empty() ? "camera" : about.model,
               about.id);
    if (!about.problem.empty()) fmt::print("  can't be used: {}\n", about.problem);
    for (const LibcameraFormat& format : about.formats) {
      fmt::print("  {:<5} {}\n", format.name, format.usable ? "" : "(not read by penumbra)");
      for (const std::string& size : format.sizes) fmt::print("        {}\n", size);
    }
  }
  return ExitCode::success;
}

}  // namespace

void add_devices_command(CLI::App& program, ChosenCommand& chosen) {
  add_command(program, "devices",
              "List cameras, their formats, sizes and rates, and why one can't be used",
              "Example:\n  penumbra devices")
      .callback([&chosen] { chosen = list_devices; });
}

}  // namespace penumbra
