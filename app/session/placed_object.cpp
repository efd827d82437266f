#include "app/session/placed_object.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <tuple>
#include <utility>
#include <vector>

#include "app/logging.hpp"
#include "core/propagate.hpp"
#include "core/text/text.hpp"
#include "render/model/model_size.hpp"
#include "render/model/to_eigen.hpp"

namespace penumbra {
namespace {

constexpr double kSheetMargin_m = 0.045;  // white paper around the tags, as on an A4 sheet
constexpr double kSheetGap_m = 0.01;      // between the paper and objects
constexpr double kGap_m = 0.02;           // between objects
constexpr double kSearch_m = 1.5;         // largest distance of a free place from the first choice
constexpr double kStep_m = 0.01;
constexpr double kThinnest_m = 0.001;  // a thinner object is lifted, or its top is in the table
constexpr double kMinScale = 1e-6, kMaxScale = 1e6;  // limits of scene files
constexpr double kFarthest_m = 1000.0;               // limit of scene files
constexpr std::size_t kMaxNameBytes = 60;

struct ChosenSize {
  double scale = 1.0;
  std::string source;
};

bool is_plausible(double longest_m) {
  return longest_m >= kSmallestEdge_m && longest_m <= kLargestEdge_m;
}

Result<ChosenSize> choose_size(const Eigen::Vector3d& extent, const ObjectRequest& request) {
  const double longest = extent.maxCoeff();
  const std::string file = request.file.string();
  const bool grows_later = longest == 0.0 && !request.animation.empty();
  if (grows_later && !request.scale) {
    return fail("{}: has no size at the start of its animation; give scale", file);
  }
  if (!std::isfinite(longest) || !(longest > 0.0 || grows_later)) {
    return fail("{}: has no size, so it can't be put on the table; export it with its faces", file);
  }
  if (request.height_m) {
    // Rounding of the file's coordinates can give a flat model a height.
    if (!(extent.z() > 1e-6 * longest)) {
      return fail("{}: is flat, so height gives it no size; give scale instead", file);
    }
    return ChosenSize{*request.height_m / extent.z(), "as given"};
  }
  if (request.scale || request.unit_m) {
    return ChosenSize{request.scale.value_or(1.0) * request.unit_m.value_or(1.0), "as given"};
  }
  if (is_plausible(longest)) return ChosenSize{1.0, "its own size"};
  constexpr double kMillimetre_m = 0.001;
  // OBJ files have no unit, and those of 3D printing are in millimetres. glTF is in metres.
  if (lower_extension(file) == ".obj" && is_plausible(kMillimetre_m * longest)) {
    return ChosenSize{kMillimetre_m, "taken as millimetres"};
  }
  // Three digits, because a saved scene shows this number.
  const double scale = kFittedEdge_m / longest;
  return ChosenSize{parse_number(fmt::format("{:.3g}", scale)).value_or(scale),
                    "scaled to fit, from " + size_text(longest)};
}

// Returns the boxes of the scene's objects at its start, table frame.
std::vector<Eigen::AlignedBox3d> boxes_of(const Scene& scene) {
  std::vector<Eigen::AlignedBox3d> boxes;
  const SceneState state = evaluate_scene(scene, 0.0);
  for (std::size_t i = 0; i < scene.objects.size(); ++i) {
    const SceneObject& object = scene.objects[i];
    if (!object.model || object.removed) continue;
    const Eigen::AlignedBox3d box(to_eigen(object.model->min_corner),
                                  to_eigen(object.model->max_corner));
    const Placement T = placed_model(*object.model, state.objects[i]);
    Eigen::AlignedBox3d placed;
    for (int corner = 0; corner < 8; ++corner) {
      placed.extend(T * box.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner)));
    }
    boxes.push_back(placed);
  }
  return boxes;
}

