#include "render/scene/layered_constants.hpp"

namespace penumbra {
namespace {

// Shaders use these values and their inverses as floats.
bool fits_float(double value) {
  return value >= 1e-30 && value <= 1e30;
}

}  // namespace

Result<LayeredConstants> make_layered_constants(double light_height, double light_ratio,
                                                double umbra_height) {
  if (std::isnan(light_height) || light_height <= 0.0) {
    return fail("light height H: is {}; give metres above 0, or inf with an umbra height",
                light_height);
  }
  if (!std::isinf(light_height) && !fits_float(light_height)) {
    return fail("light height H: is {}; give metres from 1e-30 to 1e30", light_height);
  }
  if (std::isnan(light_ratio) || light_ratio < 0.0) {
    return fail("light ratio a: is {}; give a number above 0 (2 to 5 is usual)", light_ratio);
  }
  if (!std::isfinite(umbra_height) || umbra_height < 0.0) {
    return fail("umbra height h_u: is {}; give metres above 0", umbra_height);
  }
  if (umbra_height > 0.0 && !fits_float(umbra_height)) {
    return fail("umbra height h_u: is {}; give metres from 1e-30 to 1e30", umbra_height);
  }
  if (light_ratio > 0.0 && !std::isinf(light_ratio) && !fits_float(light_ratio)) {
    return fail("light ratio a: is {}; give a number from 1e-30 to 1e30", light_ratio);
  }
  LayeredConstants constants;
  constants.light_height = light_height;
  if (std::isinf(light_height)) {
    // The zenith limit: the light's radius grows with its height such that h_u = H / a is constant.
    if (umbra_height <= 0.0) {
      return fail("umbra height h_u: is missing; a light at infinity needs it");
    }
    if (light_ratio > 0.0 && !std::isinf(light_ratio)) {
      return fail("light ratio a: is {} with H = inf; leave it out and give the umbra height",
                  light_ratio);
    }
    constants.light_ratio = std::numeric_limits<double>::infinity();
    constants.umbra_height = umbra_height;
    return constants;
  }
  if (std::isinf(light_ratio)) {
    return fail("light ratio a: is {}; give a number above 0 (2 to 5 is usual)", light_ratio);
  }
  if (light_ratio <= 0.0 && umbra_height <= 0.0) {
    return fail("light ratio a: is missing, and so is the umbra height h_u; give one of the two");
  }
  constants.light_ratio = light_ratio > 0.0 ? light_ratio : light_height / umbra_height;
  constants.umbra_height = light_height / constants.light_ratio;
  if (!fits_float(constants.light_ratio) || !fits_float(constants.umbra_height)) {
    return light_ratio > 0.0 ? fail("light ratio a: is {}, too far from the light height {}",
                                    light_ratio, light_height)
                             : fail("umbra height h_u: is {}, too far from the light height {}",
                                    umbra_height, light_height);
  }
  if (umbra_height > 0.0 &&
      std::abs(umbra_height - constants.umbra_height) > 1e-6 * constants.umbra_height) {
    return fail("umbra height h_u: is {} but H / a is {}; give either a or h_u", umbra_height,
                constants.umbra_height);
  }
  return constants;
}

Result<LayeredConstants> layered_constants_for_workspace(double max_height, double magnification) {
  if (!std::isfinite(max_height) || max_height <= 0.0) {
    return fail("workspace height: is {}; give metres above 0", max_height);
  }
  if (!std::isfinite(magnification) || magnification <= 1.0) {
    return fail("magnification: is {}; give a number above 1", magnification);
  }
  const double ratio = magnification / (magnification - 1.0);
  return make_layered_constants(ratio * max_height, ratio, 0.0);
}

}  // namespace penumbra
