/* The inner loops of the models behind the presynaptic sums.
 *
 * Each function does what a module of oppload_cli/models does with OpenCV and NumPy,
 * and is held to the same literal reference by the same tests.
 */
#include "vectors.h"

/* What is agreed on with oppload_cli/native/library.py: one more with each change of it. */
int interface(void) { return 9; }

/* Tell whether the wider build of these files runs here. */
int runs_wide(void)
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
    return 0;
#endif
}

/* Where a map may have values other than 0: a byte for each LANES columns of a row, and the
 * distance of two rows. NULL: anywhere. */
struct live { const char *at; ptrdiff_t stride; };

/* Tell the same of some rows together, for `width` columns; return whether there may be any. */
HELD int alive_in(struct live live, int width, int top, int bottom, char *alive)
{
    int count = (width + LANES - 1) / LANES, some = !live.at;
    memset(alive, !live.at, (size_t)count);
    for (int y = top; live.at && y < bottom; y++)
        for (int n = 0; n < count; n++) some |= alive[n] |= live.at[y * live.stride + n];
    return some;
}

/* ---- Grouping of D-LGMD: oppload_cli/models/grouping.py ---- */

struct group {
    const float *presynaptic; /* S, with zeros up to its stride, a multiple of LANES */
    float *grouped;           /* takes G */
    ptrdiff_t stride;
    struct live live;
    int height, side;
    float threshold, limit;
    double *totals; /* take the sums of S and G along each row */
};

/* Group rows first to last - 1. `columns` has room for a row and `side` zeros on either side of
 * it, `alive` for a byte for each LANES of a row. */
void group(const struct group *job, int first, int last, float *columns, char *alive)
{
    const ptrdiff_t stride = job->stride;
    const int side = job->side, before = (side - 1) / 2; /* of MATLAB's conv2(..., 'same') */
    for (int y = first; y < last; y++) {
        const float *s_row = job->presynaptic + y * stride;
        float *g_row = job->grouped + y * stride;
        doubles of_s = {0}, of_g = {0};
        int top = y - before < 0 ? 0 : y - before;
        int bottom = y - before + side > job->height ? job->height : y - before + side;
        if (alive_in(job->live, (int)stride, top, bottom, alive))
            for (ptrdiff_t x = 0; x < stride; x += LANES) {
                lanes sum = {0};
                for (int row = top; alive[x / LANES] && row < bottom; row++)
                    sum += LOAD(job->presynaptic + row * stride + x);
                STORE(columns + side + x, sum);
            }
        for (ptrdiff_t x = 0; x < stride; x += LANES) {
            lanes sum = {0};
            /* G is 0 where S is. */
            if (job->live.at && !job->live.at[y * job->live.stride + x / LANES]) {
                STORE(g_row + x, sum);
                continue;
            }
            for (int dx = 0; dx < side; dx++) sum += LOAD(columns + side + x + dx - before);
            lanes g = LOAD(s_row + x) * sum;
            g = least(where(g >= job->threshold, g, (lanes){0}), (lanes){0} + job->limit);
            STORE(g_row + x, g);
            of_s += in_double(s_row + x);
            of_g += in_double(g_row + x);
        }
        job->totals[2 * y] = total(of_s);
        job->totals[2 * y + 1] = total(of_g);
    }
}

/* ---- Pooling: oppload_cli/models/pooling.py ---- */

/* A map of `height` rows of `width` values, `stride` apart. */
struct map { float *values; ptrdiff_t stride; int height, width; struct live live; };

/* Halve a map with the binomial weights 1 4 6 4 1; beyond it are zeros.
 *
 * Sample (0, 0) of the half is centred `margin`, an even number of pixels, above and left
 * of pixel (0, 0). `line` is made of zeros, and for maps of one size: `width` zeros, the
 * sums of a row with zeros about them, and their even and odd values. */
