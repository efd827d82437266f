// Headers that are compiled once for core, tracking and calib, and with more for the other modules
// and the tests (see options.cmake). Nothing includes this file by name.
#pragma once

#include <fmt/format.h>
#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <tl/expected.hpp>
#include <vector>

#include "core/camera/camera_model.hpp"
#include "core/error.hpp"
#include "core/geometry/group_pose.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/geometry/transform.hpp"
#include "core/image/frame.hpp"
