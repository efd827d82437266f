#include "app/report/versions.hpp"

#include <fmt/format.h>

#include <Eigen/Core>

extern "C" {
#include <libavcodec/avcodec.h>
#include <libavformat/avformat.h>
}

namespace penumbra {
namespace {

std::string libav_version(unsigned packed) {
  return fmt::format("{}.{}.{}", packed >> 16U, (packed >> 8U) & 0xFFU, packed & 0xFFU);
}

}  // namespace

std::string program_version() {
  return PENUMBRA_VERSION;
}

std::vector<std::pair<std::string, std::string>> component_versions() {
  return {
      {"penumbra", program_version()},
      {"compiler", fmt::format("g++ {}", __VERSION__)},
      {"build_type", PENUMBRA_BUILD_TYPE},
      {"apriltag", PENUMBRA_APRILTAG_VERSION},
      {"ceres", PENUMBRA_CERES_VERSION},
      {"eigen",
       fmt::format("{}.{}.{}", EIGEN_WORLD_VERSION, EIGEN_MAJOR_VERSION, EIGEN_MINOR_VERSION)},
      {"libavcodec", libav_version(avcodec_version())},
      {"libavformat", libav_version(avformat_version())},
  };
}

}  // namespace penumbra
