#include "calib/target/tag_census.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <set>

namespace penumbra {
namespace {

constexpr int kMaxSearches = 5;    // images in which tags of other families are searched
constexpr int kMinOtherTags = 3;   // in one image; fewer may be random squares
constexpr int kMinImages = 2;      // that show a tag which is not in the file
constexpr double kMinShare = 0.1;  // of the images with tags that show it
constexpr int kManyImages = 10;    // from here on a tag that no image shows is not hidden by chance

// Returns "tag36h11 0 to 3, 7; tag25h9 1".
std::string names_of(const std::set<std::pair<TagFamily, int>>& tags) {
  std::string text;
  for (auto tag = tags.begin(); tag != tags.end();) {
    auto last = tag;
    while (std::next(last) != tags.end() && std::next(last)->first == tag->first &&
           std::next(last)->second == last->second + 1) {
      ++last;
    }
    const bool same_family = tag != tags.begin() && std::prev(tag)->first == tag->first;
    text +=
        same_family ? ", " : fmt::format("{}{} ", text.empty() ? "" : "; ", to_string(tag->first));
    text += last == tag ? fmt::format("{}", tag->second)
                        : fmt::format("{} to {}", tag->second, last->second);
    tag = std::next(last);
  }
  return text;
}

}  // namespace

void TagCensus::add(const TagsInView& tags, ImageView luma) {
  for (const std::size_t index : tags.seen) ++seen_[index];
  for (const auto& other : std::set(tags.others.begin(), tags.others.end())) ++others_[other];
  if (!tags.seen.empty()) ++images_with_target_;
  if (!tags.seen.empty() || !tags.others.empty()) {
    ++images_with_tags_;
  } else if (images_with_tags_ == 0 && searches_ < kMaxSearches) {
    search_other_families(luma);
  }
}

void TagCensus::search_other_families(ImageView luma) {
  ++searches_;
  if (!other_families_) {
    std::vector<TagFamily> families = distinct_tag_families();
    for (const TagFamily own : tags_.families()) std::erase(families, own);
    TagDetectorOptions options;
    options.max_corrected_bits = 0;  // more would take 100 MB for some families
    auto detector = TagDetector::create(families, options);
    if (!detector) return;
    other_families_.emplace(std::move(*detector));
  }
  std::map<TagFamily, std::set<int>> found;
  for (const TagDetection& tag : other_families_->detect(luma)) found[tag.family].insert(tag.id);
  const auto most =
      std::ranges::max_element(found, {}, [](const auto& family) { return family.second.size(); });
  if (most == found.end() || static_cast<int>(most->second.size()) < kMinOtherTags) return;
  for (const int id : most->second) ++others_[{most->first, id}];
}

std::vector<std::string> TagCensus::differences() const {
  std::vector<std::string> lines;
  const int needed =
      std::max(kMinImages, static_cast<int>(kMinShare * static_cast<double>(images_with_tags_)));
  std::set<std::pair<TagFamily, int>> others;
  for (const auto& [tag, images] : others_) {
    if (images >= needed) others.insert(tag);
  }
  std::set<std::pair<TagFamily, int>> missing;
  if (images_with_target_ >= kManyImages) {
    for (std::size_t i = 0; i < seen_.size(); ++i) {
      if (seen_[i] == 0) missing.emplace(tags_.tags()[i].family, tags_.tags()[i].id);
    }
  }
  if (!others.empty()) {
    lines.push_back(fmt::format(
        "the images show tags that are not in the target file ({}): {}", names_of(others),
        images_with_target_ == 0 || !missing.empty()
            ? "give the file of the sheet that they show"
            : "keep other sheets out of the view, or give the file of the whole sheet"));
  }
  if (!missing.empty()) {
    lines.push_back(fmt::format("no image shows {} of the {} tags in the target file ({}): {}",
                                missing.size(), seen_.size(), names_of(missing),
                                others.empty()
                                    ? "show the whole sheet, or give the file of this sheet"
                                    : "it seems to be the file of another sheet"));
  }
  return lines;
}

}  // namespace penumbra
