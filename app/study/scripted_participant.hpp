// Converts the actions of a script into window events, which are handled like those of a person.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "app/session/session.hpp"
#include "app/study/study_script.hpp"
#include "core/error.hpp"
#include "render/gl/context.hpp"

namespace penumbra {

class ScriptedParticipant {
 public:
  explicit ScriptedParticipant(StudyScript script) : script_(std::move(script)) {}

  // Returns the trial's next action if it is due at this time since the trial was shown, else
  // nullptr. Drops the actions of earlier trials.
  [[nodiscard]] const ScriptAction* take(int trial, std::int64_t since_shown_ns);
  // Returns true if the trial has further actions.
  [[nodiscard]] bool has_more(int trial) const;

  // Returns the window events of an action on the shown image. Fails, with the script's line, if
  // the action's position is outside the image or the scene has no such object.
  [[nodiscard]] Result<std::vector<WindowEvent>> events_of(const ScriptAction& action,
                                                           const SessionView& view,
                                                           GlContext::Size window);
  [[nodiscard]] const std::string& name() const { return script_.name; }

 private:
  [[nodiscard]] Result<Eigen::Vector2d> pixel_of(const ScriptAction& action,
                                                 const SessionView& view) const;

  StudyScript script_;
  std::size_t next_ = 0;
  int button_ = 0;                                       // pressed mouse button
  Eigen::Vector3d grabbed_m_ = Eigen::Vector3d::Zero();  // grabbed point, table frame [m]
  Eigen::Vector2d pointer_ = Eigen::Vector2d::Zero();    // [px] of the window
};

}  // namespace penumbra
