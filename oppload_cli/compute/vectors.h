/* Vectors of floats, for the inner loops over maps.
 *
 * A vector fills one register: GCC keeps longer ones in memory, where a loop takes six times as
 * long. All maps are float32, row after row without gaps.
 */
#pragma once
#include <stddef.h>
#include <string.h>

#if defined(__AVX2__)
#define LANES 8
#else
#define LANES 4 /* SSE2, NEON */
#endif
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4)));
typedef float half __attribute__((vector_size(2 * LANES), aligned(4)));
typedef double doubles __attribute__((vector_size(4 * LANES)));
typedef int mask __attribute__((vector_size(4 * LANES)));
#define LOAD(at) (*(const lanes *)(at))
#define STORE(at, value) (*(lanes *)(at) = (value))
#define INLINE static inline __attribute__((always_inline))

#if defined(__AVX2__)
#include <immintrin.h>
INLINE lanes least(lanes a, lanes b) { return (lanes)_mm256_min_ps((__m256)a, (__m256)b); }
INLINE lanes most(lanes a, lanes b) { return (lanes)_mm256_max_ps((__m256)a, (__m256)b); }
INLINE int any_of(mask chosen) { return _mm256_movemask_ps((__m256)chosen); }
/* Keep a value in a register: otherwise the compiler loads it twice, or rounds it later. */
#define KEEP(value) __asm__("" : "+x"(value))
#else
INLINE lanes where(mask chosen, lanes a, lanes b)
{
    return (lanes)((chosen & (mask)a) | (~chosen & (mask)b));
}
INLINE lanes least(lanes a, lanes b) { return where(a < b, a, b); }
INLINE lanes most(lanes a, lanes b) { return where(a > b, a, b); }
INLINE int any_of(mask chosen)
{
    typedef long long pair __attribute__((vector_size(4 * LANES)));
    return (((pair)chosen)[0] | ((pair)chosen)[1]) != 0;
}
#define KEEP(value)
#endif

INLINE lanes magnitude(lanes a) { return (lanes)((mask)a & 0x7fffffff); }

/* Load or store only the first `count` of the lanes, at the right edge of a map. */
INLINE lanes load_some(const float *at, int count)
{
    lanes values = {0};
    memcpy(&values, at, (size_t)(count < LANES ? count : LANES) * sizeof(float));
    return values;
}
INLINE void store_some(float *at, lanes values, int count)
{
    memcpy(at, &values, (size_t)(count < LANES ? count : LANES) * sizeof(float));
}

INLINE float sum_of(lanes values)
{
    /* A tree: the additions of one row do not wait for each other. */
    for (int step = LANES / 2; step; step /= 2)
        for (int n = 0; n < step; n++) values[n] += values[n + step];
    return values[0];
}

INLINE doubles in_double(lanes values)
{
    const float *at = (const float *)&values;
    return __builtin_convertvector(*(const half *)at, doubles)
           + __builtin_convertvector(*(const half *)(at + LANES / 2), doubles);
}
INLINE double total(doubles values)
{
    double sum = 0;
    for (int n = 0; n < LANES / 2; n++) sum += values[n];
    return sum;
}
