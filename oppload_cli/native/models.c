/* The inner loops of the models behind the presynaptic sums.
 *
 * Each function does what a module of oppload_cli/models does with OpenCV and NumPy,
 * and is held to the same literal reference by the same tests.
 */
#include "vectors.h"

/* What is agreed on with oppload_cli/native/library.py: one more with each change of it. */
int interface(void) { return 3; }

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
