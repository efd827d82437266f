// Scores of the pattern search.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

// Sums of bytes in 16-bit lanes. The compiler's own widening of bytes goes through several
// shuffles; the instruction that does it in one is asked for by name where there is one.
#if defined(__AVX512BW__)
using Words = __m512i;
constexpr int kWordLanes = 32;
PENUMBRA_INLINE Words zero_words() {
  return _mm512_setzero_si512();
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  return _mm512_cvtepu8_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(bytes)));
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return _mm512_add_epi16(a, b);
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return _mm512_sub_epi16(a, b);
}
#elif defined(__AVX2__)
using Words = __m256i;
constexpr int kWordLanes = 16;
PENUMBRA_INLINE Words zero_words() {
  return _mm256_setzero_si256();
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  return _mm256_cvtepu8_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(bytes)));
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return _mm256_add_epi16(a, b);
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return _mm256_sub_epi16(a, b);
}
#else
using Words = std::int16_t __attribute__((vector_size(16)));
constexpr int kWordLanes = 8;
PENUMBRA_INLINE Words zero_words() {
  return Words{};
}
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
  using Bytes = std::uint8_t __attribute__((vector_size(8)));
  Bytes packed;
  __builtin_memcpy(&packed, bytes, sizeof packed);
  return __builtin_convertvector(packed, Words);
}
PENUMBRA_INLINE Words add_words(Words a, Words b) {
  return a + b;
}
PENUMBRA_INLINE Words subtract_words(Words a, Words b) {
  return a - b;
}
#endif

template <int columns>
void search_as(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
               int count, int rows, int row_step, std::int16_t* scores) {
  constexpr int kParts = columns / kWordLanes;
  for (int row = 0; row < rows; ++row) {
    Words sum[kParts];
#pragma GCC unroll 8
    for (int part = 0; part < kParts; ++part) sum[part] = zero_words();
    for (int k = 0; k < positive; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part)
        sum[part] = add_words(sum[part], load_words(pixels + kWordLanes * part));
    }
    for (int k = positive; k < count; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part)
        sum[part] = subtract_words(sum[part], load_words(pixels + kWordLanes * part));
    }
    __builtin_memcpy(scores + row * columns, sum, sizeof sum);
  }
}

void search(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
            int count, int columns, int rows, int row_step, std::int16_t* scores) {
  if (columns == 32) {
    search_as<32>(points, strides, positive, count, rows, row_step, scores);
  } else {
    search_as<64>(points, strides, positive, count, rows, row_step, scores);
  }
}

void add(const std::int16_t* scores, int count, std::int32_t* sums) {
#pragma omp simd
  for (int k = 0; k < count; ++k) sums[k] += scores[k];
}
