// Reasons why a camera delivers no frames, and their messages. Common to V4L2 and libcamera.
#pragma once

#include <fmt/format.h>

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <tl/expected.hpp>
#include <utility>

#include "app/capture/capture_stats.hpp"

namespace penumbra {

// Reason why a stream could not be started.
struct StreamError {
  CaptureFault fault;
  std::string message;
};
template <class T>
using StreamResult = tl::expected<T, StreamError>;

template <class... Args>
[[nodiscard]] tl::unexpected<StreamError> fail_with(CaptureFault fault,
                                                    fmt::format_string<Args...> text,
                                                    Args&&... args) {
  return tl::unexpected<StreamError>({fault, fmt::format(text, std::forward<Args>(args)...)});
}

// `error`: an errno or a negated errno.
[[nodiscard]] CaptureFault fault_of(int error);
[[nodiscard]] std::string message_of(int error);

inline constexpr std::string_view kJoinVideoGroup =
    "join the video group (sudo usermod -aG video $USER) and log in again";
inline constexpr std::string_view kFreeBandwidth =
    "its USB bus has no bandwidth left beside the other cameras on it; use --format mjpeg, a "
    "smaller --size or --fps, or a port of another USB controller";
inline constexpr std::string_view kStreamIsRestarted =
    "the stream is restarted; if this recurs, try another USB port or cable, and see the kernel's "
    "log (dmesg)";
inline constexpr std::string_view kDisconnected =
    "the camera was disconnected; the session continues when it is connected again";
// Returns a message if the user lacks the permission to open a camera's device (media*, video*) in
// `devices`, else nullopt. libcamera reports such a device as absent.
[[nodiscard]] std::optional<std::string> forbidden_camera_device(
    const std::filesystem::path& devices = "/dev");

// A period without frames. Counts a fault only if its kind differs from the last. Not thread-safe.
class Outage {
 public:
  explicit Outage(FaultCounter& faults) : faults_(faults) {}
  // Starts or continues an outage. `hud_text`: shorter text for the HUD; default: the message.
  void begin(const StreamError& trouble, const std::optional<std::string>& hud_text = std::nullopt);
  // Call this when a frame arrives. Returns true if it ended an outage.
  bool end();

 private:
  FaultCounter& faults_;
  std::optional<CaptureFault> fault_;
};

}  // namespace penumbra
