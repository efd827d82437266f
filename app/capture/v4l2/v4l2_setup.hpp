// Prepares a V4L2 device for streaming: full field of view, progressive frames, requested controls.
// A driver keeps its settings after a program ends, so settings of other programs are reset here.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/capture/camera_controls.hpp"
#include "app/capture/v4l2/v4l2_device.hpp"

namespace penumbra {

// Sets crop, compose, zoom, pan and tilt to the driver's defaults, because other values invalidate
// the calibration. Logs each change. Call it before VIDIOC_S_FMT.
void reset_view(const V4l2Device& device);

// Makes the driver fill the whole frame of `width` x `height` [px]; fails if it refuses. Call it
// after VIDIOC_S_FMT.
[[nodiscard]] Result<void> fill_frame(const V4l2Device& device, std::uint32_t width,
                                      std::uint32_t height);

// Returns why frames of this field order (enum v4l2_field) can't be tracked; nullopt if they can.
[[nodiscard]] std::optional<std::string> field_problem(std::uint32_t field);

// Error message for a device that offers no usable format. `requested`: format; empty for any.
[[nodiscard]] std::string no_format_text(const std::filesystem::path& path,
                                         const std::vector<V4l2Format>& offered,
                                         const std::string& requested);

// Describes a signal fault at the current input, with the remedy. Returns nullopt if there is none
// or the driver does not report it.
[[nodiscard]] std::optional<std::string> input_problem(const V4l2Device& device);

// Sets the requested controls and switches autofocus off. Reads numbers back. With `report`, logs
// the values that the driver refused or changed.
void set_controls(const V4l2Device& device, const CameraControls& requested, bool report);

}  // namespace penumbra