// Returns the middle of a free place of this size that is nearest to the middle of the sheet's
// right or left edge; the right one if all is taken.
Eigen::Vector2d free_place(const Eigen::Vector2d& size,
                           const std::vector<Eigen::AlignedBox2d>& taken,
                           const Eigen::AlignedBox2d& sheet) {
  constexpr double kPreferRight_m = 0.03;  // the left place is taken if it is nearer by this
  const auto is_free = [&](const Eigen::Vector2d& middle) {
    const Eigen::AlignedBox2d place(middle - 0.5 * size, middle + 0.5 * size);
    return std::ranges::none_of(
        taken, [&place](const Eigen::AlignedBox2d& other) { return other.intersects(place); });
  };
  const double beside =
      0.5 * (sheet.sizes().x() + size.x()) + kSheetMargin_m + kSheetGap_m;  // from the middle
  const Eigen::Vector2d right = sheet.center() + beside * Eigen::Vector2d::UnitX();
  const Eigen::Vector2d left = sheet.center() - beside * Eigen::Vector2d::UnitX();
  Eigen::Vector2d best = right;
  double best_cost = kSearch_m;
  const int steps = static_cast<int>(kSearch_m / kStep_m);
  for (int row = -steps; row <= steps; ++row) {
    for (int column = -steps; column <= steps; ++column) {
      const Eigen::Vector2d shift(column * kStep_m, row * kStep_m);
      for (const auto& [first, handicap] :
           {std::pair(right, 0.0), std::pair(left, kPreferRight_m)}) {
        const double cost = shift.norm() + handicap;
        if (cost >= best_cost || !is_free(first + shift)) continue;
        best = first + shift;
        best_cost = cost;
      }
    }
  }
  return best;
}

std::string name_of(const std::filesystem::path& file) {
  return std::string(first_characters(file.stem().string(), kMaxNameBytes));
}

// A model that is not animated, or the shape at time 0 with its playback.
struct LoadedModel {
  std::shared_ptr<const Model> model;
  Playback playback;
};
// `animation`: see ObjectRequest.
Result<LoadedModel> load_model_or_animation(const std::filesystem::path& file,
                                            const std::string& animation, UpAxis up) {
  LoadedModel loaded;
  if (animation.empty()) {
    PENUMBRA_TRY(Model model, load_model(file, {.up = up}));
    loaded.model = std::make_shared<const Model>(std::move(model));
  } else {
    PENUMBRA_TRY(loaded.playback.model, AnimatedModel::load(file, animation, {.up = up}));
    loaded.playback.animation = animation;
    PENUMBRA_TRY(loaded.model, loaded.playback.model->at(loaded.playback.time_at(0.0)));
  }
  return loaded;
}

}  // namespace

Eigen::AlignedBox2d sheet_area(const TagMap* tags) {
  Eigen::AlignedBox2d area;
  if (tags != nullptr) {
    for (const MappedTag& tag : tags->tags()) {
      if (tag.group != kTableGroup) continue;
      for (const Eigen::Vector3d& corner : tag.corners()) area.extend(corner.head<2>());
    }
  }
  constexpr double kHalfWidth_m = 0.1485, kHalfHeight_m = 0.105;
  return area.isEmpty() ? Eigen::AlignedBox2d(Eigen::Vector2d(-kHalfWidth_m, -kHalfHeight_m),
                                              Eigen::Vector2d(kHalfWidth_m, kHalfHeight_m))
                        : area;
}

