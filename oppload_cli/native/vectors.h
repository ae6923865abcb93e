/* Vectors of the compiler, for the inner loops of the models.
 *
 * All maps are float32, row after row; a stride is the distance between two rows, in
 * values.
 */
#pragma once
#include <stddef.h>
#include <string.h>

#define LANES 8
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4)));
typedef float half __attribute__((vector_size(2 * LANES), aligned(4)));
typedef double doubles __attribute__((vector_size(4 * LANES)));
typedef int mask __attribute__((vector_size(4 * LANES)));
typedef unsigned char bytes __attribute__((vector_size(LANES), aligned(1)));
#define LOAD(at) (*(const lanes *)(at))
#define STORE(at, value) (*(lanes *)(at) = (value))
#define HELD static inline __attribute__((always_inline))

/* Keep a value in its register, as it is: the compiler would load it twice, or go on with a
 * product before it is rounded. */
#if defined(__AVX2__)
#define KEEP(value) __asm__("" : "+x"(value))
#else
#define KEEP(value)
#endif

HELD lanes where(mask chosen, lanes a, lanes b)
{
    return (lanes)((chosen & (mask)a) | (~chosen & (mask)b));
}
#if defined(__AVX2__)
#include <immintrin.h>
HELD lanes least(lanes a, lanes b) { return (lanes)_mm256_min_ps((__m256)a, (__m256)b); }
HELD lanes most(lanes a, lanes b) { return (lanes)_mm256_max_ps((__m256)a, (__m256)b); }
#else
HELD lanes least(lanes a, lanes b) { return where(a < b, a, b); }
HELD lanes most(lanes a, lanes b) { return where(a > b, a, b); }
#endif

/* Bytes as whole numbers, and such from 0 to 255 as bytes. */
HELD mask of_bytes(const unsigned char *at)
{
#if defined(__AVX2__)
    return (mask)_mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i *)at));
#else
    return __builtin_convertvector(*(const bytes *)at, mask);
#endif
}
HELD bytes in_bytes(mask a)
{
#if defined(__AVX2__)
    __m128i words = _mm_packs_epi32(_mm256_castsi256_si128((__m256i)a),
                                    _mm256_extracti128_si256((__m256i)a, 1));
    return (bytes)_mm_cvtsi128_si64(_mm_packus_epi16(words, words));
#else
    return __builtin_convertvector(a, bytes);
#endif
}

HELD lanes magnitude(lanes a) { return (lanes)((mask)a & 0x7fffffff); }
HELD int any_of(mask chosen)
{
    int found = 0;
    for (int n = 0; n < LANES; n++) found |= chosen[n];
    return found;
}

HELD doubles in_double(const float *at)
{
    return __builtin_convertvector(*(const half *)at, doubles)
           + __builtin_convertvector(*(const half *)(at + LANES / 2), doubles);
}

HELD double total(doubles values)
{
    double sum = 0;
    for (int k = 0; k < LANES / 2; k++) sum += values[k];
    return sum;
}
