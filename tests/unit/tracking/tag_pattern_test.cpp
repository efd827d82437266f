#include "tracking/alignment/tag_pattern.hpp"

#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagCircle21h7.h>
#include <apriltag/tagStandard41h12.h>
#include <gtest/gtest.h>

#include <cstdlib>

namespace penumbra {
namespace {

// Compares the cells, in rows from the top, with the drawing of libapriltag.
void expect_same_as_drawing(TagFamily family, apriltag_family_t* handle, int id) {
  const Result<TagPattern> pattern = TagPattern::make(family, id);
  ASSERT_TRUE(pattern.has_value());
  image_u8_t* drawing = apriltag_to_image(handle, id);
  ASSERT_EQ(pattern->total_width(), drawing->width);
  for (int row = 0; row < drawing->height; ++row) {
    for (int column = 0; column < drawing->width; ++column) {
      EXPECT_EQ(pattern->white(column, drawing->height - 1 - row),
                drawing->buf[row * drawing->stride + column] > 127)
          << "cell " << column << ", row " << row;
    }
  }
  std::free(drawing->buf);
  std::free(drawing);
}

TEST(TagPattern, MatchesCellsDrawnByAprilTagLibrary) {
  apriltag_family_t* tag36h11 = tag36h11_create();
  for (const int id : {0, 1, 17, 585, 586})
    expect_same_as_drawing(TagFamily::tag36h11, tag36h11, id);
  tag36h11_destroy(tag36h11);
  apriltag_family_t* tag16h5 = tag16h5_create();
  expect_same_as_drawing(TagFamily::tag16h5, tag16h5, 3);
  tag16h5_destroy(tag16h5);
  apriltag_family_t* standard = tagStandard41h12_create();
  expect_same_as_drawing(TagFamily::tag_standard41h12, standard, 5);
  tagStandard41h12_destroy(standard);
  apriltag_family_t* circle = tagCircle21h7_create();
  expect_same_as_drawing(TagFamily::tag_circle21h7, circle, 2);
  tagCircle21h7_destroy(circle);
}

TEST(TagPattern, HasOneRunForEachColourEdge) {
  const Result<TagPattern> pattern = TagPattern::make(TagFamily::tag36h11, 7);
  ASSERT_TRUE(pattern.has_value());
  const int width = pattern->total_width();
  // Each unit edge of each run separates two colours with the run's polarity. The number of edges
  // must equal that of colour changes between neighbouring cells.
  int edges = 0;
  for (const EdgeRun& run : pattern->runs()) {
    EXPECT_LT(run.begin, run.end);
    for (int along = run.begin; along < run.end; ++along) {
      const bool before = run.vertical ? pattern->white(run.position - 1, along)
                                       : pattern->white(along, run.position - 1);
      const bool after =
          run.vertical ? pattern->white(run.position, along) : pattern->white(along, run.position);
      EXPECT_EQ(static_cast<int>(after) - static_cast<int>(before), run.polarity);
      ++edges;
    }
  }
  int changes = 0;
  for (int j = 0; j < width; ++j) {
    for (int i = 0; i < width; ++i) {
      if (i > 0) changes += pattern->white(i, j) != pattern->white(i - 1, j) ? 1 : 0;
      if (j > 0) changes += pattern->white(i, j) != pattern->white(i, j - 1) ? 1 : 0;
    }
  }
  EXPECT_EQ(edges, changes);
  // The outer side of the black border consists of four runs of 8 cells.
  int border_sides = 0;
  for (const EdgeRun& run : pattern->runs())
    border_sides += (run.position == 1 || run.position == 9) && run.end - run.begin == 8 ? 1 : 0;
  EXPECT_EQ(border_sides, 4);
}

TEST(TagPattern, ReportsPrintedCells) {
  const TagPattern square = TagPattern::make(TagFamily::tag36h11, 7).value();
  const TagPattern round = TagPattern::make(TagFamily::tag_circle21h7, 2).value();
  for (const TagPattern* pattern : {&square, &round}) {
    const int last = pattern->total_width() - 1;
    EXPECT_EQ(pattern->printed(0, 0), pattern == &square);
    EXPECT_EQ(pattern->printed(last, last), pattern == &square);
    EXPECT_TRUE(pattern->printed(last / 2, 0));
    EXPECT_FALSE(pattern->printed(-1, last / 2));
    EXPECT_FALSE(pattern->printed(last / 2, last + 1));
    for (const DataCell& cell : pattern->data_cells())
      EXPECT_TRUE(pattern->printed(cell.i, cell.j));
  }
}

TEST(TagPattern, RejectsIdOutsideFamily) {
  EXPECT_FALSE(TagPattern::make(TagFamily::tag36h11, 587).has_value());
  EXPECT_FALSE(TagPattern::make(TagFamily::tag16h5, -1).has_value());
}

}  // namespace
}  // namespace penumbra
