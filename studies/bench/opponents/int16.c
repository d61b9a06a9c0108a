// The ascent of gather.c in integers of 16 bits. Positions, weights and pixels have 8 fraction bits, so that a pixel holds 127
// events at most; the gradient of a batch with more is NAN. Positions are counted from the middle of the image, of 250 px at
// most a side.
//
// 1. The image has rows in pairs, 32 bits for a column of two, and is kept twice: pairs begin at even rows in one, at odd rows
//    in the other. So the four corners of any cell are one word of 64 bits, in one of both: a vote is one sum, reading back
//    one load. Between them both are merged. No carry can leave a pixel before its sign bit was set, so the bits of all sums
//    tell whether one was too full.
// 2. Read back, corners are multiplied by the derivatives' weights and added up in 32 bits, a few hundred events at a time.

#include <stdint.h>

typedef int16_t Number;
enum { LANES = 16 };
static const Number FAR = -32768;

#include "program.h"

enum { VOTES = 256, SUMS = 960, WIDEST = 250 };  // events at a time, as many as 32 bits hold the sums of; px
typedef Number Sixteen __attribute__((vector_size(32)));
typedef uint16_t Unsigned __attribute__((vector_size(32)));
typedef int32_t Eight __attribute__((vector_size(32)));
typedef uint64_t Words __attribute__((vector_size(32)));

// What the vectors of C have no sign for; the same in any processor.
#ifdef __AVX2__
#include <immintrin.h>
#define DEFINE(type, name, b_type, instruction, what) \
    static inline type name(Sixteen a, b_type b) { return (type)instruction; }
#else
#define DEFINE(type, name, b_type, instruction, what)                                          \
    static inline type name(Sixteen a, b_type b) {                                             \
        type result;                                                                           \
        for (size_t k = 0; k < sizeof result / sizeof result[0]; ++k) result[k] = what;        \
        return result;                                                                         \
    }
#endif
static inline int least(int a, int b) { return a < b ? a : b; }
static inline int most(int a, int b) { return a > b ? a : b; }
DEFINE(Sixteen, minus, Sixteen, _mm256_subs_epi16((__m256i)a, (__m256i)b), (Number)least(most(a[k] - b[k], -32768), 32767))
DEFINE(Sixteen, times, Sixteen, _mm256_mulhrs_epi16((__m256i)a, (__m256i)b), (Number)(((a[k] * b[k] >> 14) + 1) >> 1))
DEFINE(Sixteen, at_least, Sixteen, _mm256_max_epi16((__m256i)a, (__m256i)b), (Number)most(a[k], b[k]))
DEFINE(Sixteen, at_most, Sixteen, _mm256_min_epi16((__m256i)a, (__m256i)b), (Number)least(a[k], b[k]))
DEFINE(Sixteen, halved, int, _mm256_sra_epi16((__m256i)a, _mm_cvtsi32_si128(b)), (Number)(a[k] >> b))
DEFINE(Eight, dot, Sixteen, _mm256_madd_epi16((__m256i)a, (__m256i)b), a[2 * k] * b[2 * k] + a[2 * k + 1] * b[2 * k + 1])

// Of each half of both, every second one from either: numbers, and pairs of them.
#define MIX(a, b, k) __builtin_shufflevector(a, b, k, k + 16, k + 1, k + 17, k + 2, k + 18, k + 3, k + 19, \
                                             k + 8, k + 24, k + 9, k + 25, k + 10, k + 26, k + 11, k + 27)
#define MIX_PAIRS(a, b, k) (Sixteen)__builtin_shufflevector((Eight)(a), (Eight)(b), k, k + 8, k + 1, k + 9, \
                                                            k + 4, k + 12, k + 5, k + 13)
static inline void mix(Sixteen a, Sixteen b, Sixteen c, Sixteen d, Sixteen to[4]) {
    const Sixteen ab = MIX(a, b, 0), cd = MIX(c, d, 0), more_ab = MIX(a, b, 4), more_cd = MIX(c, d, 4);
    to[0] = MIX_PAIRS(ab, cd, 0);
    to[1] = MIX_PAIRS(ab, cd, 2);
    to[2] = MIX_PAIRS(more_ab, more_cd, 0);
    to[3] = MIX_PAIRS(more_ab, more_cd, 2);
}
static const int mixed[16] = {0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15};  // where events are then

static Number place(int pixel, int size) { return (Number)(256 * pixel + 128 - 128 * size); }
static Number offset_of(int32_t dither) { return (Number)(dither >> 24); }
static Number scaled(int32_t since, float scale) {
    const int time = (int)((float)since * (32768 * scale)) - 32768;  // 2^-15
    return (Number)(time < 32767 ? time : 32767);
}

static inline uint64_t four(const void *from) {
    uint64_t corners;
    memcpy(&corners, from, sizeof corners);
    return corners;
}

