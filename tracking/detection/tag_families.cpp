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

#include <cstdlib>
#include <vector>

#include "tracking/detection/aruco_codes.hpp"

namespace penumbra {
namespace {

// A dictionary has the cells of one of libapriltag's families: only the codes are its own. There
// each bit has a place of its own, so that turning the tag shifts the code. `destroy` is the
// family's; its codes are constants of the library, and these are not.
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
      // Cells count from the border's corner: the first data cell is (1, 1).
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
  switch (family) {
    case TagFamily::tag36h10:
      return {tag36h10_create(), tag36h10_destroy};
    case TagFamily::tag25h9:
      return {tag25h9_create(), tag25h9_destroy};
    case TagFamily::tag16h5:
      return {tag16h5_create(), tag16h5_destroy};
    case TagFamily::tag_circle21h7:
      return {tagCircle21h7_create(), tagCircle21h7_destroy};
    case TagFamily::tag_circle49h12:
      return {tagCircle49h12_create(), tagCircle49h12_destroy};
    case TagFamily::tag_standard41h12:
      return {tagStandard41h12_create(), tagStandard41h12_destroy};
    case TagFamily::tag_standard52h13:
      return {tagStandard52h13_create(), tagStandard52h13_destroy};
    case TagFamily::tag_custom48h12:
      return {tagCustom48h12_create(), tagCustom48h12_destroy};
    default:
      return {tag36h11_create(), tag36h11_destroy};
  }
}

int most_corrected_bits(TagFamily family) {
  const auto aruco = aruco_dictionary_of(family);
  // With a wrong bit allowed, one in twenty squares of any kind reads as a marker of 4x4_50.
  if (aruco) return aruco->cells == 4 ? 0 : 2;
  return 2;
}

}  // namespace penumbra
