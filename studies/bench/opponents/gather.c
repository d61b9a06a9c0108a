// The fastest form that we found in float32 for one core of a processor with vector registers.
//
// 1. S = sum of I*D over pixels is the sum over events k and corners c of I[c] * d(k, c): vote into I alone, then let each
//    event read its four pixels back. Neither D nor a sweep is needed.
// 2. The four derivatives of an event sum to zero. So with the mean in place of I outside the image,
//    S - mean * (sum of D) is that same sum over all corners, inside or not: the image has a border, which takes the votes
//    from outside (the mean is n less what fell there) and then holds the mean. No corner is tested.
// 3. A cell's two corners of a row lie side by side: they are read, added to and written together. Four events at a time
//    are turned from columns to rows in registers and back.
//
// Vectors are those of GCC (12 or newer) and Clang, not of one instruction set.

typedef float Number;
enum { LANES = 4 };
static const Number FAR = -1e6f;

#include "program.h"

static Number place(int pixel, int size) { return (void)size, (float)pixel; }
static Number offset_of(int32_t dither) { return (float)dither * 0x1p-32f; }
static Number scaled(int32_t since, float scale) { return (float)since * scale - 1.0f; }

typedef float Two __attribute__((vector_size(8)));
typedef float Four __attribute__((vector_size(16)));
static inline void transpose(Four v[4]) {
    const Four a = __builtin_shufflevector(v[0], v[1], 0, 4, 1, 5), b = __builtin_shufflevector(v[2], v[3], 0, 4, 1, 5);
    const Four c = __builtin_shufflevector(v[0], v[1], 2, 6, 3, 7), d = __builtin_shufflevector(v[2], v[3], 2, 6, 3, 7);
    v[0] = __builtin_shufflevector(a, b, 0, 1, 4, 5);
    v[1] = __builtin_shufflevector(a, b, 2, 3, 6, 7);
    v[2] = __builtin_shufflevector(c, d, 0, 1, 4, 5);
    v[3] = __builtin_shufflevector(c, d, 2, 3, 6, 7);
}

static inline float limit(float value, float low, float high) {
    return value < low ? low : value > high ? high : value;
}

static inline Two load(const float *from) {
    Two two;
    memcpy(&two, from, sizeof two);
    return two;
}

static inline void add(float *to, Two what) {
    const Two sum = load(to) + what;
    memcpy(to, &sum, sizeof sum);
}

static void gradient(Work *work, const Job *job, const double v[2], int level, double g[2]) {
    const int width = -(-job->width >> level), height = -(-job->height >> level);
    const int stride = width + 2;  // the right border of a row is the left one of the next
    const int n = (work->n + 3) / 4 * 4;
    const float scale = 1.0f / (float)(1 << level), offset = 0.5f * scale - 0.5f;
    const float vx = (float)v[0] * scale, vy = (float)v[1] * scale;
    const float *restrict x = work->x, *restrict y = work->y, *restrict dt = work->dt;
    float *restrict fx = work->fx, *restrict fy = work->fy, *restrict image = work->image;
    int32_t *restrict address = work->address;

    for (int k = 0; k < n; ++k) {
        const float px = limit(x[k] * scale + offset - dt[k] * vx, -2, (float)width);
        const float py = limit(y[k] * scale + offset - dt[k] * vy, -2, (float)height);
        const float i = floorf(px), j = floorf(py);
        fx[k] = px - i;
        fy[k] = py - j;
        address[k] = ((int)j + 2) * stride + (int)i + 2;
    }

    memset(image, 0, ((size_t)(height + 4) * stride + 2) * sizeof(float));
    for (int k = 0; k < n; k += 4) {
        const Four a = *(const Four *)(fx + k), b = *(const Four *)(fy + k), ab = a * b;
        Four w[4] = {1 - a - (b - ab), a - ab, b - ab, ab};
        transpose(w);
        for (int e = 0; e < 4; ++e) {
            float *pixel = image + address[k + e];
            add(pixel, (Two){w[e][0], w[e][1]});
            add(pixel + stride, (Two){w[e][2], w[e][3]});
        }
    }

    float *top = image, *bottom = image + (height + 2) * stride + 2;
    float outside = 0;
    for (int k = 0; k < 2 * stride + 2; ++k) outside += top[k];
    for (int k = 0; k < 2 * stride; ++k) outside += bottom[k];
    for (int row = 0; row < height; ++row) outside += image[(row + 3) * stride] + image[(row + 3) * stride + 1];
    const float mean = (float)(((double)n - (double)outside) / ((double)job->width * job->height));
    for (int k = 0; k < 2 * stride + 2; ++k) top[k] = mean;
    for (int k = 0; k < 2 * stride; ++k) bottom[k] = mean;
    for (int row = 0; row < height; ++row) image[(row + 3) * stride] = image[(row + 3) * stride + 1] = mean;

    Four sum_x = {0}, sum_y = {0};
    for (int k = 0; k < n; k += 4) {
        Four p[4];
        for (int e = 0; e < 4; ++e) {
            const float *pixel = image + address[k + e];
            const Two upper = load(pixel), lower = load(pixel + stride);
            p[e] = __builtin_shufflevector(upper, lower, 0, 1, 2, 3);
        }
        transpose(p);
        const Four a = *(const Four *)(fx + k), b = *(const Four *)(fy + k), time = *(const Four *)(dt + k);
        const Four across = p[0] - p[1], across_below = p[2] - p[3];
        const Four down = p[0] - p[2], down_right = p[1] - p[3];
        sum_x += time * (across + b * (across_below - across));
        sum_y += time * (down + a * (down_right - down));
    }
    g[0] = (double)(sum_x[0] + sum_x[1] + sum_x[2] + sum_x[3]);
    g[1] = (double)(sum_y[0] + sum_y[1] + sum_y[2] + sum_y[3]);
}
