/* The presynaptic sums of frames of 8 bits, in whole numbers: oppload_cli/models/whole.py.
 *
 * There P times the code levels of luminance is a whole number, and 16 bits hold the sum of
 * four: one instruction multiplies twice as many pixels as with floats. The kernels are
 * rounded to 16 bits; all else is exact.
 */
#include "presynaptic.h"

#if !defined(__AVX2__)
int whole_strip(void) { return 0; } /* then floats are as fast */
void whole_sums(void) {}
#else
#include "screening.h"

#define STRIP 16         /* columns that are worked on at once: half of those screened */
#define PAIR (4 * STRIP) /* of two dx side by side: the sums, then the differences */
#define MOST 4           /* pairs of a group */

int whole_strip(void) { return STRIP; }

/* Kernel values at (dx, dy) and (dx + 1, dy). */
struct pair { int16_t even[2], across[2], down[2]; };

/* Groups of pairs: those of a group stand side by side, and have their dy in common. */
struct kernel {
    const struct pair *pairs;
    const int32_t *rows; /* by slot and group: where the folded rows above and below begin */
    int of_count[MOST];  /* how many groups have 1, 2, ... pairs; those of most come first */
    int groups;
};

struct whole_sums {
    const uint8_t *photoreceptors[AGES]; /* at pixel (0, 0), with zeros around the frame */
    ptrdiff_t stride;
    float *outputs[OUTPUTS]; /* those of S alone; NULL where it is not wanted */
    ptrdiff_t output_stride; /* whole strips */
    char *live;              /* see presynaptic.h */
    struct screening screening;
    struct kernel kernels[AGES];
    int first_dx[AGES]; /* of the pairs in a folded row: -1, which has no weight, or 0 */
    int pairs[AGES];    /* in a folded row */
    int reach[AGES];    /* largest |dy| */
    int slots;          /* for folded rows: a power of 2, above twice the largest reach */
    int width, diagonal;
    struct { float excitation, inhibition, directional; } units; /* of the codes */
};

struct folded { int16_t *rows[AGES]; int next[AGES], mask; };
struct totals { codes even[2], across[2], down[2]; };

HELD codes at(const int16_t *from) { return _mm256_loadu_si256((const codes *)from); }
HELD codes widened(const uint8_t *from)
{
    return _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)from));
}
HELD void keep(int16_t *to, codes value) { _mm256_storeu_si256((codes *)to, value); }
HELD codes both(const int16_t *weights)
{
    int32_t two;
    memcpy(&two, weights, sizeof two);
    return _mm256_set1_epi32(two);
}

/* Add and subtract what lies dx to the left and to the right, for dx and dx + 1. */
HELD void fold_pair(const uint8_t *row, int16_t *out, int dx)
{
    codes sum[2], difference[2];
    for (int k = 0; k < 2; k++) {
        codes left = widened(row - dx - k), right = widened(row + dx + k);
        if (dx + k <= 0) right = _mm256_setzero_si256(); /* at dx = 0 both are one pixel */
        sum[k] = _mm256_add_epi16(left, right);
        difference[k] = _mm256_sub_epi16(left, right);
    }
    keep(out, _mm256_unpacklo_epi16(sum[0], sum[1]));
    keep(out + STRIP, _mm256_unpackhi_epi16(sum[0], sum[1]));
    keep(out + 2 * STRIP, _mm256_unpacklo_epi16(difference[0], difference[1]));
    keep(out + 3 * STRIP, _mm256_unpackhi_epi16(difference[0], difference[1]));
}

/* Fold the rows up to `reach` around y that have not been folded yet. */
HELD void fold_around(const struct whole_sums *job, struct folded *to, int age, int y, int x)
{
    int reach = job->reach[age], pairs = job->pairs[age];
    int row = to->next[age] > y - reach ? to->next[age] : y - reach;
    for (; row <= y + reach; row++) {
        const uint8_t *from = job->photoreceptors[age] + row * job->stride + x;
        __builtin_prefetch(from + ROWS_AHEAD * job->stride);
        int16_t *out = to->rows[age] + (ptrdiff_t)(row & to->mask) * pairs * PAIR;
        fold_pair(from, out, job->first_dx[age]);
        for (int n = 1; n < pairs; n++)
            fold_pair(from, out + n * PAIR, job->first_dx[age] + 2 * n);
    }
    to->next[age] = row;
}

HELD codes times(codes values, codes weights, codes sum)
{
    sum = _mm256_add_epi32(sum, _mm256_madd_epi16(values, weights));
    KEEP(sum); /* the compiler would add in an order for which there are too few registers */
    return sum;
}

/* Sum pairs side by side, of one row above and one below. */
HELD void add_pairs(const struct pair *pair, int count, const int16_t *above,
                    const int16_t *below, int directional, struct totals *to)
{
#pragma GCC unroll 4
    for (int n = 0; n < count; n++, pair++, above += PAIR, below += PAIR)
#pragma GCC unroll 2
        for (int k = 0; k < 2; k++) {
            codes a = at(above + k * STRIP), b = at(below + k * STRIP);
            KEEP(a);
            KEEP(b);
            to->even[k] = times(_mm256_add_epi16(a, b), both(pair->even), to->even[k]);
            if (!directional) continue;
            codes aside = _mm256_add_epi16(at(above + (2 + k) * STRIP), at(below + (2 + k) * STRIP));
            to->down[k] = times(_mm256_sub_epi16(a, b), both(pair->down), to->down[k]);
            to->across[k] = times(aside, both(pair->across), to->across[k]);
        }
}

