// The scenes of a study: three spheres, or a ball and its target, over the table.
#pragma once

#include "app/study/study_plan.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

inline constexpr const char* kStudyBall = "ball";
inline constexpr const char* kStudyTarget = "target";
[[nodiscard]] std::string study_sphere(int index);  // "sphere 1" is index 0's

// One shadow node, "shadows", that every technique has what it needs of: the table, two walls at
// the far edges of the working volume as the default scene has them, and a lamp straight above the
// middle. The layers' constants are those of a workspace up to the highest place of a sphere.
[[nodiscard]] Scene study_scene(StudyExperiment experiment);

}  // namespace penumbra
