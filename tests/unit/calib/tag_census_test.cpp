#include "calib/target/tag_census.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "calib/target/tag_board.hpp"

namespace penumbra {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr auto kFamily = TagFamily::tag36h11;

// Adds `images` images that show the tags with these indices, and tags of the target's family that
// are not in the map.
void add(TagCensus& census, int images, const std::vector<std::size_t>& seen,
         const std::vector<int>& others = {}) {
  TagsInView tags;
  tags.seen = seen;
  for (const int id : others) tags.others.emplace_back(kFamily, id);
  for (int i = 0; i < images; ++i) census.add(tags, {});
}

class TagCensusTest : public testing::Test {
 protected:
  TagCensus census_{tag_map_of(TagBoard{}).value()};  // ids 0 to 11
  const std::vector<std::size_t> all_ = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
};

TEST_F(TagCensusTest, FindsNoDifferenceInViewsOfTarget) {
  add(census_, 20, all_);
  add(census_, 5, {0, 1, 2, 3});
  EXPECT_THAT(census_.differences(), IsEmpty());
}

TEST_F(TagCensusTest, NamesTagsBesideTarget) {
  add(census_, 10, all_, {40, 41, 42, 50});
  EXPECT_THAT(census_.differences(),
              ElementsAre(AllOf(HasSubstr("not in the target file (tag36h11 40 to 42, 50)"),
                                HasSubstr("keep other sheets out of the view"))));
}

TEST_F(TagCensusTest, NamesTagsThatNoImageShows) {
  add(census_, 10, {0, 1, 2, 3, 4, 5});
  EXPECT_THAT(census_.differences(),
              ElementsAre(AllOf(HasSubstr("6 of the 12 tags"), HasSubstr("tag36h11 6 to 11"),
                                HasSubstr("show the whole sheet"))));
}

TEST_F(TagCensusTest, RecognisesFileOfAnotherSheet) {
  add(census_, 30, {0, 1, 2}, {20, 21, 22});
  EXPECT_THAT(census_.differences(),
              ElementsAre(HasSubstr("give the file of the sheet that they show"),
                          HasSubstr("it seems to be the file of another sheet")));
}

TEST_F(TagCensusTest, IgnoresChanceDetectionsAndFewImages) {
  add(census_, 100, all_);
  add(census_, 9, all_, {77});
  EXPECT_THAT(census_.differences(), IsEmpty()) << "9 of 109 images";
  TagCensus few(tag_map_of(TagBoard{}).value());
  add(few, 9, {0, 1});
  EXPECT_THAT(few.differences(), IsEmpty()) << "the other tags may be hidden";
  TagCensus once(tag_map_of(TagBoard{}).value());
  add(once, 1, {0}, {77});
  EXPECT_THAT(once.differences(), IsEmpty());
}

}  // namespace
}  // namespace penumbra
