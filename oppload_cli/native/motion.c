/* Radial motion opponency over all pairs of vectors: oppload_cli/motion/rmo.py. */
#include <math.h>

#define LANES 4
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long mask __attribute__((vector_size(8 * LANES)));
#define LOAD(at) (*(const lanes *)(at))
#define HELD static inline __attribute__((always_inline))

HELD lanes kept(mask chosen, lanes values) { return (lanes)(chosen & (mask)values); }
HELD lanes least(lanes a, lanes b)
{
    mask less = a < b;
    return (lanes)((less & (mask)a) | (~less & (mask)b));
}
HELD lanes magnitude(lanes a) { return (lanes)((mask)a & 0x7fffffffffffffffLL); }

HELD double total(lanes values)
{
    double sum = 0;
    for (int k = 0; k < LANES; k++) sum += values[k];
    return sum;
}

/* Unit vectors, speeds above 0 and starts of n vectors, each with LANES values to spare. */
struct moving { const double *unit_x, *unit_y, *speed, *start_x, *start_y; int n; };
struct opponency { double opposite, outward, inward, largest, outward_pairs; };

/* Sum RMO over the pairs; the tolerances are given by their tangents. */
void opponency(const struct moving *m, double opposite_tangent, double outward_tangent,
               double sides, struct opponency *out)
{
    lanes opposite = {0}, outward = {0}, inward = {0}, largest = {0};
    long long pairs = 0;
    mask numbers;
    for (int k = 0; k < LANES; k++) numbers[k] = k;
    for (int i = 0; i < m->n; i++) {
        lanes x = (lanes){0} + m->unit_x[i], y = (lanes){0} + m->unit_y[i];
        for (int j = i + 1; j < m->n; j += LANES) {
            lanes x2 = LOAD(m->unit_x + j), y2 = LOAD(m->unit_y + j);
            lanes against = -(x * x2 + y * y2), aside = magnitude(x * y2 - y * x2);
            mask are_opposite = (against * opposite_tangent > aside) & (numbers < m->n - j);
            long long any = 0;
            for (int k = 0; k < LANES; k++) any |= are_opposite[k];
            if (!any) continue;
            /* The line that they share, and how the starts lie along and across it. */
            lanes line_x = x - x2, line_y = y - y2;
            lanes apart_x = m->start_x[i] - LOAD(m->start_x + j);
            lanes apart_y = m->start_y[i] - LOAD(m->start_y + j);
            lanes along = (line_x * apart_x + line_y * apart_y) * outward_tangent;
            lanes across = magnitude(line_x * apart_y - line_y * apart_x);
            lanes speed = (lanes){0} + m->speed[i], speed2 = LOAD(m->speed + j);
            lanes value = kept(are_opposite, least(speed, speed2) * sides / (speed + speed2));
            mask are_outward = are_opposite & (along > across);
            lanes of_outward = kept(are_outward, value);
            opposite += value;
            outward += of_outward;
            inward += kept(-along > across, value);
            largest = -least(-largest, -of_outward);
            for (int k = 0; k < LANES; k++) pairs -= are_outward[k];
        }
    }
    *out = (struct opponency){.opposite = total(opposite), .outward = total(outward),
                              .inward = total(inward), .outward_pairs = (double)pairs};
    for (int k = 0; k < LANES; k++) out->largest = fmax(out->largest, largest[k]);
}
