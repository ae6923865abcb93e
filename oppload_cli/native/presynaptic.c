/* P and the presynaptic sums: oppload_cli/models/direct.py. */
#include "presynaptic.h"

/* Write |luma - before|, keep luma, and return the sum of what was written. */
double change(const float *restrict luma, ptrdiff_t stride, const float *restrict before,
              float *restrict kept, float *restrict out, ptrdiff_t out_stride, int height,
              int width)
{
    double sum = 0;
    for (int y = 0; y < height; y++) {
        for (int x = 0; x < width; x++) {
            kept[x] = luma[x];
            out[x] = __builtin_fabsf(luma[x] - before[x]);
        }
        doubles sums = {0};
        int x = 0;
        for (; x + LANES <= width; x += LANES) sums += in_double(out + x);
        for (; x < width; x++) sum += out[x];
        sum += total(sums);
        luma += stride, before += width, kept += width, out += out_stride;
    }
    return sum;
}

#define VECTORS 3
#define STRIP (VECTORS * LANES) /* columns that are worked on at once */
#define PAIR (2 * STRIP)        /* sum and difference of what lies left and right */

int strip(void) { return STRIP; }

/* Kernel values at one offset (dx, dy) and its mirror images. */
struct tap { float even, across, down; };

struct sums {
    const float *photoreceptors[AGES]; /* at pixel (0, 0), with zeros around the frame */
    ptrdiff_t stride;
    float *outputs[OUTPUTS]; /* NULL where it is not wanted */
    ptrdiff_t output_stride; /* whole strips */
    const struct group *groups;
    const struct tap *taps;
    int groups_of_excitation, groups_of_inhibition;
    int reach[AGES]; /* largest |dx| and |dy| */
    int slots;       /* a power of 2, above twice the largest reach */
    int width, diagonal;
};

/* Add and subtract what lies dx to the left and to the right, for each dx.
 *
 * For dx = 0 there is no difference: its place holds the zeros that it was made with. */
HELD void fold(const float *row, float *out, int reach)
{
    for (int k = 0; k < STRIP; k += LANES) STORE(out + k, LOAD(row + k));
    for (int dx = 1; dx <= reach; dx++) {
        out += PAIR;
        for (int k = 0; k < STRIP; k += LANES) {
            lanes left = LOAD(row - dx + k), right = LOAD(row + dx + k);
            STORE(out + k, left + right);
            STORE(out + STRIP + k, left - right);
        }
    }
}

struct folded { float *rows[AGES]; ptrdiff_t size[AGES]; int next[AGES], mask; };

/* Fold the rows up to `reach` around y that have not been folded yet. */
HELD void fold_around(const struct sums *job, struct folded *to, int age, int y, int x)
{
    int reach = job->reach[age];
    int row = to->next[age] > y - reach ? to->next[age] : y - reach;
    for (; row <= y + reach; row++) {
        const float *from = job->photoreceptors[age] + row * job->stride + x;
        for (int k = -LANES; k < STRIP + LANES; k += 16)
            __builtin_prefetch(from + ROWS_AHEAD * job->stride + k);
        fold(from, to->rows[age] + to->size[age] * (row & to->mask), reach);
    }
    to->next[age] = row;
}

/* Sum the taps of one group: of one row (dy = 0), or of one above and one below. */
HELD void add_row(const struct tap *tap, int count, const float *above, const float *below,
                  int apart, int directional, lanes *even, lanes *across, lanes *down)
{
    for (; count--; tap++, above += PAIR, below += PAIR)
#pragma GCC unroll 8
        for (int k = 0; k < VECTORS; k++) {
            lanes a = LOAD(above + LANES * k), aside = LOAD(above + STRIP + LANES * k);
            lanes sum = a;
            if (apart) {
                lanes b = LOAD(below + LANES * k);
                KEEP(a);
                KEEP(b);
                sum = a + b;
                aside += LOAD(below + STRIP + LANES * k);
                if (directional) down[k] += tap->down * (a - b);
            }
            even[k] += tap->even * sum;
            if (directional) across[k] += tap->across * aside;
        }
}

/* Sum some groups of taps over one row of a strip. */
HELD void add_up(const struct group *group, int groups, const struct tap *tap,
                 const struct folded *at, int y, int directional, lanes *even, lanes *across,
                 lanes *down)
{
    for (; groups--; tap += group->count, group++) {
        const float *row = at->rows[group->age] + group->dx * PAIR;
        ptrdiff_t size = at->size[group->age];
        const float *above = row + size * ((y - group->dy) & at->mask);
        const float *below = row + size * ((y + group->dy) & at->mask);
        if (group->dy)
            add_row(tap, group->count, above, below, 1, directional, even, across, down);
        else
            add_row(tap, group->count, above, above, 0, directional, even, across, down);
    }
}

HELD int any_of(const lanes *values)
{
    mask any = {0};
    for (int k = 0; k < VECTORS; k++) any |= values[k] != 0;
    int found = 0;
    for (int n = 0; n < LANES; n++) found |= any[n];
    return found;
}

/* Compute the maps of rows first to last - 1. `scratch` holds the folded rows; it is made
 * of zeros, and for one job. */
void sums(const struct sums *job, int first, int last, float *scratch)
{
    struct folded rows = {.mask = job->slots - 1};
    int excitation_taps = 0;
    for (int n = 0; n < job->groups_of_excitation; n++) excitation_taps += job->groups[n].count;
    for (int age = 0; age < AGES; age++) {
        rows.rows[age] = scratch;
        rows.size[age] = (job->reach[age] + 1) * PAIR;
        scratch += rows.size[age] * job->slots;
    }
    for (int x = 0; x < job->width; x += STRIP) {
        for (int age = 0; age < AGES; age++) rows.next[age] = first - job->reach[age];
        for (int y = first; y < last; y++) {
            lanes e[VECTORS] = {0}, i[VECTORS] = {0}, across[VECTORS] = {0}, down[VECTORS] = {0};
            fetch_ahead(job->outputs, job->output_stride, y, x, STRIP);
            fold_around(job, &rows, 0, y, x);
            add_up(job->groups, job->groups_of_excitation, job->taps, &rows, y, 0, e, e, e);
            if (!job->outputs[I] && !any_of(e)) { /* every S is 0 where E is, whatever inhibits */
                clear(job->outputs, job->output_stride, y, x, STRIP);
                continue;
            }
            for (int age = 1; age < AGES; age++) fold_around(job, &rows, age, y, x);
            add_up(job->groups + job->groups_of_excitation, job->groups_of_inhibition,
                   job->taps + excitation_taps, &rows, y, 1, i, across, down);
#pragma GCC unroll 8
            for (int k = 0; k < VECTORS; k++)
                put_all(job->outputs, y * job->output_stride + x + LANES * k, job->diagonal, e[k],
                        i[k], across[k], down[k]);
        }
    }
    for (int y = first; y < last; y++) /* beyond the frame, in the rest of the last strip */
        clear(job->outputs, job->output_stride, y, job->width, job->output_stride - job->width);
}
