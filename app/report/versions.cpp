#include "app/report/versions.hpp"

#include <fmt/format.h>

#include <Eigen/Core>

extern "C" {
#include <libavcodec/version.h>
#include <libavformat/version.h>
}

namespace penumbra {

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
      {"libavcodec", AV_STRINGIFY(LIBAVCODEC_VERSION)},
      {"libavformat", AV_STRINGIFY(LIBAVFORMAT_VERSION)},
  };
}

}  // namespace penumbra
