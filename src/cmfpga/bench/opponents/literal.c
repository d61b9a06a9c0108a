// The article's iteration as it stands: zero three images, vote into them, sweep them.

#include "program.h"

// A corner outside the image is dropped alone. A negative coordinate is a large unsigned one.
#define VOTE(at_column, at_row, weight, along_x, along_y)                                              \
    if ((unsigned)(at_column) < (unsigned)width && (unsigned)(at_row) < (unsigned)height) {            \
        const int address = (at_row) * width + (at_column);                                            \
        image[address] += weight;                                                                      \
        by_x[address] += along_x;                                                                      \
        by_y[address] += along_y;                                                                      \
    }

static void prepare(Work *work, const Job *job) { (void)work, (void)job; }

static void gradient(Work *work, const Job *job, const double v[2], int level, double g[2]) {
    const int width = -(-job->width >> level), height = -(-job->height >> level);
    const float scale = 1.0f / (float)(1 << level), offset = 0.5f * scale - 0.5f;
    const float vx = (float)v[0] * scale, vy = (float)v[1] * scale;
    float *restrict image = work->image[0], *restrict by_x = work->image[1], *restrict by_y = work->image[2];
    const size_t bytes = (size_t)width * height * sizeof(float);
    memset(image, 0, bytes);
    memset(by_x, 0, bytes);
    memset(by_y, 0, bytes);
    for (int k = 0; k < work->n; ++k) {
        const float dt = work->dt[k];
        const float x = work->x[k] * scale + offset - dt * vx, y = work->y[k] * scale + offset - dt * vy;
        const float i = floorf(x), j = floorf(y);
        const float fx = x - i, fy = y - j, ex = 1 - fx, ey = 1 - fy;
        const int column = (int)i, row = (int)j;
        VOTE(column, row, ex * ey, dt * ey, dt * ex)
        VOTE(column + 1, row, fx * ey, -dt * ey, dt * fx)
        VOTE(column, row + 1, ex * fy, dt * fy, -dt * ex)
        VOTE(column + 1, row + 1, fx * fy, -dt * fy, -dt * fx)
    }
    float sum = 0, sum_x = 0, sum_y = 0, s_x = 0, s_y = 0;
    for (int p = 0; p < width * height; ++p) {
        sum += image[p];
        sum_x += by_x[p];
        sum_y += by_y[p];
        s_x += image[p] * by_x[p];
        s_y += image[p] * by_y[p];
    }
    const double mean = (double)sum / ((double)job->width * job->height);
    g[0] = (double)s_x - mean * (double)sum_x;
    g[1] = (double)s_y - mean * (double)sum_y;
}
