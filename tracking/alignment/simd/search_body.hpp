// Computes the scores of the pattern search.
// Included by loops_body.hpp, once for each instruction set, inside its namespace.

// Sums bytes in 16-bit lanes by intrinsics; the compiler's conversion needs several shuffles.
constexpr int kWordLanes = 2 * kWide;
using Words = std::int16_t __attribute__((vector_size(2 * kWordLanes)));
PENUMBRA_INLINE Words load_words(const std::uint8_t* bytes) {
#if defined(__AVX512BW__)
  return reinterpret_cast<Words>(
      _mm512_cvtepu8_epi16(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(bytes))));
#elif defined(__AVX2__)
  return reinterpret_cast<Words>(
      _mm256_cvtepu8_epi16(_mm_loadu_si128(reinterpret_cast<const __m128i*>(bytes))));
#else
  using Bytes = std::uint8_t __attribute__((vector_size(kWordLanes)));
  Bytes packed;
  __builtin_memcpy(&packed, bytes, sizeof packed);
  return __builtin_convertvector(packed, Words);
#endif
}

template <int columns>
void search_as(const std::uint8_t* const* points, const std::ptrdiff_t* strides, int positive,
               int count, int rows, int row_step, std::int16_t* scores) {
  constexpr int kParts = columns / kWordLanes;
  for (int row = 0; row < rows; ++row) {
    Words sum[kParts] = {};
    for (int k = 0; k < positive; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part) sum[part] += load_words(pixels + kWordLanes * part);
    }
    for (int k = positive; k < count; ++k) {
      const std::uint8_t* pixels = points[k] + row * row_step * strides[k];
#pragma GCC unroll 8
      for (int part = 0; part < kParts; ++part) sum[part] -= load_words(pixels + kWordLanes * part);
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
