/* The inner loops of the models, for the compiler's vectors.
 *
 * Each function does what a module of oppload_cli/models does with OpenCV and NumPy,
 * and is held to the same literal reference by the same tests. All maps are float32,
 * row after row; a stride is the distance between two rows, in values.
 */
#include <stddef.h>
#include <string.h>

#define LANES 8
typedef float lanes __attribute__((vector_size(4 * LANES), aligned(4)));
typedef float half __attribute__((vector_size(2 * LANES), aligned(4)));
typedef double doubles __attribute__((vector_size(4 * LANES)));
#define LOAD(at) (*(const lanes *)(at))
#define STORE(at, value) (*(lanes *)(at) = (value))
#define HELD static inline __attribute__((always_inline))

/* Keep a value in its register: the compiler would load it twice instead. */
#if defined(__AVX2__)
#include <immintrin.h>
#define KEEP(value) __asm__("" : "+x"(value))
#else
#define KEEP(value)
#endif

/* What is agreed on with oppload_cli/native/library.py: one more with each change of it. */
int interface(void) { return 2; }

/* Tell whether the wider build of this file runs here. */
int runs_wide(void)
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
    return 0;
#endif
}

typedef int mask __attribute__((vector_size(4 * LANES)));
HELD lanes where(mask chosen, lanes a, lanes b)
{
    return (lanes)((chosen & (mask)a) | (~chosen & (mask)b));
}
#if defined(__AVX2__) /* one instruction, which the compiler does not find by itself */
HELD lanes least(lanes a, lanes b) { return (lanes)_mm256_min_ps((__m256)a, (__m256)b); }
HELD lanes most(lanes a, lanes b) { return (lanes)_mm256_max_ps((__m256)a, (__m256)b); }
#else
HELD lanes least(lanes a, lanes b) { return where(a < b, a, b); }
HELD lanes most(lanes a, lanes b) { return where(a > b, a, b); }
#endif

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

/* ---- P: oppload_cli/models/direct.py ---- */

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

/* ---- E, I, J and S: oppload_cli/models/direct.py ---- */

#define VECTORS 3
#define STRIP (VECTORS * LANES) /* columns that are worked on at once */
#define PAIR (2 * STRIP)        /* sum and difference of what lies left and right */
#define ROWS_AHEAD 4            /* a strip runs down the frame: nothing else fetches it early */
#define AGES 3                  /* P(t), P(t-1), P(t-2) */
enum { S, S_ONE, S_OTHER, S_ONE_OPPOSITE, S_OTHER_OPPOSITE, E, I, J_ONE, J_OTHER, OUTPUTS };

int strip(void) { return STRIP; }

/* Kernel values at one offset (dx, dy) and its mirror images. */
struct tap { float even, across, down; };
/* Those of one age and one dy: dx, dx + 1, ... */
struct group { int age, dy, dx, count; };

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

HELD void put(float *map, ptrdiff_t at, lanes value)
{
    if (map) STORE(map + at, value);
}

/* max(0, E - inhibition), at most E: where nothing changed, E is exactly 0. */
HELD lanes rectified(lanes excitation, lanes inhibition)
{
    return least(most(excitation - inhibition, (lanes){0}), excitation);
}

HELD int any_of(const lanes *values)
{
    mask any = {0};
    for (int k = 0; k < VECTORS; k++) any |= values[k] != 0;
    int found = 0;
    for (int n = 0; n < LANES; n++) found |= any[n];
    return found;
}

/* Put zeros into `count` values of every map of row y, from x on. */
HELD void clear(const struct sums *job, int y, int x, ptrdiff_t count)
{
    for (int n = 0; n < OUTPUTS; n++)
        if (job->outputs[n])
            memset(job->outputs[n] + y * job->output_stride + x, 0, (size_t)count * sizeof(float));
}

/* Compute the maps of rows first to last - 1. `scratch` holds the folded rows; it is made
 * of zeros, and for one job. */
