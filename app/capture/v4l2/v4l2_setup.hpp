// Prepares a V4L2 device for streaming: the whole view, progressive frames, controls as requested.
// Settings outlive the program that made them, so those of other programs are reset here.
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
// model. Logs each change. Call it before VIDIOC_S_FMT.
void reset_view(const V4l2Device& device);

// Makes the driver fill whole frames of `width` x `height` [px]; fails if it refuses. Call it after
// VIDIOC_S_FMT.
[[nodiscard]] Result<void> fill_frame(const V4l2Device& device, std::uint32_t width,
                                      std::uint32_t height);

// Why frames of this field order (enum v4l2_field) can't be tracked; empty for progressive ones.
[[nodiscard]] std::optional<std::string> field_problem(std::uint32_t field);

// Message for a device without a readable format. `requested`: empty for any.
[[nodiscard]] std::string no_format_text(const std::filesystem::path& path,
                                         const std::vector<V4l2Format>& offered,
                                         const std::string& requested);

// A fault of the signal at the current input, with the remedy; empty if there is none or the driver
// does not report it.
[[nodiscard]] std::optional<std::string> input_problem(const V4l2Device& device);

// Sets the requested controls and switches autofocus off. Reads every value back; `report` logs
// what the driver refused or changed.
void set_controls(const V4l2Device& device, const CameraControls& requested, bool report);

}  // namespace penumbra
