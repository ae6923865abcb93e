/* What the presynaptic sums have in common, in floats and in whole numbers. */
#pragma once
#include "vectors.h"

#define AGES 3 /* P(t), P(t-1), P(t-2) */
enum { S, S_ONE, S_OTHER, S_ONE_OPPOSITE, S_OTHER_OPPOSITE, E, I, J_ONE, J_OTHER, OUTPUTS };

/* Kernel values of one age and one dy: at dx, dx + 1, ... */
struct group { int age, dy, dx, count; };

/* Keep a value in its register: the compiler would load it twice instead. */
#if defined(__AVX2__)
#define KEEP(value) __asm__("" : "+x"(value))
#else
#define KEEP(value)
#endif

HELD void put(float *map, ptrdiff_t at, lanes value)
{
    if (map) STORE(map + at, value);
}

/* max(0, E - inhibition), at most E: where nothing changed, E is exactly 0. */
HELD lanes rectified(lanes excitation, lanes inhibition)
{
    return least(most(excitation - inhibition, (lanes){0}), excitation);
}

/* Put E, I, both J and every S, where they are wanted. */
HELD void put_all(float *const *outputs, ptrdiff_t here, int diagonal, lanes e, lanes i,
                  lanes across, lanes down)
{
    lanes one = diagonal ? down + across : across, other = diagonal ? down - across : down;
    lanes half = 0.5f * i;
    put(outputs[S], here, rectified(e, i));
    put(outputs[S_ONE], here, rectified(e, half + one));
    put(outputs[S_OTHER], here, rectified(e, half + other));
    put(outputs[S_ONE_OPPOSITE], here, rectified(e, half - one));
    put(outputs[S_OTHER_OPPOSITE], here, rectified(e, half - other));
    put(outputs[E], here, e);
    put(outputs[I], here, i);
    put(outputs[J_ONE], here, one);
    put(outputs[J_OTHER], here, other);
}

/* Put zeros into `count` values of every map of row y, from x on. */
HELD void clear(float *const *outputs, ptrdiff_t stride, int y, int x, ptrdiff_t count)
{
    for (int n = 0; n < OUTPUTS; n++)
        if (outputs[n]) memset(outputs[n] + y * stride + x, 0, (size_t)count * sizeof(float));
}

/* A strip runs down the frame: nothing else fetches what comes early enough. */
#define ROWS_AHEAD 4
HELD void fetch_ahead(float *const *outputs, ptrdiff_t stride, int y, int x, int width)
{
    for (int n = S; n < E; n++)
        if (outputs[n]) {
            const float *row = outputs[n] + (y + ROWS_AHEAD) * stride + x;
            for (int k = 0; k < width; k += 16) __builtin_prefetch(row + k, 1);
        }
}
