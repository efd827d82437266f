#include "app/capture/camera_trouble.hpp"

#include <cerrno>
#include <cstdlib>
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

void Outage::begin(const Trouble& trouble, const std::optional<std::string>& now) {
  if (fault_ != trouble.fault) faults_.count(trouble.fault, trouble.message);
  faults_.set_trouble(now.value_or(trouble.message));
  fault_ = trouble.fault;
}

bool Outage::end() {
  if (!fault_) return false;
  faults_.set_trouble(std::nullopt);
  fault_.reset();
  return true;
}

}  // namespace penumbra
