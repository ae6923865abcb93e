/* The presynaptic sums S and S_phi: compute/loops.py.
 *
 * The kernels are even across and down, and their directional parts are odd in one of the two
 * directions. So the pixels at (dx, dy) and at its mirror images are added or subtracted first
 * ("folded"), and their sum is multiplied by the kernel value once.
 *
 * No kernel value is below 0. As soon as the inhibition summed so far is as large as the excitation
 * in every direction, every S is 0, and the rest of the inhibition need not be summed. This is so
 * at nearly every pixel of most videos.
 */
#include "vectors.h"

#define AGES 3                  /* P(t), P(t-1), P(t-2) */
#define STRIP 16                /* columns that are computed together */
#define VECTORS (STRIP / LANES)
#define FOLDED (2 * STRIP)      /* the sums and the differences of a strip, at one dx */
#define ROWS 64                 /* rows of a strip that are computed before the next strip */
#define MOST_REACH 50           /* of a kernel */
#define AHEAD 8                 /* rows that are fetched early */
#define CACHE_LINE 16           /* floats */

/* A kernel value, and its directional parts that are odd across and odd down. */
struct tap { float even, across, down; };
/* A number of taps of one age; after each stage the sum stops if every S is 0. */
struct stage { int age, taps; };
/* Offsets in the scratch memory of the folded values dy above and dy below a pixel. */
struct place { int above, below; };
/* Offset in the scratch memory of the folded rows of one age, and the largest dx that they hold. */
struct ring { int begin, reach; };

struct sums { lanes even[VECTORS], across[VECTORS], down[VECTORS]; };

/* Return the number of floats of a folded row for each dx. */
int folded(void) { return FOLDED; }

/* Fold one row: for each dx, add and subtract the values dx to the left and dx to the right.
 * The differences for dx = 0 are zeros from the start. Outside the frame P is 0. */
INLINE void fold(const float *row, int x, int width, int reach, float *out)
{
    float line[STRIP + 2 * MOST_REACH];
    const float *centre = line + reach;
    if (row && x >= reach && x + STRIP + reach <= width) {
        centre = row + x;
    } else {
        memset(line, 0, sizeof line);
        int first = x < reach ? 0 : x - reach;
        int last = x + STRIP + reach > width ? width : x + STRIP + reach;
        if (row)
            memcpy(line + first - x + reach, row + first, (size_t)(last - first) * sizeof(float));
    }
    for (int k = 0; k < STRIP; k += LANES) STORE(out + k, LOAD(centre + k));
    for (int dx = 1; dx <= reach; dx++) {
        out += FOLDED;
        for (int k = 0; k < STRIP; k += LANES) {
            lanes left = LOAD(centre - dx + k), right = LOAD(centre + dx + k);
            STORE(out + k, left + right);
            STORE(out + STRIP + k, left - right);
        }
    }
}

/* Fold the rows within the reach of row y that are not folded yet, `next` being the first of them.
 * Return the row after the last. */
INLINE int fold_around(const float *map, struct ring ring, int slots, int next, int y, int x,
                       int height, int width, float *scratch)
{
    float *rows = scratch + ring.begin;
    const ptrdiff_t size = (ptrdiff_t)(ring.reach + 1) * FOLDED;
    int row = next > y - ring.reach ? next : y - ring.reach;
    for (; row <= y + ring.reach; row++) {
        const float *from = row < 0 || row >= height ? NULL : map + (ptrdiff_t)row * width;
        /* A strip runs down the frame: without prefetching every row would wait for memory. */
        for (int k = 0; from && row + AHEAD < height && k < STRIP + CACHE_LINE; k += CACHE_LINE)
            __builtin_prefetch(from + (ptrdiff_t)AHEAD * width + x + k);
        fold(from, x, width, ring.reach, rows + size * (row & (slots - 1)));
    }
    return row;
}

/* Add taps to the sums. */
INLINE void add_taps(const float *scratch, const struct place *places, const struct tap *taps,
                     int count, int directional, struct sums *to)
{
    for (; count--; taps++, places++) {
        const float *above = scratch + places->above, *below = scratch + places->below;
#pragma GCC unroll 8
        for (int k = 0; k < VECTORS; k++) {
            lanes a = LOAD(above + LANES * k), b = LOAD(below + LANES * k);
            KEEP(a);
            KEEP(b);
            to->even[k] += taps->even * (a + b);
            if (!directional) continue;
            lanes odd = LOAD(above + STRIP + LANES * k) + LOAD(below + STRIP + LANES * k);
            to->across[k] += taps->across * odd;
            to->down[k] += taps->down * (a - b);
        }
    }
}

