/* The steps before and after the search for optical flow: compute/loops.py.
 *
 * Rounding and order of sums are OpenCV's, so that the results have the same bits.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "vectors.h"

/* Average squares of `side` pixels, 2 or 4, into `rows` rows of `columns`. `line` has room
 * for the sums along the columns of one row of squares. */
void reduce(const uint8_t *restrict frame, ptrdiff_t stride, int side, int rows, int columns,
            uint8_t *restrict out, uint16_t *restrict line)
{
    for (int y = 0; y < rows; y++, frame += side * stride, out += columns) {
        for (int x = 0; x < side * columns; x++) line[x] = frame[x];
        for (int k = 1; k < side; k++)
            for (int x = 0; x < side * columns; x++) line[x] += frame[k * stride + x];
        if (side == 2)
            for (int x = 0; x < columns; x++)
                out[x] = (uint8_t)((line[2 * x] + line[2 * x + 1] + 2) >> 2);
        else
            for (int x = 0; x < columns; x++) {
                int sum = line[4 * x] + line[4 * x + 1] + line[4 * x + 2] + line[4 * x + 3];
                out[x] = (uint8_t)((sum + 7 + (sum >> 4 & 1)) >> 4); /* halves to even */
            }
    }
}

/* The weight of a sample in the mean of a cell. */
struct share { int cell, sample; float weight; };

/* Compute the weights of samples in fewer cells; return the number of weights other than 0. */
static int shares_of(int samples, int cells, struct share *out)
{
    const struct share *begin = out;
    double size = (double)samples / cells;
    for (int cell = 0; cell < cells; cell++) {
        double from = cell * size, to = from + size;
        double width = fmin(size, samples - from);
        int last = (int)floor(to) < samples - 1 ? (int)floor(to) : samples - 1;
        int first = (int)ceil(from) < last ? (int)ceil(from) : last;
        if (first - from > 1e-3)
            *out++ = (struct share){cell, first - 1, (float)((first - from) / width)};
        for (int sample = first; sample < last; sample++)
            *out++ = (struct share){cell, sample, (float)(1 / width)};
        if (to - last > 1e-3)
            *out++ = (struct share){cell, last, (float)(fmin(fmin(to - last, 1), width) / width)};
    }
    return (int)(out - begin);
}

typedef float quad __attribute__((vector_size(16), aligned(4))); /* x, y, change and nothing */

/* Average flow and change over a grid of cells, and keep the vectors that move and change enough.
 *
 * `before` and `now` are reduced frames of rows x columns samples, `flow` is the motion of each
 * sample (x, y) between them; `left` and `top` are the place of the first sample in pixels.
 * `shares` has room for 2 (rows + columns + cell_rows + cell_columns) values, `means` for
 * 2 cell_columns. Return the number of vectors that are kept. */
int sample(const uint8_t *before, const uint8_t *now, const float *flow, int rows, int columns,
           int cell_rows, int cell_columns, int reduction, double left, double top,
           double minimum_speed, double minimum_change, double *starts, double *vectors,
           struct share *shares, quad *means)
{
    const double height = rows * reduction, width = columns * reduction;
    struct share *down = shares;
    const int count_down = shares_of(rows, cell_rows, down);
    struct share *across = down + count_down;
    const int count_across = shares_of(columns, cell_columns, across);
    quad *row = means, *sums = row + cell_columns;
    int kept = 0;
    for (int n = 0; n < count_down; n++) {
        int first = n == 0 || down[n].cell != down[n - 1].cell;
        int last = n == count_down - 1 || down[n].cell != down[n + 1].cell;
        const ptrdiff_t at = (ptrdiff_t)down[n].sample * columns;
        memset(row, 0, (size_t)cell_columns * sizeof *row);
        for (int k = 0; k < count_across; k++) {
            ptrdiff_t here = at + across[k].sample;
            float change = (float)abs(now[here] - before[here]);
            quad share = (quad){flow[2 * here], flow[2 * here + 1], change} * across[k].weight;
            KEEP(share);
            row[across[k].cell] += share;
        }
        for (int c = 0; c < cell_columns; c++) {
            quad share = row[c] * down[n].weight;
            KEEP(share);
            sums[c] = first ? share : sums[c] + share;
            double x = (double)sums[c][0] * reduction, y = (double)sums[c][1] * reduction;
            if (!last || sums[c][2] < minimum_change || !(hypot(x, y) >= minimum_speed)) continue;
            starts[2 * kept] = (c + 0.5) * width / cell_columns - 0.5 + left;
            starts[2 * kept + 1] = (down[n].cell + 0.5) * height / cell_rows - 0.5 + top;
            vectors[2 * kept] = x;
            vectors[2 * kept + 1] = y;
            kept++;
        }
    }
    return kept;
}
