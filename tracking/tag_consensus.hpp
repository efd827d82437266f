// Selects the tags that fit the map; rejects tags that moved since the map was made.
#pragma once

#include <span>
#include <vector>

#include "tracking/detection/board_pose.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

class TagConsensus {
 public:
  // Rejected tags, as indices into RigidTags::tags.
  [[nodiscard]] const std::vector<int>& rejected() const { return rejected_; }
  // Begins with the tags that a detection rejected.
  void begin(std::vector<int> rejected);

  // Rejects tags that are inconsistent with the others and aligns again. False if the right tags
  // are unknown. `detected`: tags detected in this frame, if the alignment began with them.
  [[nodiscard]] bool settle(const RigidTags& group, std::span<const TagObservation> detected,
                            Alignment& alignment);
  // Tests, at once or seldom, if rejected tags agree with the others again.
  void look_again(Alignment& alignment);
  void look_again_seldom(Alignment& alignment);

  // After a search with inconsistent tags some frames are strict: the tags that fit must be most of
  // those in the image.
  void begin_strict_frames();
  void count_strict_frame();
  void end_strict_frames() { strict_frames_ = 0; }

 private:
  [[nodiscard]] bool may_reject(const AlignmentResult& result) const;
  [[nodiscard]] bool lacks_majority(std::span<const TagObservation> detected,
                                    const Alignment& alignment) const;
  void reject_one(const RigidTags& group, std::span<const TagObservation> detected,
                  Alignment& alignment);

  std::vector<int> rejected_;
  int frames_rejected_ = 0;  // frames since a tag was rejected or asked again
  int frames_unasked_ = 0;   // frames in which all tags disagreed and were not tried one by one
  int strict_frames_ = 0;    // still to come
};

}  // namespace penumbra