// Votes of the events that are not far outside, counted; returns all sums' bits.
static uint64_t vote(Work *work, const Job *job, const double v[2], int level, int n, int stride, int plane, int *count) {
    const int from_left = (job->width << 7 >> level) + 384, from_top = (job->height << 7 >> level) + 384;
    const int height = -(-job->height >> level);
    Sixteen voting = {0};
    const Sixteen zero = {0}, vx = zero + (Number)lrint(256 * fmin(fmax(v[0], -127), 127));
    const Sixteen vy = zero + (Number)lrint(256 * fmin(fmax(v[1], -127), 127));
    const Sixteen left = zero + (Number)-from_left, right = zero + (Number)(stride * 256 - from_left);
    const Sixteen top = zero + (Number)-from_top, bottom = zero + (Number)((height + 2) * 256 - from_top);
    uint16_t *restrict address = (uint16_t *)work->address;
    uint32_t *restrict image = (uint32_t *)work->image;
    uint64_t full = 0;
    for (int first = 0; first < n; first += VOTES) {
        const int end = least(n, first + VOTES);
        Sixteen weights[VOTES / 4], *to = weights;
        for (int k = first; k < end; k += 16, to += 4) {
            const Sixteen dt = *(Sixteen *)(work->dt + k);
            const Sixteen x = halved(minus(*(Sixteen *)(work->x + k), times(dt, vx)), level);
            const Sixteen y = halved(minus(*(Sixteen *)(work->y + k), times(dt, vy)), level);
            const Sixteen votes = (x > left) & (x < right) & (y > top) & (y < bottom);
            const Unsigned px = (Unsigned)at_least(at_most(x, right), left) - (Unsigned)left;
            const Unsigned py = (Unsigned)at_least(at_most(y, bottom), top) - (Unsigned)top;
            const Unsigned a = px & 255, b = py & 255, ab = (a * b + 128) >> 8;
            *(Unsigned *)(address + k) = (py >> 9) * (uint16_t)stride + (px >> 8) + (-(py >> 8 & 1) & (uint16_t)plane);
            *(Unsigned *)(work->fx + k) = a;
            *(Unsigned *)(work->fy + k) = b;
            voting -= votes;
            mix((Sixteen)(256 - a - b + ab) & votes, (Sixteen)(b - ab) & votes, (Sixteen)(a - ab) & votes,
                (Sixteen)ab & votes, to);
        }
        for (int k = first; k < end; k += 16) {
#pragma GCC unroll 16
            for (int e = 0; e < 16; ++e) {
                uint32_t *pixel = image + address[k + mixed[e]];
                const uint64_t sum = four(pixel) + four((char *)weights + 8 * (k - first + e));
                memcpy(pixel, &sum, sizeof sum);
                full |= sum;
            }
        }
    }
    *count = 0;
    for (int k = 0; k < 16; ++k) *count += voting[k];
    return full;
}

static void gradient(Work *work, const Job *job, const double v[2], int level, double g[2]) {
    g[0] = g[1] = NAN;
    if (job->width > WIDEST || job->height > WIDEST) return;
    const int width = -(-job->width >> level), height = -(-job->height >> level), n = (work->n + ROUND - 1) / ROUND * ROUND;
    const int stride = width + 2, plane = (height + 5) / 2 * stride + 2;  // a row's right border is the next pair's left one
    uint32_t *restrict even = (uint32_t *)work->image, *restrict odd = even + plane;
    memset(even, 0, 2 * plane * sizeof *even);
    int votes;
    uint64_t full = vote(work, job, v, level, n, stride, plane, &votes);

    // All votes: even rows with what the odd pairs have of them.
    for (int k = 0; k < stride; ++k) even[k] += odd[k] << 16;
    uint32_t fuller = 0;
    for (int k = stride; k < plane; ++k) fuller |= even[k] += odd[k] << 16 | odd[k - stride] >> 16;
    full |= (uint64_t)fuller << 32 | fuller;
    if (full & 0x8000800080008000u) return;
    // The border's votes count for nothing: it holds the mean.
    Number *restrict pixels = (Number *)even;
    const int below = (height + 3) / 2 * stride;  // rows in pairs; with an odd height, the upper one is the last of a pair
#define BORDER(what)                                                                                              \
    for (int k = 0; k < 2 * stride; ++k) what;                                                                    \
    for (int word = stride; word < below; word += stride)                                                         \
        for (int k = 2 * word; k < 2 * word + 4; ++k) what;                                                       \
    for (int k = height % 2 ? 2 * (below - stride) + 5 : 2 * below; k < 2 * below; k += 2) what;                  \
    for (int k = 2 * below; k < 2 * plane; ++k) what;
    int outside = 0;
    BORDER(outside += pixels[k])
    const Number mean = (Number)lrint((256.0 * votes - outside) / ((double)job->width * job->height));
    BORDER(pixels[k] = mean)
    for (int k = 0; k < plane - stride; ++k) odd[k] = even[k] >> 16 | even[k + stride] << 16;

    const uint16_t *restrict address = (uint16_t *)work->address;
    double sum_x = 0, sum_y = 0;
    for (int first = 0; first < n; first += SUMS) {
        Eight part_x = {0}, part_y = {0};
        for (int k = first; k < n && k < first + SUMS; k += 16) {
            const Sixteen dt = *(Sixteen *)(work->dt + k), time = (dt >> 7) + (dt >> 6 & 1);
            const Sixteen a = times(dt, *(Sixteen *)(work->fx + k)), b = times(dt, *(Sixteen *)(work->fy + k));
            Sixteen by_x[4], by_y[4];
            mix(time - b, b, time - b, b, by_x);
            mix(time - a, a - time, a, -a, by_y);
#pragma GCC unroll 4
            for (int e = 0; e < 4; ++e) {
                const int *at = mixed + 4 * e;
                const Words corners = {four(even + address[k + at[0]]), four(even + address[k + at[1]]),
                                       four(even + address[k + at[2]]), four(even + address[k + at[3]])};
                part_x += dot((Sixteen)corners, by_x[e]);
                part_y += dot((Sixteen)corners, by_y[e]);
            }
        }
        for (int k = 0; k < 8; ++k) {
            sum_x += k % 2 ? -part_x[k] : part_x[k];  // columns left and right
            sum_y += part_y[k];
        }
    }
    g[0] = sum_x * 0x1p-16;
    g[1] = sum_y * 0x1p-16;
}