HELD void halve(const struct map *map, int margin, const struct map *half, float *restrict line)
{
    const int width = map->width, half_width = half->width;
    const float *zeros = line;
    float *restrict sums = line + width + margin + 8, *restrict even = sums + width + margin + 8;
    float *restrict odd = even + half_width + 8;
    char *restrict alive = (char *)(odd + half_width + 8);
    for (int y = 0; y < half->height; y++) {
        float *restrict out = half->values + y * half->stride;
        int first = 2 * y - margin - 2;
        int top = first < 0 ? 0 : first, bottom = first + 5 > map->height ? map->height : first + 5;
        if (top >= bottom || !alive_in(map->live, width, top, bottom, alive)) {
            memset(out, 0, (size_t)half_width * sizeof(float));
            continue;
        }
        const float *rows[5];
        for (int k = 0; k < 5; k++)
            rows[k] = first + k < top || first + k >= bottom
                          ? zeros : map->values + (first + k) * map->stride;
        int x = 0;
        for (; x + LANES <= width; x += LANES) {
            lanes sum = {0};
            if (alive[x / LANES])
                sum = (LOAD(rows[0] + x) + LOAD(rows[4] + x))
                      + 4 * (LOAD(rows[1] + x) + LOAD(rows[3] + x)) + 6 * LOAD(rows[2] + x);
            STORE(sums + x, sum);
        }
        for (; x < width; x++)
            sums[x] = (rows[0][x] + rows[4][x]) + 4 * (rows[1][x] + rows[3][x]) + 6 * rows[2][x];
        const float *from = sums - margin;
        for (x = 0; x < half_width + 2; x++) {
            even[x] = from[2 * x - 2];
            odd[x] = from[2 * x - 1];
        }
        for (x = 0; x < half_width; x++)
            out[x] = ((even[x] + even[x + 2]) + 4 * (odd[x] + odd[x + 1]) + 6 * even[x + 1])
                     * (1 / 256.f);
    }
}

/* Weighted sums along one side: sample first + n step - reach + k has weight k. */
struct line { const float *weights; int reach, first, step, count; };

#define AT_ONCE 4 /* vectors: none of their sums waits for another one */

/* Call with as many vectors as `left` values fill, but no more than are done at once. */
#define WITH_VECTORS(left, function, ...)                                                        \
    switch (((left) + LANES - 1) / LANES) {                                                      \
    case 1: function(__VA_ARGS__, 1); break;                                                     \
    case 2: function(__VA_ARGS__, 2); break;                                                     \
    case 3: function(__VA_ARGS__, 3); break;                                                     \
    default: function(__VA_ARGS__, AT_ONCE);                                                     \
    }

/* Weigh `count` rows from one on, `stride` apart. */
HELD void weigh_down(const float *weights, int count, const float *from, ptrdiff_t stride,
                     float *out, int vectors)
{
    lanes sums[AT_ONCE] = {0};
    for (int k = 0; k < count; k++)
#pragma GCC unroll 4
        for (int n = 0; n < vectors; n++)
            sums[n] += weights[k] * LOAD(from + k * stride + n * LANES);
    for (int n = 0; n < vectors; n++) STORE(out + n * LANES, sums[n]);
}

/* Weigh the samples about each of some cells side by side. Every `step`th sample stands in
 * one of as many lines, `length` apart. */
HELD void weigh_across(const struct line *line, const float *samples, int length, int cell,
                       float *out, int vectors)
{
    lanes sums[AT_ONCE] = {0};
    const float *begin = samples + line->first / line->step + cell;
    int which = line->first % line->step;
    for (int k = 0; k <= 2 * line->reach; k++) {
        const float *from = begin + which * length;
#pragma GCC unroll 4
        for (int n = 0; n < vectors; n++) sums[n] += line->weights[k] * LOAD(from + n * LANES);
        if (++which == line->step) {
            which = 0;
            begin++;
        }
    }
    int left = (line->count - cell) * (int)sizeof(float), size = vectors * (int)sizeof(lanes);
    memcpy(out + cell, sums, (size_t)(left < size ? left : size));
}

