/* Luminance of codes of 8 bits: oppload_cli/video/luminance.py. */
#include "vectors.h"

HELD lanes of_codes(const unsigned char *codes, float black, float levels)
{
    lanes level = __builtin_convertvector(of_bytes(codes), lanes) - black;
    return least(most(level, (lanes){0}), (lanes){0} + levels) / levels;
}

/* Bring codes from black to white to 0 to 1; those beyond are as much as these. */
void luminance(const unsigned char *codes, ptrdiff_t stride, int rows, int columns, int black,
               int white, float *out)
{
    const float levels = (float)(white - black);
    for (int y = 0; y < rows; y++, codes += stride, out += columns) {
        int x = 0;
        for (; x + LANES <= columns; x += LANES)
            STORE(out + x, of_codes(codes + x, (float)black, levels));
        for (; x < columns; x++) {
            const unsigned char one[LANES] = {codes[x]};
            out[x] = of_codes(one, (float)black, levels)[0];
        }
    }
}
