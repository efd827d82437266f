#include "tracking/tracking_mode.hpp"

#include <array>

namespace penumbra {
namespace {

struct ModeName {
  std::string_view name;
  TrackingMode mode;
};
constexpr std::array<ModeName, 4> kModes = {{{"detect", TrackingMode::detect},
                                             {"fast", TrackingMode::fast},
                                             {"accurate", TrackingMode::accurate},
                                             {"auto", TrackingMode::automatic}}};

}  // namespace

std::string_view to_string(TrackingMode mode) {
  for (const ModeName& entry : kModes) {
    if (entry.mode == mode) return entry.name;
  }
  return "auto";
}

std::optional<TrackingMode> tracking_mode_from_string(std::string_view name) {
  for (const ModeName& entry : kModes) {
    if (entry.name == name) return entry.mode;
  }
  return std::nullopt;
}

}  // namespace penumbra
