/* The presynaptic sums S and S_phi: compute/presynaptic.py.
 *
 * The kernels are even across and down, and their directional parts are odd in one of the two
 * directions. So the pixels at (dx, dy) and at its mirror images are added or subtracted first
 * ("folded") and multiplied by the kernel value once.
 *
 * No kernel value is below 0. Once the inhibition summed so far is as large as the excitation
 * in every direction, every S is 0, and the remaining rows of the kernels are not summed. That
 * is so at nearly every pixel of most videos.
 */
#include "vectors.h"

#define AGES 3                  /* P(t), P(t-1), P(t-2) */
#define VECTORS 3
#define STRIP (VECTORS * LANES) /* columns that are computed together */
#define FOLDED (2 * STRIP)      /* the sums and the differences of a strip */
#define MOST_REACH 50           /* of a kernel */
#define AHEAD 8                 /* rows that are fetched early */
#define CACHE_LINE 16           /* floats */

/* Kernel values side by side: those of one age and one dy, at dx, dx + 1, ... */
enum { STAGE, AGE, DY, DX, COUNT, FIELDS };
typedef int run[FIELDS];
/* A kernel value, and its directional parts that are odd across and odd down. */
enum { EVEN, ACROSS, DOWN, PARTS };
typedef float tap[PARTS];

struct sums { lanes even[VECTORS], across[VECTORS], down[VECTORS]; };

/* The folded rows around the current one, in a ring, by age. */
struct ring { const float *map; float *rows; int reach, next; ptrdiff_t size; };

static int slots_of(const int *reach)
{
    int most = 0, slots = 1;
    for (int age = 0; age < AGES; age++) most = reach[age] > most ? reach[age] : most;
    while (slots <= 2 * most) slots *= 2;
    return slots;
}

/* Return how many floats of scratch the sums need. */
int presynaptic_scratch(const int *reach)
{
    return slots_of(reach) * FOLDED * (reach[0] + reach[1] + reach[2] + AGES);
}

/* Fold one row: add and subtract what lies dx to the left and to the right, for each dx.
 * For dx = 0 there is no difference: its place holds zeros from the start. Beyond the frame P
 * is 0. */
