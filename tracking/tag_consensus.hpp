// Which tags fit the map: rejects tags that moved since the map was made, and notices frames in
// which nothing says which tags are right.
#pragma once

#include <span>
#include <vector>

#include "tracking/detection/board_pose.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

class TagConsensus {
 public:
  // Tags that do not count, as places in RigidTags::tags.
  [[nodiscard]] const std::vector<int>& rejected() const { return rejected_; }
  // Takes over what a detection rejected.
  void begin(std::vector<int> rejected);

  // Rejects tags that contradict the others and aligns again. False where nothing says which are
  // right: too many would have to go, or the tags lie elsewhere with no single one to blame.
  // `detected`: what a detection saw in this frame, where the alignment began with that.
  [[nodiscard]] bool settle(const RigidTags& group, std::span<const TagObservation> detected,
                            Alignment& alignment);
  // Asks, now or now and then, whether rejected tags agree with the others: one may have been put
  // back, and corners alone may have blamed the wrong one.
  void look_again(Alignment& alignment);
  void look_again_seldom(Alignment& alignment);

  // After a search whose tags contradicted each other the next searches want more than a pose.
  void doubt();
  void doubt_less();
  void trust() { doubtful_frames_ = 0; }

 private:
  [[nodiscard]] bool may_reject(const AlignmentResult& result) const;
  [[nodiscard]] bool is_doubtful(std::span<const TagObservation> detected,
                                 const Alignment& alignment) const;
  void reject_one(const RigidTags& group, std::span<const TagObservation> detected,
                  Alignment& alignment);

  std::vector<int> rejected_;
  int frames_rejected_ = 0;  // frames since a tag was rejected or asked again
  int frames_unasked_ = 0;   // frames in which all tags disagreed and were not tried one by one
  int doubtful_frames_ = 0;
};

}  // namespace penumbra