HELD void add_up(const struct kernel *kernel, const int16_t *scratch, int slot, int directional,
                 struct totals *to)
{
    const struct pair *pair = kernel->pairs;
    const int32_t *rows = kernel->rows + 2 * kernel->groups * slot;
#pragma GCC unroll 4
    for (int count = MOST; count; count--)
        for (int n = kernel->of_count[count - 1]; n--; rows += 2, pair += count)
            add_pairs(pair, count, scratch + rows[0], scratch + rows[1], directional, to);
}

HELD lanes in_floats(codes sums, float unit) { return unit * (lanes)_mm256_cvtepi32_ps(sums); }

/* Undo the mixing of the pixels in fold_pair, and go to the unit of the maps. */
HELD void in_order(const codes *sums, float unit, lanes *out)
{
    out[0] = in_floats(_mm256_permute2x128_si256(sums[0], sums[1], 0x20), unit);
    out[1] = in_floats(_mm256_permute2x128_si256(sums[0], sums[1], 0x31), unit);
}

HELD int some_left(const struct whole_sums *job, const struct totals *excitation,
                   const struct totals *inhibition)
{
    mask any = {0};
    for (int k = 0; k < 2; k++)
        any |= left(job->diagonal, in_floats(excitation->even[k], job->units.excitation),
                    in_floats(inhibition->even[k], job->units.inhibition),
                    in_floats(inhibition->across[k], job->units.directional),
                    in_floats(inhibition->down[k], job->units.directional));
    return !_mm256_testz_si256((codes)any, (codes)any);
}

/* Say for the strips of rows first to last - 1 whether any S may be above 0, two at once. */
HELD void screen(const struct whole_sums *job, int first, int last, uint8_t *boxes, char *verdicts)
{
    const ptrdiff_t stride = job->stride, reach = job->screening.reach;
    for (ptrdiff_t y = first - reach; y < last + reach; y++)
        sum_boxes(job->photoreceptors[1] + y * stride - reach, stride,
                  boxes + (y - first + reach) * stride);
    boxes += reach * stride + reach;
    for (ptrdiff_t y = first; y < last; y++, boxes += stride)
        for (int x = 0; x < job->width; x += SCREENED, verdicts += 2) {
            int found = screened(&job->screening, job->photoreceptors[0] + y * stride + x, boxes + x);
            verdicts[0] = found & 1;
            verdicts[1] = found >> 1;
        }
}

/* Compute the maps of rows first to last - 1. `scratch` begins with the zeros that lie
 * below where dy = 0, and has room for the folded rows; `screening` for two bytes for each
 * SCREENED pixels of a row, and for the boxes. */
void whole_sums(const struct whole_sums *job, int first, int last, int16_t *scratch,
                char *screening)
{
    struct folded rows = {.mask = job->slots - 1};
    int16_t *room = scratch + MOST * PAIR;
    for (int age = 0; age < AGES; age++) {
        rows.rows[age] = room;
        room += job->slots * job->pairs[age] * PAIR;
    }
    const int strips = 2 * ((job->width + SCREENED - 1) / SCREENED);
    const char *verdicts = screening;
    screen(job, first, last, (uint8_t *)screening + (last - first) * strips, screening);
    for (int x = 0; x < job->width; x += STRIP, verdicts++) {
        for (int age = 0; age < AGES; age++) rows.next[age] = first - job->reach[age];
        for (int y = first; y < last; y++) {
            struct totals excitation = {0}, inhibition = {0};
            int wanted = verdicts[(y - first) * strips];
            if (y + ROWS_AHEAD < last && verdicts[(y + ROWS_AHEAD - first) * strips])
                fetch_ahead(job->outputs, job->output_stride, job->live, y, x, STRIP);
            if (wanted) {
                fold_around(job, &rows, 0, y, x);
                add_up(&job->kernels[0], scratch, y & rows.mask, 0, &excitation);
            }
            for (int age = 1; wanted && age < AGES; age++) {
                fold_around(job, &rows, age, y, x);
                add_up(&job->kernels[age], scratch, y & rows.mask, 1, &inhibition);
                wanted = some_left(job, &excitation, &inhibition);
            }
            if (!wanted) {
                put_none(job->outputs, job->output_stride, job->live, y, x, STRIP);
                continue;
            }
            lanes e[2], i[2], across[2], down[2];
            in_order(excitation.even, job->units.excitation, e);
            in_order(inhibition.even, job->units.inhibition, i);
            in_order(inhibition.across, job->units.directional, across);
            in_order(inhibition.down, job->units.directional, down);
            for (int k = 0; k < 2; k++)
                put_all(job->outputs, y * job->output_stride + x + LANES * k, job->diagonal, e[k],
                        i[k], across[k], down[k]);
            put_some(job->outputs, job->output_stride, job->live, y, x, STRIP, job->width);
        }
    }
}
#endif
