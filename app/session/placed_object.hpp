// Puts models on the table beside the sheet of tags: for --object, and for files dropped on the
// window.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <optional>
#include <string>

#include "app/session/scene_edit.hpp"
#include "core/error.hpp"
#include "core/geometry/tag_map.hpp"
#include "render/scene/scene.hpp"

namespace penumbra {

// The longest edge [m] of an object that keeps its own size: from half a tag to what a table has
// room for beside a sheet of paper. Another size is scaled to kFittedEdge_m.
inline constexpr double kSmallestEdge_m = 0.02;
inline constexpr double kLargestEdge_m = 0.40;
inline constexpr double kFittedEdge_m = 0.15;

// A model and what the user chose about it; the rest is chosen by place_on_table().
struct ObjectRequest {
  std::filesystem::path file;
  std::optional<double> height_m;  // excludes scale and unit_m
  std::optional<double> scale;     // of the model in its unit
  std::optional<double> unit_m;    // unit of the model's coordinates
  std::optional<double> x_m, y_m;  // middle of the object on the table
  std::optional<double> z_m;       // height of its lowest point above the table
  UpAxis up = UpAxis::by_format;
  // The animation to play (ModelPose::animation); empty: the rest pose. Size and place are those of
  // the shape at its time 0.
  std::string animation;
};

// Returns the rectangle of the table's tags. Without tags: an A4 sheet about the origin.
[[nodiscard]] Eigen::AlignedBox2d sheet_area(const TagMap* tags);

struct PlaceOnTable {
  Placement placement;
  double height_m = 0.0;
  std::string size_source;  // "its own size", "scaled from 1.8 m", ...
};
// Chooses a size and a place beside the sheet, where the object touches no other one. Fails if the
// model has no size.
[[nodiscard]] Result<PlaceOnTable> place_on_table(const Model& model, const ObjectRequest& request,
                                                  const Scene& scene,
                                                  const Eigen::AlignedBox2d& sheet);

struct NewObject {
  ObjectAdded edit;
  std::string description;  // for the user: scale and why, height, place
};
// Loads a model and places it in the scene.
[[nodiscard]] Result<NewObject> load_object(const ObjectRequest& request, const Scene& scene,
                                            const Eigen::AlignedBox2d& sheet);

// Loads the models of recorded objects that the scene lacks.
[[nodiscard]] Result<void> load_added_models(SceneEvents& events, const Scene& scene,
                                             const std::filesystem::path& events_file);

}  // namespace penumbra
