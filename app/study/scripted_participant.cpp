#include "app/study/scripted_participant.hpp"

#include <algorithm>

#include "app/study/study_task.hpp"
#include "app/window/manipulation.hpp"
#include "app/window/pointer.hpp"
#include "core/propagate.hpp"

namespace penumbra {

const ScriptAction* ScriptedParticipant::take(int trial, std::int64_t since_shown_ns) {
  const std::vector<ScriptAction>& actions = script_.actions;
  while (next_ < actions.size() && actions[next_].trial < trial) ++next_;
  if (!has_more(trial) || actions[next_].at_ns > since_shown_ns) return nullptr;
  return &actions[next_++];
}

bool ScriptedParticipant::has_more(int trial) const {
  return std::any_of(script_.actions.begin() + static_cast<std::ptrdiff_t>(next_),
                     script_.actions.end(),
                     [trial](const ScriptAction& action) { return action.trial == trial; });
}

Result<Eigen::Vector2d> ScriptedParticipant::pixel_of(const ScriptAction& action,
                                                      const SessionView& view) const {
  Eigen::Vector3d point = action.place.point;
  switch (action.place.kind) {
    case ScriptPlace::Kind::pixel:
      return Eigen::Vector2d(point.x(), point.y());
    case ScriptPlace::Kind::table:
      break;
    case ScriptPlace::Kind::by:
      point += grabbed_m_;
      break;
    case ScriptPlace::Kind::object: {
      const auto object =
          std::ranges::find(view.scene->objects, action.place.object, &SceneObject::name);
      if (object == view.scene->objects.end()) {
        return fail("{}: line {}: this experiment has no {}", script_.name, action.line,
                    action.place.object);
      }
      point = object->placement.position;
      break;
    }
  }
  const auto pixel = view.camera->project(view.T_table_camera->inverse() * point);
  if (!pixel) {
    return fail("{}: line {}: that place is not in front of the camera", script_.name, action.line);
  }
  return *pixel;
}

Result<std::vector<WindowEvent>> ScriptedParticipant::events_of(const ScriptAction& action,
                                                                const SessionView& view,
                                                                GlContext::Size window) {
  constexpr int kSpace = 32;  // GLFW's code
  using Kind = ScriptAction::Kind;
  WindowEvent event;
  if (action.kind == Kind::accept) {
    event.kind = WindowEvent::Kind::key_down;
    event.code = kSpace;
    return std::vector{event};
  }
  if (!view.T_table_camera) {
    return fail("{}: line {}: the table is not seen at that time; choose another", script_.name,
                action.line);
  }
  if (action.kind != Kind::release) {
    PENUMBRA_TRY(const auto pixel, pixel_of(action, view));
    const bool inside = pixel.x() >= 0.0 && pixel.y() >= 0.0 &&
                        pixel.x() <= view.camera->width() - 1 &&
                        pixel.y() <= view.camera->height() - 1;
    if (!inside) {
      return fail("{}: line {}: pixel {:.1f} {:.1f} is outside of the image", script_.name,
                  action.line, pixel.x(), pixel.y());
    }
    pointer_ = window_from_image(*view.camera, window, pixel);
  }
  event.x = pointer_.x();
  event.y = pointer_.y();
  if (action.kind == Kind::move) {
    event.kind = WindowEvent::Kind::pointer_moved;
    return std::vector{event};
  }
  WindowEvent up = event;
  up.kind = WindowEvent::Kind::button_up;
  up.code = button_;
  if (action.kind == Kind::release) return std::vector{up};

  if (const auto pointer = pointer_in_window(view, window, pointer_)) {
    if (const auto picked = pick(*view.scene, pickable_state(*view.scene), pointer->ray)) {
      grabbed_m_ = pointer->ray.origin + picked->distance * pointer->ray.direction;
    }
  }
  button_ = up.code = event.code = action.button;
  event.kind = WindowEvent::Kind::button_down;
  if (action.kind == Kind::press) return std::vector{event};
  return std::vector{event, up};
}

}  // namespace penumbra