/* Return J of both axes: I_phi = I / 2 + J_phi, and I_(phi+180) = I / 2 - J_phi. */
INLINE lanes first_axis(int diagonal, lanes across, lanes down)
{
    return diagonal ? down + across : across;
}
INLINE lanes second_axis(int diagonal, lanes across, lanes down)
{
    return diagonal ? down - across : down;
}

/* Return whether any S is above 0 with the inhibition summed so far. */
INLINE int some_remain(int directional, int diagonal, const lanes *e, const struct sums *i)
{
    mask any = {0};
    for (int k = 0; k < VECTORS; k++) {
        if (!directional) {
            any |= e[k] > i->even[k];
            continue;
        }
        lanes first = magnitude(first_axis(diagonal, i->across[k], i->down[k]));
        lanes second = magnitude(second_axis(diagonal, i->across[k], i->down[k]));
        any |= e[k] + most(first, second) > 0.5f * i->even[k];
    }
    return any_of(any);
}

/* Store S = max(0, E - inhibition), unless the map is NULL. S is limited to E, so that it is
 * exactly 0 where nothing changed: E is 0 there, but rounding can make inhibition less than 0. */
INLINE void put(float *map, ptrdiff_t at, int count, lanes e, lanes inhibition)
{
    if (!map) return;
    lanes s = least(most(e - inhibition, (lanes){0}), e);
    if (count >= LANES)
        STORE(map + at, s);
    else
        store_some(map + at, s, count);
}

/* Compute S and S_phi of the rows first to last - 1; maps that are NULL are left out.
 *
 * The first stage is the excitation. `places` holds the offsets of all taps for each of the `slots`
 * rows of a ring; `slots` is a power of 2. At the start `scratch` holds zeros. Its first FOLDED
 * values stay 0: they are the values below for dy = 0. `filled` holds a byte for each strip of each
 * row, which is 0 if all of its S are 0. Most strips stay at 0 from frame to frame, and are not
 * written again. */
void presynaptic_sums(const float *now, const float *one_ago, const float *two_ago, int height,
                      int width, const struct stage *stages, int stage_count,
                      const struct tap *taps, int tap_count, const struct place *places,
                      const struct ring *rings, int slots, int diagonal, float *s,
                      float *first_phi, float *second_phi, float *first_opposite,
                      float *second_opposite, int first, int last, float *scratch, char *filled)
{
    const float *maps[AGES] = {now, one_ago, two_ago};
    const int strips = (width + STRIP - 1) / STRIP, directional = first_phi != NULL;
    for (int top = first; top < last; top += ROWS)
        for (int x = 0; x < width; x += STRIP) {
            int next[AGES];
            for (int age = 0; age < AGES; age++) next[age] = top - rings[age].reach;
            for (int y = top; y < last && y < top + ROWS; y++) {
                struct sums e = {0}, i = {0};
                const struct place *place = places + (ptrdiff_t)(y & (slots - 1)) * tap_count;
                const struct tap *tap = taps;
                next[0] = fold_around(now, rings[0], slots, next[0], y, x, height, width, scratch);
                add_taps(scratch, place, tap, stages[0].taps, 0, &e);
                int remain = some_remain(directional, diagonal, e.even, &i);
                for (int n = 1; remain && n < stage_count; n++) {
                    place += stages[n - 1].taps;
                    tap += stages[n - 1].taps;
                    const int age = stages[n].age;
                    next[age] = fold_around(maps[age], rings[age], slots, next[age], y, x, height,
                                            width, scratch);
                    if (directional)
                        add_taps(scratch, place, tap, stages[n].taps, 1, &i);
                    else
                        add_taps(scratch, place, tap, stages[n].taps, 0, &i);
                    remain = some_remain(directional, diagonal, e.even, &i);
                }
                char *is_filled = filled + (ptrdiff_t)y * strips + x / STRIP;
                if (!remain && !*is_filled) continue;
                *is_filled = (char)remain;
#pragma GCC unroll 8
                for (int k = 0; k < VECTORS; k++) {
                    int count = width - x - LANES * k;
                    if (count <= 0) break;
                    ptrdiff_t at = (ptrdiff_t)y * width + x + LANES * k;
                    lanes excitation = remain ? e.even[k] : (lanes){0};
                    lanes half = 0.5f * i.even[k];
                    lanes one = first_axis(diagonal, i.across[k], i.down[k]);
                    lanes other = second_axis(diagonal, i.across[k], i.down[k]);
                    put(s, at, count, excitation, i.even[k]);
                    put(first_phi, at, count, excitation, half + one);
                    put(second_phi, at, count, excitation, half + other);
                    put(first_opposite, at, count, excitation, half - one);
                    put(second_opposite, at, count, excitation, half - other);
                }
            }
        }
}
