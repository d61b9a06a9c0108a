// A hop of a window that slides: the search round 1:3/4:1, a Newton step of four gradients beside v. In two ways:
// by int16.c when the hop has ended, and by a program that follows. That one adds each event to the four sums
// S = sum I*D when it comes, so that only the closing event and the step are left. Events of which a corner lies outside
// do not vote, as in the hardware; so sum D = 0, and S is the gradient.

#include "int16.c"

enum { LEVEL = 1, EVALUATIONS = 4 };
static const double BESIDE = 0.75, LIMIT = 1;
typedef float Four __attribute__((vector_size(16)));  // of a pixel: I, Dx, Dy and nothing

typedef struct {
    int width, height;
    Four *image[EVALUATIONS], sum[EVALUATIONS];  // sum: of I*I, I*Dx, I*Dy
    double v[EVALUATIONS][2];
} Hop;

static void beside(const double v[2], double at[EVALUATIONS][2]) {
    for (int k = 0; k < 2 * EVALUATIONS; ++k) at[k / 2][k % 2] = v[k % 2] + (k / 4 == k % 2 ? k / 2 % 2 ? BESIDE : -BESIDE : 0);
}

static double within(double size, double limit) { return size > limit ? limit : size < -limit ? -limit : size; }

static void newton(double g[EVALUATIONS][2], double v[2]) {
    double mean[2] = {0, 0}, det, half, trace, m[2];
    for (int k = 0; k < 2 * EVALUATIONS; ++k) mean[k % 2] += g[k / 2][k % 2] / EVALUATIONS;
    for (int axis = 0; axis < 2; ++axis) m[axis] = (g[2 * axis][axis] - g[2 * axis + 1][axis]) / (2 * BESIDE);
    half = (g[0][1] - g[1][1] + g[2][0] - g[3][0]) / (4 * BESIDE);
    trace = m[0] + m[1];
    det = m[0] * m[1] - half * half;
    if (8 * det < trace * trace) {
        for (int axis = 0; axis < 2; ++axis) m[axis] += trace / 8;
        det += trace * trace * 9 / 64;
    }
    for (int axis = 0; axis < 2; ++axis) {
        const double one = mean[axis], other = mean[1 - axis];
        if (trace > 0 && det > 0) v[axis] += within((m[1 - axis] * one - half * other) / det, LIMIT);
        else if (2 * fabs(one) >= fabs(other)) v[axis] += LIMIT * ((one > 0) - (one < 0));
    }
}

static void scale_all(Work *work, const Job *job) {
    const int64_t span = job->events ? job->t[job->events - 1] - job->t[0] : 0;
    const float scale = span ? (float)(2.0 / (double)span) : 0;
    for (int k = 0; k < work->total; ++k) work->all[2][k] = scaled(work->since[k], scale);
    work->stride = 0;
    use(work, job, 0, 1);
}

// All that is left where a hop has ended.
void run_round(Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) {
        double at[EVALUATIONS][2], g[EVALUATIONS][2];
        scale_all(work, job);
        memcpy(job->v, job->v_start, sizeof job->v);
        beside(job->v, at);
        for (int e = 0; e < EVALUATIONS; ++e) gradient(work, job, at[e], LEVEL, g[e]);
        newton(g, job->v);
    }
}

void hop_free(Hop *hop) {
    for (int e = 0; hop && e < EVALUATIONS; ++e) free(hop->image[e]);
    free(hop);
}

Hop *hop_new(const Job *job) {
    Hop *hop = calloc(1, sizeof *hop);
    if (!hop) return NULL;
    hop->width = (job->width + 1) >> LEVEL;
    hop->height = (job->height + 1) >> LEVEL;
    int ok = 1;
    for (int e = 0; e < EVALUATIONS; ++e) ok &= (hop->image[e] = room((size_t)hop->width * hop->height * sizeof(Four))) != NULL;
    if (ok) return hop;
    hop_free(hop);
    return NULL;
}

// The first pixel of the event's cell, its four weights with their derivatives; null where a corner is outside.
static inline Four *cell(const Hop *hop, const Work *work, const Job *job, int e, int k, Four add[4]) {
    const float dt = work->all[2][k] / 32768.0f;
    const float x = (work->all[0][k] / 256.0f - dt * (float)hop->v[e][0] + 0.5f * job->width) / 2 - 0.5f;
    const float y = (work->all[1][k] / 256.0f - dt * (float)hop->v[e][1] + 0.5f * job->height) / 2 - 0.5f;
    const int i = (int)x, j = (int)y;
    if (!(x >= 0 && y >= 0 && i < hop->width - 1 && j < hop->height - 1)) return NULL;
    const float a = x - i, b = y - j;
    add[0] = (Four){(1 - a) * (1 - b), dt * (1 - b), dt * (1 - a), 0};
    add[1] = (Four){a * (1 - b), -dt * (1 - b), dt * a, 0};
    add[2] = (Four){(1 - a) * b, dt * b, -dt * (1 - a), 0};
    add[3] = (Four){a * b, -dt * b, -dt * a, 0};
    return hop->image[e] + j * hop->width + i;
}

// With sum I*D, what an event adds to it: old I times its D, its I times old D, and its own of both.
static inline void take(Hop *hop, const Work *work, const Job *job, int k) {
    for (int e = 0; e < EVALUATIONS; ++e) {
        Four add[4], *pixel = cell(hop, work, job, e, k, add);
        for (int corner = 0; pixel && corner < 4; ++corner) {
            Four *at = pixel + (corner & 1) + (corner & 2 ? hop->width : 0);
            hop->sum[e] += (*at + add[corner])[0] * add[corner] + add[corner][0] * *at;
            *at += add[corner];
        }
    }
}

static void step(const Hop *hop, Job *job) {
    double g[EVALUATIONS][2];
    for (int k = 0; k < 2 * EVALUATIONS; ++k) g[k / 2][k % 2] = hop->sum[k / 2][1 + k % 2];
    memcpy(job->v, job->v_start, sizeof job->v);
    newton(g, job->v);
}

static void begin(Hop *hop, Work *work, const Job *job) {
    scale_all(work, job);
    beside(job->v_start, hop->v);
    for (int e = 0; e < EVALUATIONS; ++e) {
        memset(hop->image[e], 0, (size_t)hop->width * hop->height * sizeof(Four));
        hop->sum[e] = (Four){0};
    }
}

// A whole window, event by event. What it leaves is for run_tail: all but the last event.
void run_follow(Hop *hop, Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) {
        begin(hop, work, job);
        for (int event = 0; event < work->total - 1; ++event) take(hop, work, job, event);
    }
}

// The closing event and the step. Pixels are put back, for the next time; so the time includes that.
void run_tail(Hop *hop, Work *work, Job *job, int64_t count) {
    const int last = work->total - 1;
    for (int64_t k = 0; k < count; ++k) {
        Four add[4], *pixel, sums[EVALUATIONS];
        memcpy(sums, hop->sum, sizeof sums);
        take(hop, work, job, last);
        step(hop, job);
        for (int e = 0; e < EVALUATIONS; ++e)
            if ((pixel = cell(hop, work, job, e, last, add)))
                for (int corner = 0; corner < 4; ++corner)
                    pixel[(corner & 1) + (corner & 2 ? hop->width : 0)] -= add[corner];
        memcpy(hop->sum, sums, sizeof sums);
    }
}
