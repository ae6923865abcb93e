/* Radial motion opponency over all pairs of vectors: compute/loops.py. */
#include <math.h>
#if defined(__AVX__)
#include <immintrin.h>
#define LANES 4
#else
#define LANES 2
#endif

typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8)));
typedef long long mask __attribute__((vector_size(8 * LANES)));
#define LOAD(at) (*(const lanes *)(at))
#define INLINE static inline __attribute__((always_inline))

INLINE lanes kept(mask chosen, lanes values) { return (lanes)(chosen & (mask)values); }
INLINE lanes least(lanes a, lanes b)
{
    mask less = a < b;
    return (lanes)((less & (mask)a) | (~less & (mask)b));
}
INLINE lanes magnitude(lanes a) { return (lanes)((mask)a & 0x7fffffffffffffffLL); }

INLINE double total(lanes values)
{
    double sum = 0;
    for (int k = 0; k < LANES; k++) sum += values[k];
    return sum;
}

INLINE int any_of(mask chosen)
{
#if defined(__AVX__)
    return _mm256_movemask_pd((__m256d)chosen);
#else
    long long any = 0;
    for (int k = 0; k < LANES; k++) any |= chosen[k];
    return any != 0;
#endif
}

/* Sum RMO over the pairs of n vectors (x, y) with their starts. Vectors of length 0 are left out.
 * `rows` has room for 5 (n + LANES) values. `out` is filled with the number of vectors that are not
 * 0; the sums of RMO of the opposite, the outward and the inward pairs; the largest RMO of an
 * outward pair; and the number of outward pairs. */
void rmo_sums(const double *vectors, const double *starts, int n, double opposite_tangent,
              double outward_tangent, double sides, double *rows, double *out)
{
    const int room = n + LANES;
    double *unit_x = rows, *unit_y = unit_x + room, *speed = unit_y + room;
    double *start_x = speed + room, *start_y = start_x + room;
    int count = 0;
    for (int i = 0; i < n; i++) {
        speed[count] = hypot(vectors[2 * i], vectors[2 * i + 1]);
        unit_x[count] = vectors[2 * i] / speed[count];
        unit_y[count] = vectors[2 * i + 1] / speed[count];
        start_x[count] = starts[2 * i];
        start_y[count] = starts[2 * i + 1];
        count += speed[count] > 0;
    }
    /* Zeros fill the last vector: a zero vector is in no opposite pair. */
    for (int k = 0; k < LANES; k++)
        unit_x[count + k] = unit_y[count + k] = speed[count + k] = start_x[count + k] =
            start_y[count + k] = 0;
    lanes opposite = {0}, outward = {0}, inward = {0}, largest = {0};
    long long pairs = 0;
    for (int i = 0; i < count; i++) {
        lanes x = (lanes){0} + unit_x[i], y = (lanes){0} + unit_y[i], speed_1 = (lanes){0} + speed[i];
        for (int j = i + 1; j < count; j += LANES) {
            lanes x2 = LOAD(unit_x + j), y2 = LOAD(unit_y + j);
            lanes minus_cosine = -(x * x2 + y * y2), sine = magnitude(x * y2 - y * x2);
            mask are_opposite = minus_cosine * opposite_tangent > sine;
            if (!any_of(are_opposite)) continue;
            /* The line of a pair, and the distance of its starts along and across this line. */
            lanes line_x = x - x2, line_y = y - y2;
            lanes between_x = start_x[i] - LOAD(start_x + j);
            lanes between_y = start_y[i] - LOAD(start_y + j);
            lanes along = (line_x * between_x + line_y * between_y) * outward_tangent;
            lanes across = magnitude(line_x * between_y - line_y * between_x);
            lanes speed_2 = LOAD(speed + j);
            lanes rmo = kept(are_opposite, least(speed_1, speed_2) * sides / (speed_1 + speed_2));
            mask are_outward = are_opposite & (along > across);
            lanes of_outward = kept(are_outward, rmo);
            opposite += rmo;
            outward += of_outward;
            inward += kept(-along > across, rmo);
            largest = -least(-largest, -of_outward);
            for (int k = 0; k < LANES; k++) pairs -= are_outward[k];
        }
    }
    double most = 0;
    for (int k = 0; k < LANES; k++) most = fmax(most, largest[k]);
    const double sums[] = {count, total(opposite), total(outward), total(inward), most,
                           (double)pairs};
    for (int k = 0; k < 6; k++) out[k] = sums[k];
}