void sums(const struct sums *job, int first, int last, float *scratch)
{
    struct folded at = {.mask = job->slots - 1};
    int excitation_taps = 0;
    for (int n = 0; n < job->groups_of_excitation; n++) excitation_taps += job->groups[n].count;
    for (int age = 0; age < AGES; age++) {
        at.rows[age] = scratch;
        at.size[age] = (job->reach[age] + 1) * PAIR;
        scratch += at.size[age] * job->slots;
    }
    for (int x = 0; x < job->width; x += STRIP) {
        for (int age = 0; age < AGES; age++) at.next[age] = first - job->reach[age];
        for (int y = first; y < last; y++) {
            lanes e[VECTORS] = {0}, i[VECTORS] = {0}, across[VECTORS] = {0}, down[VECTORS] = {0};
            fold_around(job, &at, 0, y, x);
            add_up(job->groups, job->groups_of_excitation, job->taps, &at, y, 0, e, e, e);
            if (!job->outputs[I] && !any_of(e)) { /* every S is 0 where E is, whatever inhibits */
                clear(job, y, x, STRIP);
                continue;
            }
            for (int age = 1; age < AGES; age++) fold_around(job, &at, age, y, x);
            add_up(job->groups + job->groups_of_excitation, job->groups_of_inhibition,
                   job->taps + excitation_taps, &at, y, 1, i, across, down);
#pragma GCC unroll 8
            for (int k = 0; k < VECTORS; k++) {
                ptrdiff_t here = y * job->output_stride + x + LANES * k;
                lanes one = job->diagonal ? down[k] + across[k] : across[k];
                lanes other = job->diagonal ? down[k] - across[k] : down[k];
                lanes half = 0.5f * i[k];
                put(job->outputs[S], here, rectified(e[k], i[k]));
                put(job->outputs[S_ONE], here, rectified(e[k], half + one));
                put(job->outputs[S_OTHER], here, rectified(e[k], half + other));
                put(job->outputs[S_ONE_OPPOSITE], here, rectified(e[k], half - one));
                put(job->outputs[S_OTHER_OPPOSITE], here, rectified(e[k], half - other));
                put(job->outputs[E], here, e[k]);
                put(job->outputs[I], here, i[k]);
                put(job->outputs[J_ONE], here, one);
                put(job->outputs[J_OTHER], here, other);
            }
        }
    }
    /* Zeros beyond the frame, in the rest of the last strip. */
    for (int y = first; y < last; y++) clear(job, y, job->width, job->output_stride - job->width);
}

/* ---- Grouping of D-LGMD: oppload_cli/models/grouping.py ---- */

/* G of rows first to last - 1, and the sums of S and G along each row.
 *
 * `presynaptic` has zeros up to its stride, a multiple of LANES; `columns` has room
 * for it and `side` zeros on either side. */
void group(const float *presynaptic, float *grouped, ptrdiff_t stride, int height, int first,
           int last, int side, float threshold, float limit, float *columns, double *totals)
{
    int before = (side - 1) / 2; /* the anchor of MATLAB's conv2(..., 'same') */
    for (int y = first; y < last; y++) {
        int top = y - before < 0 ? 0 : y - before;
        int bottom = y - before + side > height ? height : y - before + side;
        for (ptrdiff_t x = 0; x < stride; x += LANES) {
            lanes sum = {0};
            for (int row = top; row < bottom; row++) sum += LOAD(presynaptic + row * stride + x);
            STORE(columns + side + x, sum);
        }
        doubles of_s = {0}, of_g = {0};
        for (ptrdiff_t x = 0; x < stride; x += LANES) {
            lanes sum = {0}, s = LOAD(presynaptic + y * stride + x);
            for (int dx = 0; dx < side; dx++) sum += LOAD(columns + side + x + dx - before);
            lanes g = s * sum;
            g = least(where(g >= threshold, g, (lanes){0}), (lanes){0} + limit);
            STORE(grouped + y * stride + x, g);
            of_s += in_double(presynaptic + y * stride + x);
            of_g += in_double(grouped + y * stride + x);
        }
        totals[2 * y] = total(of_s);
        totals[2 * y + 1] = total(of_g);
    }
}

