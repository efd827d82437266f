#include "app/capture/camera_search.hpp"

namespace penumbra {

void CameraSearch::begin() {
  first_search_ = true;
  excluded_buses_.clear();
}

std::optional<std::size_t> CameraSearch::find(std::span<const V4l2Identity> connected) {
  const bool first_search = std::exchange(first_search_, false);
  std::optional<std::size_t> moved;
  std::set<std::string> addresses;  // bus addresses; one camera may have several devices
  for (std::size_t i = 0; i < connected.size(); ++i) {
    const V4l2Identity& camera = connected[i];
    if (is_at_known_address(camera)) return i;
    if (!is_of_model(camera)) continue;
    if (first_search) excluded_buses_.insert(camera.bus);
    if (excluded_buses_.contains(camera.bus)) continue;
    if (addresses.insert(camera.bus).second) moved = i;
  }
  if (addresses.size() != 1) return std::nullopt;
  lost_ = connected[*moved];
  return moved;
}

}  // namespace penumbra
