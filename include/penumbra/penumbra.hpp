// The whole library.
#pragma once

#include <penumbra/calibration.hpp>
#include <penumbra/camera.hpp>
#include <penumbra/error.hpp>
#include <penumbra/evaluation.hpp>
#include <penumbra/shadow.hpp>
#include <penumbra/tracking.hpp>
#include <penumbra/types.hpp>
#include <penumbra/version.hpp>
