// What the C programs share: the job, cropping, the ascent. The including file says what a Number is, how many events are
// taken at a time (LANES), which Number is far outside (FAR), and has the gradient.

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

// The layout is repeated in c_program.py.
typedef struct {
    const int64_t *t;  // all events of the batch
    const uint16_t *x, *y;
    int64_t events;
    int32_t roi_x, roi_y, width, height;
    int32_t iterations, dither, probes;
    const int32_t *levels;  // sign ascent, one per iteration; null: constant eta
    const double *steps;
    const int32_t *strides;  // of the events, one in so many, as far as there are enough
    double eta;
    double v_start[2];
    double v[2];  // returned
    double g[8];  // with probes: gradients below and above v along x, along y
} Job;

typedef struct {
    int total, n;         // events in the ROI, and those of the iteration
    Number *all[3];       // column, row and dt of each event in the ROI
    Number *x, *y, *dt;   // of the events of the iteration
    int first, stride;    // which those are
    int32_t *since;       // time since the first event of the batch
    Number *fx, *fy;      // fractions, and ...
    int32_t *address;     // ... the pixel of each event's cell
    Number *image;
} Work;

// Room for events in so many, and for two pixels and more around the image; events that a stride leaves, at least about.
enum { ROUND = 16, MARGIN = 4, FEWEST = 128 };

static Number place(int pixel, int size);             // a coordinate in an image of that size
static Number offset_of(int32_t dither);              // a share of a pixel, in 2^-32
static Number scaled(int32_t since, float scale);     // time in -1 ... 1

static void gradient(Work *work, const Job *job, const double v[2], int level, double g[2]);

static size_t rounded(size_t bytes) { return (bytes + 127) / 64 * 64; }

static void *room(size_t bytes) { return aligned_alloc(64, rounded(bytes)); }

void work_free(void *memory) { free(memory); }

Work *work_new(const Job *job) {
    const size_t events = rounded((job->events + ROUND) * sizeof(int32_t)), start = rounded(sizeof(Work));
    const size_t pixels = (size_t)(job->width + 2 * MARGIN) * (job->height + 2 * MARGIN);
    Work *work = room(start + 10 * events + 4 * pixels);
    if (!work) return NULL;
    work->total = work->stride = 0;
    char *at = (char *)work + start;
    Number **arrays[] = {&work->all[0], &work->all[1], &work->all[2], &work->x, &work->y, &work->dt, &work->fx, &work->fy};
    for (size_t k = 0; k < sizeof arrays / sizeof *arrays; ++k, at += events) *arrays[k] = (Number *)at;
    work->since = (int32_t *)at;
    work->address = (int32_t *)(at + events);
    work->image = (Number *)(at + 2 * events);
    return work;
}

// frac((k + 1/2) * alpha) - 1/2 with the alphas of the R2 sequence: an overflow is what frac() does, and the sign bit
// turned over takes 1/2 away.
static void dither(Work *work) {
    for (uint32_t k = 0; k < (uint32_t)work->total; ++k) {
        const uint32_t along_x = 1621087444u + k * 3242174889u, along_y = 1223722707u + k * 2447445414u;
        work->all[0][k] += offset_of((int32_t)(along_x ^ 0x80000000u));
        work->all[1][k] += offset_of((int32_t)(along_y ^ 0x80000000u));
    }
}

// Events of the ROI. First their numbers, without a branch that could be mispredicted.
static void crop(Work *work, const Job *job) {
    const uint16_t *restrict x = job->x, *restrict y = job->y;
    int32_t *restrict index = work->address;  // not in use yet
    const int32_t left = job->roi_x, top = job->roi_y;
    const uint32_t width = job->width, height = job->height;
    int n = 0;
    for (int32_t k = 0; k < job->events; ++k) {
        index[n] = k;
        n += ((uint32_t)(x[k] - left) < width) & ((uint32_t)(y[k] - top) < height);
    }
    const int64_t first = job->events ? job->t[0] : 0;
    for (int k = 0; k < n; ++k) {
        work->all[0][k] = place(x[index[k]] - left, job->width);
        work->all[1][k] = place(y[index[k]] - top, job->height);
        work->since[k] = (int32_t)(job->t[index[k]] - first);
    }
    work->total = n;
    if (job->dither) dither(work);
}

// The events of an iteration, side by side, unless they are already; filled up with events far outside that have no time.
static void use(Work *work, int first, int stride) {
    if (first == work->first && stride == work->stride) return;
    work->first = first;
    work->stride = stride;
    work->n = (work->total - first + stride - 1) / stride;
    Number *to[3] = {work->x, work->y, work->dt};
    for (int axis = 0; axis < 3; ++axis)
        if (stride == 1) memcpy(to[axis], work->all[axis], work->n * sizeof(Number));
        else
            for (int k = 0; k < work->n; ++k) to[axis][k] = work->all[axis][first + k * stride];
    for (int k = work->n; k % LANES; ++k) {
        work->x[k] = work->y[k] = FAR;
        work->dt[k] = 0;
    }
}

// At one v, after a batch.
void run_gradient(Work *work, const Job *job, const double *v, int32_t level, double *g) {
    use(work, 0, 1);
    gradient(work, job, v, level, g);
}

// The batch's times; 0 where it takes none.
static int scale_all(Work *work, const Job *job) {
    const int64_t span = job->events ? job->t[job->events - 1] - job->t[0] : 0;
    const float scale = span ? (float)(2.0 / (double)span) : 0;
    for (int k = 0; k < work->total; ++k) work->all[2][k] = scaled(work->since[k], scale);
    work->stride = 0;  // what was used before is of another batch
    return span != 0;
}

static void ascend(Work *work, Job *job) {
    memcpy(job->v, job->v_start, sizeof job->v);
    if (!scale_all(work, job) || !work->total) return;
    const double rate = 2.0 * job->eta / ((double)job->width * job->height);
    for (int k = 0; k < job->iterations; ++k) {
        static const int order[4] = {0, 2, 1, 3};
        int stride = job->strides ? job->strides[k] : 1;
        while (stride > 1 && work->total < FEWEST * stride) stride /= 2;
        use(work, order[k % 4] * stride / 4, stride);
        double g[2];
        gradient(work, job, job->v, job->levels ? job->levels[k] : 0, g);
        if (isnan(g[0])) job->v[0] = NAN;
        for (int axis = 0; axis < 2; ++axis) {
            const double share = 2 * fabs(g[axis]) < fabs(g[1 - axis]) ? 0.5 : 1.0;
            job->v[axis] += job->levels ? job->steps[k] * share * ((g[axis] > 0) - (g[axis] < 0)) : rate * g[axis];
        }
    }
    for (int probe = 0; job->probes && probe < 4; ++probe) {
        double v[2] = {job->v[0], job->v[1]};
        v[probe / 2] += probe % 2 ? 0.75 : -0.75;
        run_gradient(work, job, v, job->levels ? job->levels[job->iterations - 1] : 0, job->g + 2 * probe);
    }
}

void run_batch(Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) {
        crop(work, job);
        ascend(work, job);
    }
}

void run_ascent(Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) ascend(work, job);
}
