/* What the presynaptic sums have in common, in floats and in whole numbers. */
#pragma once
#include "vectors.h"

#define AGES 3 /* P(t), P(t-1), P(t-2) */
enum { S, S_ONE, S_OTHER, S_ONE_OPPOSITE, S_OTHER_OPPOSITE, E, I, J_ONE, J_OTHER, OUTPUTS };

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

/* Tell whether any S would be above 0 with so much of the inhibition. No kernel value is
 * below 0: what is left alone then could only take more away. */
HELD mask left(int diagonal, lanes e, lanes i, lanes across, lanes down)
{
    lanes one = diagonal ? down + across : across, other = diagonal ? down - across : down;
    return e + most(magnitude(one), magnitude(other)) > 0.5f * i;
}

/* `live` holds a byte for each LANES values of a map: 0 where every S is; NULL if it is not
 * wanted. Say that every S of a strip is 0, and put zeros where there are none yet. */
HELD void put_none(float *const *outputs, ptrdiff_t stride, char *live, int y, int x, int strip)
{
    for (ptrdiff_t at = y * stride + x; strip > 0; at += LANES, strip -= LANES) {
        if (!live[at / LANES]) continue;
        for (int n = S; n < E; n++)
            if (outputs[n]) STORE(outputs[n] + at, (lanes){0});
        live[at / LANES] = 0;
    }
}

/* Say that a strip has been put, and put zeros into what of it lies beyond the frame. */
HELD void put_some(float *const *outputs, ptrdiff_t stride, char *live, int y, int x, int strip,
                   int width)
{
    if (live) memset(live + (y * stride + x) / LANES, 1, (size_t)strip / LANES);
    for (int n = S; x + strip > width && n < OUTPUTS; n++)
        if (outputs[n])
            memset(outputs[n] + y * stride + width, 0, (size_t)(x + strip - width) * sizeof(float));
}

/* A strip runs down the frame: nothing else fetches what comes early enough. What a row of
 * the frame before held is the best guess of what is written now. */
#define ROWS_AHEAD 4
HELD void fetch_ahead(float *const *outputs, ptrdiff_t stride, const char *live, int y, int x,
                      int width)
{
    ptrdiff_t at = (y + ROWS_AHEAD) * stride + x;
    if (live && !live[at / LANES]) return;
    for (int n = S; n < E; n++)
        for (int k = 0; outputs[n] && k < width; k += 16)
            __builtin_prefetch(outputs[n] + at + k, 1);
}