/* Weigh a map down and across, once per cell; beyond it are zeros.
 *
 * `row` is made of zeros: `across->reach` on either side of a row, and `AT_ONCE` vectors;
 * then room for as much again. */
HELD void weigh(const struct map *map, const struct line *down, const struct line *across,
                float *restrict out, ptrdiff_t out_stride, float *restrict row)
{
    const int width = map->width, step = across->step;
    const int length = (width + 2 * across->reach) / step + AT_ONCE * LANES;
    float *inside = row + across->reach, *samples = row + length * step;
    for (int r = 0; r < down->count; r++, out += out_stride) {
        int first = down->first + r * down->step - down->reach;
        int top = first < 0 ? 0 : first, bottom = first + 2 * down->reach + 1;
        if (bottom > map->height) bottom = map->height;
        const float *weights = down->weights + top - first;
        const float *from = map->values + top * map->stride;
        const int count = bottom - top;
        const int in_vectors = width / LANES * LANES;
        for (int x = 0; x < in_vectors; x += AT_ONCE * LANES)
            WITH_VECTORS(in_vectors - x, weigh_down, weights, count, from + x, map->stride, inside + x)
        for (int x = in_vectors; x < width; x++) {
            inside[x] = 0;
            for (int k = 0; k < count; k++) inside[x] += weights[k] * from[k * map->stride + x];
        }
        for (int which = 0; which < step; which++)
            for (int n = 0; n < length; n++) samples[which * length + n] = row[n * step + which];
        for (int c = 0; c < across->count; c += AT_ONCE * LANES)
            WITH_VECTORS(across->count - c, weigh_across, across, samples, length, c, out)
    }
}

struct pooling {
    const struct map *maps; /* what is pooled, and its halves */
    int halvings, margin;
    float *lines; /* of halve, for each halving */
    ptrdiff_t line_stride;
    struct line down, across;
    float *row; /* of weigh */
    float *out;
    ptrdiff_t out_stride;
};

/* Halve a map as often as is wanted, and weigh what is left. */
void pool(const struct pooling *job)
{
    for (int n = 0; n < job->halvings; n++)
        halve(&job->maps[n], n ? 0 : job->margin, &job->maps[n + 1], job->lines + n * job->line_stride);
    weigh(&job->maps[job->halvings], &job->down, &job->across, job->out, job->out_stride, job->row);
}

/* ---- Opponent products: oppload_cli/models/pairs.py ---- */

/* Sum the products at some units side by side. */
HELD void oppose_at(const float *ahead, const float *behind, const ptrdiff_t *offsets,
                    const float *weights, int count, float *out, int vectors)
{
    lanes sums[AT_ONCE] = {0};
    for (int n = 0; n < count; n++)
#pragma GCC unroll 4
        for (int k = 0; k < vectors; k++)
            sums[k] += weights[n] * (LOAD(ahead + offsets[n] + k * LANES)
                                     * LOAD(behind - offsets[n] + k * LANES));
    for (int k = 0; k < vectors; k++) STORE(out + k * LANES, sums[k]);
}

/* Sum weights[n] * one(c + u_n) * other(c - u_n) at each unit c.
 *
 * `offsets` are those of u_n in values. `one` and `other` point at unit (0, 0) and have
 * zeros around the units, as far as the offsets reach and LANES more. */
void oppose(const float *one, const float *other, ptrdiff_t stride, int rows, int columns,
            const ptrdiff_t *offsets, const float *weights, int count, float *out,
            ptrdiff_t out_stride)
{
    for (int r = 0; r < rows; r++, one += stride, other += stride, out += out_stride)
        for (int c = 0; c < columns; c += AT_ONCE * LANES)
            WITH_VECTORS(columns - c, oppose_at, one + c, other + c, offsets, weights, count, out + c)
}