/* ---- Pooling: oppload_cli/models/pooling.py ---- */

/* Halve a map with the binomial weights 1 4 6 4 1; beyond it are zeros.
 *
 * Sample (0, 0) of the half is centred `margin`, an even number of pixels, above and left
 * of pixel (0, 0). `line` has `width` zeros, room for twice the margin, the width and 16,
 * and for as much again. */
void halve(const float *restrict map, ptrdiff_t stride, int height, int width, int margin,
           float *restrict half, int half_height, int half_width, float *restrict line)
{
    const float *zeros = line;
    float *restrict sums = line + width + margin + 8, *restrict even = sums + width + margin + 8;
    float *restrict odd = even + half_width + 8;
    for (int y = 0; y < half_height; y++) {
        const float *rows[5];
        for (int k = 0; k < 5; k++) {
            int row = 2 * y - margin + k - 2;
            rows[k] = row < 0 || row >= height ? zeros : map + row * stride;
        }
        for (int x = 0; x < width; x++)
            sums[x] = (rows[0][x] + rows[4][x]) + 4 * (rows[1][x] + rows[3][x]) + 6 * rows[2][x];
        const float *from = sums - margin;
        for (int x = 0; x < half_width + 2; x++) {
            even[x] = from[2 * x - 2];
            odd[x] = from[2 * x - 1];
        }
        float *out = half + (ptrdiff_t)y * half_width;
        for (int x = 0; x < half_width; x++)
            out[x] = ((even[x] + even[x + 2]) + 4 * (odd[x] + odd[x + 1]) + 6 * even[x + 1])
                     * (1 / 256.f);
    }
}

/* Weighted sums along one side: sample first + n step - reach + k has weight k. */
struct line { const float *weights; int reach, first, step, count; };

/* Weigh a map down and across, once per cell; beyond it are zeros.
 *
 * `row` has `across->reach` zeros, room for `width`, and as many zeros again. */
void weigh(const float *restrict map, ptrdiff_t stride, int height, int width,
           const struct line *down, const struct line *across, float *restrict out,
           ptrdiff_t out_stride, float *restrict row)
{
    float *inside = row + across->reach;
    for (int r = 0; r < down->count; r++) {
        memset(inside, 0, (size_t)width * sizeof(float));
        for (int k = 0; k <= 2 * down->reach; k++) {
            int y = down->first + r * down->step - down->reach + k;
            if (y < 0 || y >= height) continue;
            const float weight = down->weights[k], *from = map + y * stride;
            for (int x = 0; x < width; x++) inside[x] += weight * from[x];
        }
        for (int c = 0; c < across->count; c++) {
            const float *from = row + across->first + c * across->step;
            int taps = 2 * across->reach + 1, k = 0;
            lanes sums = {0};
            for (; k + LANES <= taps; k += LANES)
                sums += LOAD(across->weights + k) * LOAD(from + k);
            float sum = 0;
            for (; k < taps; k++) sum += across->weights[k] * from[k];
            for (int n = 0; n < LANES; n++) sum += sums[n];
            out[r * out_stride + c] = sum;
        }
    }
}

/* ---- Opponent products: oppload_cli/models/pairs.py ---- */

/* Sum weights[n] * one(c + u_n) * other(c - u_n) at each unit c.
 *
 * `offsets` are those of u_n in values. `one` and `other` point at unit (0, 0) and have
 * zeros around the units, as far as the offsets reach and LANES more. */
void oppose(const float *one, const float *other, ptrdiff_t stride, int rows, int columns,
            const ptrdiff_t *offsets, const float *weights, int count, float *out,
            ptrdiff_t out_stride)
{
    for (int r = 0; r < rows; r++)
        for (int c = 0; c < columns; c += LANES) {
            const float *ahead = one + r * stride + c, *behind = other + r * stride + c;
            lanes sum = {0};
            for (int n = 0; n < count; n++)
                sum += weights[n] * (LOAD(ahead + offsets[n]) * LOAD(behind - offsets[n]));
            STORE(out + r * out_stride + c, sum);
        }
}
