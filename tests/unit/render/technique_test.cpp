#include "render/scene/technique.hpp"

#include <gtest/gtest.h>

namespace penumbra {
namespace {

TEST(TechniqueNames, RoundTrip) {
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    EXPECT_EQ(to_string(technique), name);
    EXPECT_EQ(value_named(kShadowTechniqueNames, name), technique);
  }
  EXPECT_FALSE(value_named(kShadowTechniqueNames, "soft"));
  EXPECT_EQ(name_of(kShadowTechniqueNames, ShadowTechnique{99}), "");
}

TEST(TechniqueTraits, AreConsistent) {
  for (const auto& [technique, name] : kShadowTechniqueNames) {
    const TechniqueTraits traits = traits_of(technique);
    EXPECT_FALSE(traits.uses_lights && traits.has_penumbra) << name;
    if (!traits.uses_kernels) continue;
    EXPECT_TRUE(traits.has_penumbra && traits.ignores_cut_outs) << name;
    EXPECT_FALSE(traits.uses_outlines) << name << ": vertices of outlines have no kernels";
  }
}

}  // namespace
}  // namespace penumbra
