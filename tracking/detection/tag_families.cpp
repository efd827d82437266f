#include "tracking/detection/tag_families.hpp"

#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h10.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagCircle21h7.h>
#include <apriltag/tagCircle49h12.h>
#include <apriltag/tagCustom48h12.h>
#include <apriltag/tagStandard41h12.h>
#include <apriltag/tagStandard52h13.h>

#include <algorithm>
#include <array>
#include <cstdlib>

#include "core/assert.hpp"

namespace penumbra {
namespace {

struct LibraryFamily {
  TagFamily family;
  apriltag_family_t* (*create)();
  void (*destroy)(apriltag_family_t*);
};
constexpr std::array<LibraryFamily, 9> kLibraryFamilies = {{
    {TagFamily::tag36h11, tag36h11_create, tag36h11_destroy},
    {TagFamily::tag36h10, tag36h10_create, tag36h10_destroy},
    {TagFamily::tag25h9, tag25h9_create, tag25h9_destroy},
    {TagFamily::tag16h5, tag16h5_create, tag16h5_destroy},
    {TagFamily::tag_circle21h7, tagCircle21h7_create, tagCircle21h7_destroy},
    {TagFamily::tag_circle49h12, tagCircle49h12_create, tagCircle49h12_destroy},
    {TagFamily::tag_standard41h12, tagStandard41h12_create, tagStandard41h12_destroy},
    {TagFamily::tag_standard52h13, tagStandard52h13_create, tagStandard52h13_destroy},
    {TagFamily::tag_custom48h12, tagCustom48h12_create, tagCustom48h12_destroy},
}};

// Replaces the codes of a libapriltag family with the same cells by the dictionary's codes.
// libapriltag orders bits so that rotating the tag rotates the code. The library's own codes are
// constants and must not be freed; the new codes are allocated.
template <void (*destroy)(apriltag_family_t*)>
TagFamilyHandle with_aruco_codes(apriltag_family_t* family, const ArucoDictionary& dictionary) {
  const auto destroy_with_codes = [](apriltag_family_t* made) {
    std::free(made->codes);
    destroy(made);
  };
  if (family == nullptr) return {nullptr, destroy};
  const std::vector<std::uint64_t> by_rows = aruco_codes(dictionary.cells, dictionary.count);
  auto* codes = static_cast<std::uint64_t*>(std::malloc(by_rows.size() * sizeof(std::uint64_t)));
  if (codes == nullptr) {
    destroy(family);
    return {nullptr, destroy};
  }
  const std::uint32_t bits = family->nbits;
  for (std::size_t id = 0; id < by_rows.size(); ++id) {
    codes[id] = 0;
    for (std::uint32_t k = 0; k < bits; ++k) {
      // Cell coordinates count from the border's corner, so the first data cell is (1, 1).
      const std::uint32_t row = family->bit_y[k] - 1;
      const std::uint32_t column = family->bit_x[k] - 1;
      const std::uint32_t cell = row * static_cast<std::uint32_t>(dictionary.cells) + column;
      codes[id] |= (by_rows[id] >> (bits - 1 - cell) & 1U) << (bits - 1 - k);
    }
  }
  family->codes = codes;
  family->ncodes = static_cast<std::uint32_t>(by_rows.size());
  return {family, destroy_with_codes};
}

}  // namespace

TagFamilyHandle make_tag_family(TagFamily family) {
  if (const auto aruco = aruco_dictionary_of(family)) {
    if (aruco->cells == 4) return with_aruco_codes<tag16h5_destroy>(tag16h5_create(), *aruco);
    if (aruco->cells == 5) return with_aruco_codes<tag25h9_destroy>(tag25h9_create(), *aruco);
    return with_aruco_codes<tag36h11_destroy>(tag36h11_create(), *aruco);
  }
  const auto known = std::ranges::find(kLibraryFamilies, family, &LibraryFamily::family);
  PENUMBRA_ASSERT(known != kLibraryFamilies.end());
  return {known->create(), known->destroy};
}

int max_corrected_bits(TagFamily family) {
  const auto aruco = aruco_dictionary_of(family);
  // If one wrong bit were allowed, 1 in 20 random squares would be read as a marker of 4x4_50.
  return aruco && aruco->cells == 4 ? 0 : 2;
}

}  // namespace penumbra
