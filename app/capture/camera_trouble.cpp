#include "app/capture/camera_trouble.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <set>
#include <system_error>

namespace penumbra {

CaptureFault fault_of(int error) {
  switch (std::abs(error)) {
    case ENODEV:
    case ENOENT:
    case ENXIO:
      return CaptureFault::disconnected;
    case EACCES:
    case EPERM:
      return CaptureFault::forbidden;
    case EBUSY:
    case ENOSPC:  // the bus has no bandwidth left
      return CaptureFault::busy;
    case EINVAL:
      return CaptureFault::refused;
    default:
      return CaptureFault::io_error;
  }
}

std::string message_of(int error) {
  return std::generic_category().message(std::abs(error));
}

std::optional<std::string> forbidden_camera_device(const std::filesystem::path& devices) {
  namespace fs = std::filesystem;
  std::error_code error;
  std::set<std::string> forbidden;
  for (const auto& entry : fs::directory_iterator(devices, error)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with("media") && !name.starts_with("video")) continue;
    if (faccessat(AT_FDCWD, entry.path().c_str(), R_OK | W_OK, AT_EACCESS) != 0 &&
        (errno == EACCES || errno == EPERM)) {
      forbidden.insert(entry.path().string());
    }
  }
  if (forbidden.empty()) return std::nullopt;
  return fmt::format(
      "no permission to use {}{}; {}", *forbidden.begin(),
      forbidden.size() > 1 ? fmt::format(" and {} more", forbidden.size() - 1) : std::string(),
      kJoinVideoGroup);
}

void Outage::begin(const StreamError& trouble, const std::optional<std::string>& hud_text) {
  if (fault_ != trouble.fault) faults_.count(trouble.fault, trouble.message);
  faults_.set_trouble(hud_text.value_or(trouble.message));
  fault_ = trouble.fault;
}

bool Outage::end() {
  if (!fault_) return false;
  faults_.set_trouble(std::nullopt);
  fault_.reset();
  return true;
}

}  // namespace penumbra
