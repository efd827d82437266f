// Selects tags that are consistent with the map; rejects tags that moved since it was made.
#pragma once

#include <span>
#include <vector>

#include "tracking/detection/board_pose.hpp"
#include "tracking/rigid_tags.hpp"

namespace penumbra {

class TagConsensus {
 public:
  // Returns the rejected tags as indices into RigidTags::tags.
  [[nodiscard]] const std::vector<int>& rejected() const { return rejected_; }
  // Starts with the tags that a detection rejected.
  void begin(std::vector<int> rejected);

  // Rejects tags that are inconsistent with the others and aligns again. Returns false if it can't
  // decide which tags moved. `detected`: detected tags, if the alignment started from their
  // corners.
  [[nodiscard]] bool settle(const RigidTags& group, std::span<const TagObservation> detected,
                            Alignment& alignment);
  // Retest whether rejected tags agree with the others: in every call, or once in many calls.
  void retest_rejected(Alignment& alignment);
  void retest_rejected_seldom(Alignment& alignment);

  // Some frames after a search with inconsistent tags are strict: most tags in the image must fit.
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
  int frames_rejected_ = 0;  // frames since a tag was rejected or retested
  int frames_untested_ = 0;  // frames with disagreement in which tags were not tested one by one
  int strict_frames_ = 0;    // number of strict frames that remain
};

}  // namespace penumbra
