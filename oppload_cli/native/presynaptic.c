/* P and the presynaptic sums: oppload_cli/models/change.py and direct.py. */
#include <stdint.h>

#include "presynaptic.h"

struct change {
    const float *luma; /* L(t) */
    ptrdiff_t stride;
    const float *before; /* the L before it, row after row */
    float *kept;         /* takes L(t), row after row */
    float *out;          /* takes P(t) */
    ptrdiff_t out_stride;
    uint8_t *codes; /* takes P(t) in code levels: see whole.c */
    ptrdiff_t codes_stride;
    double *totals; /* take the sum of each row */
    int width;
    int levels; /* 0: codes are left alone */
    int whole;  /* becomes 0 where P(t) has fractions of a level */
};

/* Compute P(t) of rows first to last - 1. */
void change(struct change *job, int first, int last)
{
    const float levels = job->levels;
    mask broken = {0};
    for (int y = first; y < last; y++) {
        const float *luma = job->luma + y * job->stride, *before = job->before + y * job->width;
        float *kept = job->kept + y * job->width, *out = job->out + y * job->out_stride;
        uint8_t *codes = job->codes + y * job->codes_stride;
        doubles sums = {0};
        double sum = 0;
        int x = 0;
        for (; x + LANES <= job->width; x += LANES) {
            lanes l = LOAD(luma + x), p = magnitude(l - LOAD(before + x));
            STORE(kept + x, l);
            STORE(out + x, p);
            sums += in_double(out + x);
            if (!job->levels) continue;
            mask code = __builtin_convertvector(p * levels + 0.5f, mask);
            broken |= ~(magnitude(p * levels - __builtin_convertvector(code, lanes)) <= 1e-3f);
            broken |= code > 255;
            *(bytes *)(codes + x) = in_bytes(code);
        }
        for (; x < job->width; x++) {
            kept[x] = luma[x];
            sum += out[x] = __builtin_fabsf(luma[x] - before[x]);
            int code = (int)(out[x] * levels + 0.5f);
            broken[0] |= !(__builtin_fabsf(out[x] * levels - code) <= 1e-3f) | (code > 255);
            if (job->levels) codes[x] = (uint8_t)code;
        }
        job->totals[y] = sum + total(sums);
    }
    if (any_of(broken)) job->whole = 0;
}

#define STAGES 3 /* in which the inhibition is summed, until nothing is left of E */
#define VECTORS 3
#define STRIP (VECTORS * LANES) /* columns that are worked on at once */
#define PAIR (2 * STRIP)        /* sum and difference of what lies left and right */

int strip(void) { return STRIP; }

/* Kernel values at one offset (dx, dy) and its mirror images. */
struct tap { float even, across, down; };

/* Kernel values of one age and one dy: at dx, dx + 1, ... */
struct group { int age, dy, dx, count; };

struct sums {
    const float *photoreceptors[AGES]; /* at pixel (0, 0), with zeros around the frame */
    ptrdiff_t stride;
    float *outputs[OUTPUTS]; /* NULL where it is not wanted */
    ptrdiff_t output_stride; /* whole strips */
    char *live;              /* see presynaptic.h; NULL if the layers are wanted */
    const struct group *groups;
    const struct tap *taps;
    int groups_of_excitation, groups_of_inhibition[STAGES];
    int ages[STAGES]; /* of the inhibition */
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

/* Sum some groups of taps over one row of a strip, and go on to the next ones. */
HELD void add_up(const struct group **next, int groups, const struct tap **next_tap,
                 const struct folded *at, int y, int directional, lanes *even, lanes *across,
                 lanes *down)
{
    const struct group *group = *next;
    const struct tap *tap = *next_tap;
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
    *next = group;
    *next_tap = tap;
}

HELD int some_left(const struct sums *job, const lanes *e, const lanes *i, const lanes *across,
                   const lanes *down)
{
    mask any = {0};
    for (int k = 0; k < VECTORS; k++) any |= left(job->diagonal, e[k], i[k], across[k], down[k]);
    return any_of(any);
}

/* Compute the maps of rows first to last - 1. `scratch` holds the folded rows; it is made
 * of zeros, and for one job. */
void sums(const struct sums *job, int first, int last, float *scratch)
{
    struct folded rows = {.mask = job->slots - 1};
    for (int age = 0; age < AGES; age++) {
        rows.rows[age] = scratch;
        rows.size[age] = (job->reach[age] + 1) * PAIR;
        scratch += rows.size[age] * job->slots;
    }
    for (int x = 0; x < job->width; x += STRIP) {
        for (int age = 0; age < AGES; age++) rows.next[age] = first - job->reach[age];
        for (int y = first; y < last; y++) {
            lanes e[VECTORS] = {0}, i[VECTORS] = {0}, across[VECTORS] = {0}, down[VECTORS] = {0};
            const struct group *group = job->groups;
            const struct tap *tap = job->taps;
            if (y + ROWS_AHEAD < last)
                fetch_ahead(job->outputs, job->output_stride, job->live, y, x, STRIP);
            fold_around(job, &rows, 0, y, x);
            add_up(&group, job->groups_of_excitation, &tap, &rows, y, 0, e, e, e);
            int wanted = !job->live || some_left(job, e, i, across, down);
            for (int n = 0; wanted && n < STAGES; n++) {
                fold_around(job, &rows, job->ages[n], y, x);
                add_up(&group, job->groups_of_inhibition[n], &tap, &rows, y, 1, i, across, down);
                wanted = !job->live || some_left(job, e, i, across, down);
            }
            if (!wanted) {
                put_none(job->outputs, job->output_stride, job->live, y, x, STRIP);
                continue;
            }
#pragma GCC unroll 8
            for (int k = 0; k < VECTORS; k++)
                put_all(job->outputs, y * job->output_stride + x + LANES * k, job->diagonal, e[k],
                        i[k], across[k], down[k]);
            put_some(job->outputs, job->output_stride, job->live, y, x, STRIP, job->width);
        }
    }
}
