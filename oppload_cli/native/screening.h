/* Where S cannot be above 0, found in 8 bits before the sums: oppload_cli/models/screening.py.
 *
 * What excites is bounded from above and what inhibits from below: by sums over boxes of
 * 2 x 2 pixels of P(t-1) in code levels, each with the least weight that it has in W_I1.
 * One instruction multiplies 32 of them.
 */
#pragma once
#include <stdint.h>

#include "presynaptic.h"

#define PATHWAYS 4
#define SCREENED 32       /* columns that are looked at at once */
#define MOST_SURE 0x7ffe  /* a bound of E above it may be one that did not fit */
typedef __m256i codes;

/* Where two values lie from the pixel that is looked at, and their weights for each
 * pathway: twice, to fill the 32 bits that a processor repeats at no cost. */
struct bounded { int32_t places[2]; int8_t weights[PATHWAYS][4]; };
struct bound { const struct bounded *pairs; int count; };
struct screening { struct bound excitation, inhibition; int reach; /* of the boxes */ };

/* Sum boxes of 2 x 2 values; what does not fit 8 bits is as much as fits. */
HELD void sum_boxes(const uint8_t *row, ptrdiff_t stride, uint8_t *out)
{
    for (ptrdiff_t x = 0; x < stride; x += SCREENED) {
        codes sum = {0};
        for (int k = 0; k < 4; k++)
            sum = _mm256_adds_epu8(
                sum, _mm256_loadu_si256((const codes *)(row + x + k % 2 + k / 2 * stride)));
        _mm256_storeu_si256((codes *)(out + x), sum);
    }
}

/* Add up the bounds of some pathways. The pixels are mixed, within their half. */
HELD void add_bound(const uint8_t *at, const struct bound *bound, int pathways, codes (*totals)[2])
{
    for (const struct bounded *pair = bound->pairs, *end = pair + bound->count; pair < end; pair++) {
        codes one = _mm256_loadu_si256((const codes *)(at + pair->places[0]));
        codes other = _mm256_loadu_si256((const codes *)(at + pair->places[1]));
        codes both[2] = {_mm256_unpacklo_epi8(one, other), _mm256_unpackhi_epi8(one, other)};
#pragma GCC unroll 4
        for (int p = 0; p < pathways; p++) {
            int32_t two;
            memcpy(&two, pair->weights[p], sizeof two);
            codes weights = _mm256_set1_epi32(two);
            KEEP(weights);
#pragma GCC unroll 2
            for (int k = 0; k < 2; k++) {
                codes products = _mm256_maddubs_epi16(both[k], weights);
                totals[p][k] = _mm256_adds_epi16(totals[p][k], products);
                KEEP(totals[p][k]); /* as in whole.c: there are too few registers otherwise */
            }
        }
    }
}

/* Tell for which half of the pixels any S may be above 0: bit 0 for the left one. */
HELD int possible(const codes *excitation, codes (*inhibition)[2])
{
    codes any = {0};
    for (int k = 0; k < 2; k++) {
        codes least = _mm256_set1_epi16(MOST_SURE);
        for (int p = 0; p < PATHWAYS; p++) least = _mm256_min_epi16(least, inhibition[p][k]);
        any |= _mm256_cmpgt_epi16(excitation[k], least);
    }
    __m128i left = _mm256_castsi256_si128(any), right = _mm256_extracti128_si256(any, 1);
    return !_mm_testz_si128(left, left) | !_mm_testz_si128(right, right) << 1;
}

/* Screen 32 pixels of P(t), with the boxes of P(t-1), as `possible` says it. */
HELD int screened(const struct screening *screening, const uint8_t *now, const uint8_t *boxes)
{
    codes excitation[1][2] = {0}, inhibition[PATHWAYS][2] = {0};
    add_bound(now, &screening->excitation, 1, excitation);
    if (!possible(excitation[0], inhibition)) return 0;
    add_bound(boxes, &screening->inhibition, PATHWAYS, inhibition);
    return possible(excitation[0], inhibition);
}
