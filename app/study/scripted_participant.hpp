// Does what a script says, as events of the window: they take the same way as a person's.
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

  // The next action of the trial that is due by this time since the trial is shown, or nullptr. It
  // is taken from the script, and so is everything of earlier trials.
  [[nodiscard]] const ScriptAction* take(int trial, std::int64_t since_shown_ns);
  // Whether anything is left to be done in the trial.
  [[nodiscard]] bool has_more(int trial) const;

  // Window pixels that the picture on the screen has at the action's place. Fails, naming the line,
  // where that is not in the picture, or the scene has no such object.
  [[nodiscard]] Result<std::vector<WindowEvent>> events_of(const ScriptAction& action,
                                                           const SessionView& view,
                                                           GlContext::Size window);
  [[nodiscard]] const std::string& name() const { return script_.name; }

 private:
  [[nodiscard]] Result<Eigen::Vector2d> pixel_of(const ScriptAction& action,
                                                 const SessionView& view) const;

  StudyScript script_;
  std::size_t next_ = 0;
  int button_ = 0;                                     // that is down
  Eigen::Vector3d taken_ = Eigen::Vector3d::Zero();    // the point that was pressed on, table frame
  Eigen::Vector2d pointer_ = Eigen::Vector2d::Zero();  // [px] of the window
};

}  // namespace penumbra