Result<PlaceOnTable> place_on_table(const Model& model, const ObjectRequest& request,
                                    const Scene& scene, const Eigen::AlignedBox2d& sheet) {
  const Eigen::AlignedBox3d box(to_eigen(model.min_corner), to_eigen(model.max_corner));
  PENUMBRA_TRY(const ChosenSize chosen, choose_size(box.sizes(), request));
  const std::string file = request.file.string();
  if (!(chosen.scale >= kMinScale && chosen.scale <= kMaxScale)) {
    return fail(
        "{}: is {} long, which a scale from {:g} to {:g} can't bring to the table's size; "
        "export it in metres",
        file, size_text(box.sizes().maxCoeff()), kMinScale, kMaxScale);
  }
  const Eigen::Vector3d size = chosen.scale * box.sizes();
  const double bottom = request.z_m.value_or(std::max(0.0, kThinnest_m - size.z()));
  Eigen::Vector2d middle(request.x_m.value_or(0.0), request.y_m.value_or(0.0));
  if (!request.x_m || !request.y_m) {
    constexpr double kRounding_m = 1e-6;
    const Eigen::Vector2d margin = Eigen::Vector2d::Constant(kGap_m - kRounding_m);
    const Eigen::Vector2d paper =
        Eigen::Vector2d::Constant(kSheetMargin_m + kSheetGap_m - kRounding_m);
    std::vector<Eigen::AlignedBox2d> taken = {{sheet.min() - paper, sheet.max() + paper}};
    for (const Eigen::AlignedBox3d& other : boxes_of(scene)) {
      if (other.max().z() <= bottom || other.min().z() >= bottom + size.z()) continue;
      taken.emplace_back(other.min().head<2>() - margin, other.max().head<2>() + margin);
    }
    const Eigen::Vector2d free = free_place(size.head<2>(), taken, sheet);
    middle = {request.x_m.value_or(free.x()), request.y_m.value_or(free.y())};
  }
  PlaceOnTable place;
  place.height_m = size.z();
  place.size_source = chosen.source;
  place.placement.scale = chosen.scale;
  const Eigen::Vector3d foot(box.center().x(), box.center().y(), box.min().z());
  const Eigen::Vector3d position =
      Eigen::Vector3d(middle.x(), middle.y(), bottom) - chosen.scale * (model.origin + foot);
  // Rounded to micrometres, because a saved scene shows these numbers.
  constexpr double kPerMetre = 1e6;
  place.placement.position =
      (kPerMetre * position).array().round() / kPerMetre + 0.0;  // turns -0 into 0
  if (!(place.placement.position.cwiseAbs().maxCoeff() <= kFarthest_m)) {
    return fail("{}: lies too far from the origin of its file; move it there and export it again",
                file);
  }
  return place;
}

Result<NewObject> load_object(const ObjectRequest& request, const Scene& scene,
                              const Eigen::AlignedBox2d& sheet) {
  PENUMBRA_TRY(LoadedModel loaded,
               load_model_or_animation(request.file, request.animation, request.up));
  const Model& model = *loaded.model;
  PENUMBRA_TRY(const PlaceOnTable place, place_on_table(model, request, scene, sheet));
  for (const std::string& warning : model.warnings) log_warning("{}", warning);
  if (const auto warning = warning_of_size(
          model, {.scale = place.placement.scale, .remedy = SizeRemedy::scene_scale},
          request.file.string()))
    log_warning("{}", *warning);
  std::error_code ignored;
  NewObject object;
  object.edit.object = free_object_name(scene, name_of(request.file));
  object.edit.model_file =
      std::filesystem::absolute(request.file, ignored).lexically_normal().string();
  object.edit.up = request.up;
  object.edit.placement = place.placement;
  const glm::vec3 middle = 0.5F * (model.min_corner + model.max_corner);
  const Eigen::Vector3d at =
      (1e3 * (placed_model(model, place.placement) * to_eigen(middle))).array().round() / 1e3 + 0.0;
  object.description =
      fmt::format("scale {:.4g} ({}), {:.1f} cm high, at x {:.3f}, y {:.3f} m",
                  place.placement.scale, place.size_source, 1e2 * place.height_m, at.x(), at.y());
  object.edit.model = std::move(loaded.model);
  object.edit.playback = std::move(loaded.playback);
  return object;
}

Result<void> load_added_models(SceneEvents& events, const Scene& scene,
                               const std::filesystem::path& events_file) {
  std::map<std::tuple<std::string, std::string, UpAxis>, LoadedModel> models;
  for (SceneEvent& event : events.edits) {
    auto* added = std::get_if<ObjectAdded>(&event.edit);
    if (added == nullptr) continue;
    const bool is_there =
        std::ranges::find(scene.objects, added->object, &SceneObject::name) != scene.objects.end();
    if (is_there) continue;
    const std::string& animation = added->playback.animation;
    // A relative path names the copy in the recording.
    added->model_file = (events_file.parent_path() / added->model_file).string();
    LoadedModel& known = models[{added->model_file, animation, added->up}];
    if (known.model == nullptr) {
      auto loaded = load_model_or_animation(added->model_file, animation, added->up);
      if (!loaded) {
        return fail(
            "{}: adds an object whose model is missing: {}; name the model with --object, "
            "or leave edits out with --no-edits",
            events_file.string(), loaded.error().message);
      }
      for (const std::string& warning : loaded->model->warnings) log_warning("{}", warning);
      known = std::move(*loaded);
    }
    added->model = known.model;
    added->playback = known.playback;
  }
  return {};
}

}  // namespace penumbra
