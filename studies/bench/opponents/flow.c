// Dense flow as the hardware with a table of regions does it, by the gradient of gather.c: events in bins, coarse tiles,
// then fine ones that begin at a coarse one's v, and four gradients beside each v for its confidence. On so many threads.

#include <pthread.h>
#include <stdatomic.h>

#include "gather.c"

// The layouts are repeated in c_program.py.
typedef struct {
    int32_t x, y, width, height, left, top;  // the tile on the sensor, px; where it begins in its image
    int32_t parent;                          // whose v it begins with; -1: 0
    int32_t stride, iterations;
    const int32_t *levels;
    const double *steps;
    const int32_t *strides;
} Tile;

typedef struct {
    Job window;  // its width and height are the image's
    int32_t sensor_width, sensor_height, bin_bits, most;
    int32_t tiles, coarse, threads;
    const Tile *tile;
    double *v;       // [tiles][2], returned
    double *probes;  // [tiles][8], returned: gradients below and above v along x, along y
} Flow;

enum { MOST_THREADS = 64 };
typedef struct {
    const Flow *flow;
    int columns, rows;
    const int32_t *ends;  // of the bins
    const uint16_t *x, *y;
    const int32_t *since;
    Work *work[MOST_THREADS];
    atomic_int thread, next;
    int last;
} Shared;

static int gather_tile(const Shared *shared, const Tile *tile, Work *work) {
    const Flow *flow = shared->flow;
    const int bits = flow->bin_bits, move_x = tile->left - tile->x, move_y = tile->top - tile->y;
    const int last_column = (tile->x + tile->width - 1) >> bits, last_row = (tile->y + tile->height - 1) >> bits;
    int n = 0;
    for (int row = tile->y >> bits; row <= last_row && row < shared->rows; ++row)
        for (int column = tile->x >> bits; column <= last_column && column < shared->columns; ++column) {
            const int bin = row * shared->columns + column;
            for (int k = bin ? shared->ends[bin - 1] : 0; k < shared->ends[bin]; ++k) {
                work->all[0][n] = (float)(shared->x[k] + move_x);
                work->all[1][n] = (float)(shared->y[k] + move_y);
                work->since[n] = shared->since[k];
                n += ((uint32_t)(shared->x[k] - tile->x) < (uint32_t)tile->width) &
                     ((uint32_t)(shared->y[k] - tile->y) < (uint32_t)tile->height);
            }
        }
    int stride = tile->stride;
    while ((n + stride - 1) / stride > flow->most) stride *= 2;
    if (stride == 1) return n;
    int kept = 0;
    for (int k = 0; k < n; k += stride, ++kept) {
        work->all[0][kept] = work->all[0][k];
        work->all[1][kept] = work->all[1][k];
        work->since[kept] = work->since[k];
    }
    return kept;
}

static void *work_on(void *given) {
    Shared *shared = given;
    const Flow *flow = shared->flow;
    Work *work = shared->work[atomic_fetch_add(&shared->thread, 1)];
    for (int number; (number = atomic_fetch_add(&shared->next, 1)) < shared->last;) {
        const Tile *tile = flow->tile + number;
        Job job = flow->window;
        work->total = gather_tile(shared, tile, work);
        dither(work);
        job.iterations = tile->iterations;
        job.levels = tile->levels;
        job.steps = tile->steps;
        job.strides = tile->strides;
        for (int axis = 0; axis < 2; ++axis) job.v_start[axis] = tile->parent < 0 ? 0 : flow->v[2 * tile->parent + axis];
        ascend(work, &job);
        memcpy(flow->v + 2 * number, job.v, sizeof job.v);
        memcpy(flow->probes + 8 * number, job.g, sizeof job.g);
    }
    return NULL;
}

static void work_through(Shared *shared, int first, int last) {
    pthread_t threads[MOST_THREADS];
    const int count = shared->flow->threads;
    shared->thread = 0;
    shared->next = first;
    shared->last = last;
    for (int k = 1; k < count; ++k) pthread_create(threads + k, NULL, work_on, shared);
    work_on(shared);
    for (int k = 1; k < count; ++k) pthread_join(threads[k], NULL);
}

// A window, so often; 0: no memory, or too many threads.
int run_flow(const Flow *flow, int64_t count) {
    const Job *window = &flow->window;
    const size_t events = window->events + 1;
    const int bits = flow->bin_bits, columns = ((flow->sensor_width - 1) >> bits) + 1;
    const int rows = ((flow->sensor_height - 1) >> bits) + 1, bins = columns * rows;
    int32_t *ends = calloc(bins + 1, sizeof *ends), *since = malloc(events * sizeof *since);
    uint16_t *x = malloc(events * sizeof *x), *y = malloc(events * sizeof *y);
    Shared shared = {flow, columns, rows, ends, x, y, since};
    int done = ends && since && x && y && flow->threads >= 1 && flow->threads <= MOST_THREADS;
    for (int k = 0; done && k < flow->threads; ++k) done = (shared.work[k] = work_new(window)) != NULL;
    for (int64_t k = 0; done && k < count; ++k) {
        memset(ends, 0, (bins + 1) * sizeof *ends);
        for (int64_t e = 0; e < window->events; ++e)
            ++ends[(window->y[e] >> bits) * columns + (window->x[e] >> bits) + 1];
        for (int bin = 0; bin < bins; ++bin) ends[bin + 1] += ends[bin];
        for (int64_t e = 0; e < window->events; ++e) {
            const int at = ends[(window->y[e] >> bits) * columns + (window->x[e] >> bits)]++;
            x[at] = window->x[e];
            y[at] = window->y[e];
            since[at] = (int32_t)(window->t[e] - window->t[0]);
        }
        work_through(&shared, 0, flow->coarse);
        work_through(&shared, flow->coarse, flow->tiles);
    }
    for (int k = 0; k < MOST_THREADS; ++k) work_free(shared.work[k]);
    free(ends);
    free(since);
    free(x);
    free(y);
    return done;
}
