// Prepares a V4L2 device for streaming: the whole view, progressive frames, controls as requested.
// Settings outlive the program that made them, so what another program left behind is undone here.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/capture/camera_controls.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

// Sets crop, compose, zoom, pan and tilt to the driver's defaults: any other view is another camera
// model. Logs each one that it changed. Call it before VIDIOC_S_FMT.
void reset_view(const V4l2Device& device);

// Fails where the driver fills only a part of a frame of `width` x `height` [px] and will not fill
// all of it. Call it after VIDIOC_S_FMT.
[[nodiscard]] Result<void> fill_frame(const V4l2Device& device, std::uint32_t width,
                                      std::uint32_t height);

// Reason why frames of this field order (enum v4l2_field) can't be tracked; nothing for progressive
// ones.
[[nodiscard]] std::optional<std::string> field_problem(std::uint32_t field);

// Message for a device that has no format which can be read. `requested`: the format that was asked
// for; empty for any.
[[nodiscard]] std::string no_format_text(const std::filesystem::path& path,
                                         const std::vector<V4l2Format>& offered,
                                         const std::string& requested);

// Describes a fault of the signal at the device's current input, with the remedy. Returns nothing
// where there is a signal or the driver does not report one.
[[nodiscard]] std::optional<std::string> input_problem(const V4l2Device& device);

// Sets the requested controls and switches autofocus off. Every value is read back: `report` logs
// what the driver refused or changed.
void set_controls(const V4l2Device& device, const CameraControls& requested, bool report);

// "gives 204.7 ms for 500 ms; it takes 0.3 to 204.7 ms": of a control that was set to `asked` steps
// and reads back as `got`. `range`: what the driver takes, where it says so.
[[nodiscard]] std::string changed_control_text(const std::string& name, double steps_per_unit,
                                               const std::string& unit, double asked,
                                               std::int32_t got,
                                               const std::optional<V4l2Range>& range);

}  // namespace penumbra
