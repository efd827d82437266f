// Models that several tests draw in a Studio, in metres, centred on the origin.
#pragma once

#include <memory>

#include "support/shapes.hpp"
#include "support/studio.hpp"

namespace penumbra::test {

inline std::shared_ptr<const Model> box(double x, double y, double z) {
  ShapeBuilder shape;
  shape.box(-x / 2, -y / 2, -z / 2, x / 2, y / 2, z / 2);
  return finished(shape.build(), glm::vec4(0.8F, 0.3F, 0.1F, 1.0F));
}

// A flat-lying torus with a radius of 60 mm and a tube radius of 20 mm.
inline std::shared_ptr<const Model> ring() {
  ShapeBuilder shape;
  shape.torus(0.06, 0.02, 16, 40);
  return finished(shape.build(), glm::vec4(1.0F));
}

}  // namespace penumbra::test