HELD void fold(const float *row, int x, int width, int reach, float *out)
{
    float line[STRIP + 2 * MOST_REACH];
    const float *centre = row + x;
    if (!row || x < reach || x + STRIP + reach > width) {
        memset(line, 0, sizeof line);
        int first = x < reach ? 0 : x - reach;
        int last = x + STRIP + reach > width ? width : x + STRIP + reach;
        if (row)
            memcpy(line + first - x + reach, row + first, (size_t)(last - first) * sizeof(float));
        centre = line + reach;
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

/* Fold the rows up to `reach` around y that have not been folded yet. */
HELD void fold_around(struct ring *ring, int slots, int y, int x, int height, int width)
{
    int row = ring->next > y - ring->reach ? ring->next : y - ring->reach;
    for (; row <= y + ring->reach; row++) {
        const float *from = row < 0 || row >= height ? NULL : ring->map + (ptrdiff_t)row * width;
        /* A strip runs down the frame: without this every row would wait for memory. */
        for (int k = 0; from && row + AHEAD < height && k < STRIP + CACHE_LINE; k += CACHE_LINE)
            __builtin_prefetch(from + (ptrdiff_t)AHEAD * width + x + k);
        fold(from, x, width, ring->reach, ring->rows + ring->size * (row & (slots - 1)));
    }
    ring->next = row;
}

/* Add the taps of one run: of one row (dy = 0), or of the rows dy above and below. */
HELD void add_taps(const tap *taps, int count, const float *above, const float *below, int both,
                   int directional, struct sums *to)
{
    for (; count--; taps++, above += FOLDED, below += FOLDED)
#pragma GCC unroll 8
        for (int k = 0; k < VECTORS; k++) {
            lanes sum = LOAD(above + LANES * k), aside = LOAD(above + STRIP + LANES * k);
            if (both) {
                lanes a = sum, b = LOAD(below + LANES * k);
                KEEP(a);
                KEEP(b);
                sum = a + b;
                aside += LOAD(below + STRIP + LANES * k);
                if (directional) to->down[k] += (*taps)[DOWN] * (a - b);
            }
            to->even[k] += (*taps)[EVEN] * sum;
            if (directional) to->across[k] += (*taps)[ACROSS] * aside;
        }
}

HELD void add_run(const int *run, const tap *taps, const struct ring *ring, int slots, int y,
                  int directional, struct sums *to)
{
    const float *row = ring->rows + run[DX] * FOLDED;
    const float *above = row + ring->size * ((y - run[DY]) & (slots - 1));
    const float *below = row + ring->size * ((y + run[DY]) & (slots - 1));
    if (run[DY])
        add_taps(taps, run[COUNT], above, below, 1, directional, to);
    else
        add_taps(taps, run[COUNT], above, above, 0, directional, to);
}

/* Return J of both axes: I_phi = I / 2 + J_phi, and I_(phi+180) = I / 2 - J_phi. */
HELD lanes first_axis(int diagonal, lanes across, lanes down)
{
    return diagonal ? down + across : across;
}
HELD lanes second_axis(int diagonal, lanes across, lanes down)
{
    return diagonal ? down - across : down;
}

/* Tell whether any S would be above 0 with no more inhibition than summed so far. */
HELD int some_remain(int diagonal, const lanes *e, const struct sums *i)
{
    mask any = {0};
    for (int k = 0; k < VECTORS; k++) {
        lanes first = magnitude(first_axis(diagonal, i->across[k], i->down[k]));
        lanes second = magnitude(second_axis(diagonal, i->across[k], i->down[k]));
        any |= e[k] + most(first, second) > 0.5f * i->even[k];
    }
    return any_of(any);
}

/* Put max(0, E - inhibition) where it is wanted. It is at most E: where nothing changed, E is
 * exactly 0, while the rounding of the inhibition may leave that below 0. */
HELD void put(float *map, ptrdiff_t at, int count, lanes e, lanes inhibition)
{
    if (!map) return;
    lanes s = least(most(e - inhibition, (lanes){0}), e);
    if (count >= LANES)
        STORE(map + at, s);
    else
        store_some(map + at, s, count);
}

/* Compute S and S_phi of the rows first to last - 1; those that are NULL are not wanted.
 *
 * `scratch` is made of zeros. `filled` holds a byte for each strip of each row: 0 where all of its S are 0 already. Most
 * are, and stay so from frame to frame: they are not written again. */
void presynaptic_sums(const float *now, const float *one_ago, const float *two_ago, int height,
                      int width, const run *runs, int run_count, const tap *taps,
                      const int *reach, int diagonal, float *s, float *first_phi,
                      float *second_phi, float *first_opposite, float *second_opposite,
                      int first, int last, float *scratch, char *filled)
{
    const int strips = (width + STRIP - 1) / STRIP;
    const float *maps[AGES] = {now, one_ago, two_ago};
    const int slots = slots_of(reach);
    struct ring rings[AGES];
    for (int age = 0; age < AGES; age++) {
        ptrdiff_t size = (ptrdiff_t)(reach[age] + 1) * FOLDED;
        rings[age] = (struct ring){maps[age], scratch, reach[age], 0, size};
        scratch += size * slots;
    }
    for (int x = 0; x < width; x += STRIP) {
        for (int age = 0; age < AGES; age++) rings[age].next = first - reach[age];
        for (int y = first; y < last; y++) {
            struct sums e = {0}, i = {0};
            const tap *next = taps;
            int stage = -1, remain = 1;
            for (int n = 0; n < run_count; next += runs[n][COUNT], n++) {
                struct ring *ring = &rings[runs[n][AGE]];
                if (runs[n][STAGE] != stage) {
                    if (stage >= 0) remain = some_remain(diagonal, e.even, &i);
                    if (!remain) break;
                    stage = runs[n][STAGE];
                    fold_around(ring, slots, y, x, height, width);
                }
                if (stage)
                    add_run(runs[n], next, ring, slots, y, 1, &i);
                else
                    add_run(runs[n], next, ring, slots, y, 0, &e);
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
