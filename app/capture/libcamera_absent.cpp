// Replaces libcamera_source.cpp if libcamera is not installed.
#include "app/capture/libcamera_source.hpp"

namespace penumbra {
namespace {

tl::unexpected<Error> not_built_in() {
  return fail(
      "libcamera: is not built into this penumbra; install libcamera-dev and build it again, or "
      "name a V4L2 device (v4l2:/dev/video0)");
}

}  // namespace

Result<std::unique_ptr<LiveSource>> open_libcamera_source(const LibcameraOptions&) {
  return not_built_in();
}

Result<std::vector<LibcameraCamera>> list_libcamera_cameras() {
  return not_built_in();
}

}  // namespace penumbra
