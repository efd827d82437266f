// Compares the tags in images with those of the target file.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "calib/target/target_detector.hpp"
#include "core/geometry/tag_map.hpp"
#include "core/image/image_view.hpp"
#include "tracking/detection/tag_detector.hpp"

namespace penumbra {

class TagCensus {
 public:
  explicit TagCensus(TagMap tags) : tags_(std::move(tags)), seen_(tags_.tags().size(), 0) {}

  // Adds what was detected in an image. In the first images without any tag, it also searches for
  // tags of other families.
  void add(const TagsInView& tags, ImageView luma);

  // Returns a line for each difference that is not by chance: tags that are not in the target file,
  // and tags of the target file that no image shows.
  [[nodiscard]] std::vector<std::string> differences() const;

 private:
  void search_other_families(ImageView luma);

  TagMap tags_;
  int images_with_tags_ = 0;  // of the target or others
  int images_with_target_ = 0;
  std::vector<int> seen_;  // images that show each tag of the map
  std::map<std::pair<TagFamily, int>, int> others_;
  std::optional<TagDetector> other_families_;  // made on demand
  int searches_ = 0;
};

}  // namespace penumbra
