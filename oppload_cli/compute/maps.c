/* Grouping, pooling, opponent products, and motion at an edge: compute/loops.py.
 *
 * S is 0 at most pixels of most videos: vectors of zeros are passed over.
 */
#if defined(__x86_64__)
#include <cpuid.h>
#endif

#include "vectors.h"

/* INTERFACE in compute/loops.py must be the same number. Add 1 when a signature changes. */
int interface(void) { return 13; }

/* Return whether the build for wide vectors runs here: whether the processor has AVX2 and FMA, and
 * the operating system saves the wide registers. The compilers' function for this test needs a
 * library that some systems lack. */
int runs_wide(void)
{
#if defined(__x86_64__)
    unsigned a, b, c, d;
    unsigned kept, high;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_FMA) || !(c & bit_OSXSAVE)) return 0;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    if ((kept & 6) != 6) return 0;
    return __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2) != 0;
#else
    return 0;
#endif
}

/* Load a vector of a row from column x on; outside the row the values are 0. */
INLINE lanes load_within(const float *row, int x, int width)
{
    lanes values = {0};
    if (x >= 0 && x + LANES <= width) return LOAD(row + x);
    for (int n = 0; n < LANES; n++)
        if (x + n >= 0 && x + n < width) values[n] = row[x + n];
    return values;
}

/* Compute G of rows first to last - 1: S times its sum over a square, 0 below the threshold,
 * at most the limit. `totals` takes the sums of S and of G along each row. */
void group(const float *s, int height, int width, int side, float threshold, float limit,
           float *g, double *totals, int first, int last)
{
    const int before = (side - 1) / 2; /* the anchor of MATLAB's conv2(..., 'same') */
    for (int y = first; y < last; y++) {
        const int top = y < before ? 0 : y - before;
        const int bottom = y - before + side > height ? height : y - before + side;
        const float *row = s + (ptrdiff_t)y * width;
        doubles of_s = {0}, of_g = {0};
        for (int x = 0; x < width; x += LANES) {
            lanes here = load_within(row, x, width), grouped = {0};
            if (any_of(here > 0)) {
                lanes sum = {0};
                for (int r = top; r < bottom; r++)
                    for (int dx = 0; dx < side; dx++)
                        sum += load_within(s + (ptrdiff_t)r * width, x + dx - before, width);
                grouped = here * sum;
                mask kept = grouped >= threshold;
                grouped = least((lanes)((mask)grouped & kept), (lanes){0} + limit);
                of_s += in_double(here);
                of_g += in_double(grouped);
            }
            store_some(g + (ptrdiff_t)y * width + x, grouped, width - x);
        }
        totals[2 * y] = total(of_s);
        totals[2 * y + 1] = total(of_g);
    }
}

#define TOGETHER LANES /* rows of a map that are weighted together */

/* Add the weighted sums of `count` rows of a map, from row y on, to the rows first to last - 1 of
 * `half`. Return whether a value of these rows of the map is not 0. */
INLINE int weigh_rows(const float *map, int width, int y, int count, const float *down, int height,
                      int first, int last, float *half)
{
    const float *from = map + (ptrdiff_t)y * width;
    int weighed = 0;
    for (int x = 0; x < width; x += LANES) {
        lanes values[TOGETHER];
        mask some = {0};
        for (int k = 0; k < count; k++) {
            values[k] = width - x >= LANES ? LOAD(from + (ptrdiff_t)k * width + x)
                                           : load_some(from + (ptrdiff_t)k * width + x, width - x);
            some |= values[k] != 0;
        }
        if (!any_of(some)) continue;
        weighed = 1;
        for (int r = first; r < last; r++) {
            const float *weights = down + (ptrdiff_t)r * height + y;
            float *to = half + (ptrdiff_t)r * width + x;
            lanes sum = {0};
            for (int k = 0; k < count; k++) sum += weights[k] * values[k];
            if (width - x >= LANES)
                STORE(to, LOAD(to) + sum);
            else
                store_some(to, load_some(to, width - x) + sum, width - x);
        }
    }
    return weighed;
}

/* Compute down * map * across', the weighted sums of a map about each cell.
 *
 * `down` has the shape rows x height and `across` columns x width; `half` has room for rows x width
 * values. */
void pool(const float *map, int height, int width, const float *down, int rows,
          const float *across, int columns, float *half, float *out)
{
    char weighed[rows]; /* the rows of `half` that may be other than 0 */
    memset(weighed, 0, (size_t)rows);
    memset(half, 0, (size_t)rows * (size_t)width * sizeof(float));
    memset(out, 0, (size_t)rows * (size_t)columns * sizeof(float));
    for (int y = 0; y < height; y += TOGETHER) {
        const int count = height - y < TOGETHER ? height - y : TOGETHER;
        int first = rows, last = 0;
        for (int r = 0; r < rows; r++)
            if (any_of(load_some(down + (ptrdiff_t)r * height + y, count) != 0)) {
                first = r < first ? r : first;
                last = r + 1;
            }
        if (count == TOGETHER ? weigh_rows(map, width, y, TOGETHER, down, height, first, last, half)
                              : weigh_rows(map, width, y, count, down, height, first, last, half))
            memset(weighed + first, 1, (size_t)(last > first ? last - first : 0));
    }
    for (int c = 0; c < columns; c++) {
        const float *weight = across + (ptrdiff_t)c * width;
        int first = 0, last = width;
        while (first + LANES < last && !any_of(LOAD(weight + first) != 0)) first += LANES;
        while (last - LANES > first && !any_of(LOAD(weight + last - LANES) != 0)) last -= LANES;
        for (int r = 0; r < rows; r++) {
            if (!weighed[r]) continue;
            const float *from = half + (ptrdiff_t)r * width;
            lanes sums = {0};
            int x = first;
            for (; x + LANES <= last; x += LANES) sums += LOAD(weight + x) * LOAD(from + x);
            float sum = sum_of(sums);
            for (; x < last; x++) sum += weight[x] * from[x];
            out[r * columns + c] = sum;
        }
    }
}

/* Add up weight(u) * passing(c + u) * opposite(c - u) over the offsets u, at each cell c.
 *
 * `weights` holds (2 reach + 1) x (2 reach + 1) values. The maps have rows of `stride` values, of
 * which `columns` are cells; after them come at least LANES - 1 zeros, so that a product beyond the
 * frame, on either side, is 0. */
void opponent_products(const float *passing, const float *opposite, int rows, int columns,
                       int stride, const float *weights, int reach, float *out)
{
    const int most_down = reach < rows ? reach : rows;
    const int most_across = reach < columns ? reach : columns;
    memset(out, 0, (size_t)rows * (size_t)stride * sizeof(float));
    for (int dy = -most_down; dy <= most_down; dy++)
        for (int dx = -most_across; dx <= most_across; dx++) {
            const float weight = weights[(reach + dy) * (2 * reach + 1) + reach + dx];
            const int margin = dx < 0 ? -dx : dx, edge = dy < 0 ? -dy : dy;
            if (weight == 0) continue;
            for (int y = edge; y < rows - edge; y++) {
                const float *ahead = passing + (y + dy) * stride + dx;
                const float *behind = opposite + (y - dy) * stride - dx;
                float *sums = out + y * stride;
                for (int x = margin; x < columns - margin; x += LANES)
                    STORE(sums + x, LOAD(sums + x) + weight * (LOAD(ahead + x) * LOAD(behind + x)));
            }
        }
}
