// Names in Python of enumerations that several files bind.
#pragma once

#include <penumbra/camera.hpp>

#include "bindings.hpp"

namespace penumbra::python {

inline constexpr Names<types::DistortionModel, 3> kDistortionModels = {{
    {"plumb_bob", types::DistortionModel::plumb_bob},
    {"rational", types::DistortionModel::rational},
    {"fisheye", types::DistortionModel::fisheye},
}};

inline constexpr Names<types::CameraFileFormat, 3> kCameraFormats = {{
    {"ros", types::CameraFileFormat::ros},
    {"opencv", types::CameraFileFormat::opencv},
    {"kalibr", types::CameraFileFormat::kalibr},
}};

}  // namespace penumbra::python
