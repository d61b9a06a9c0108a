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
    double v[EVALUATIONS][2];
    Four sum[EVALUATIONS], image[];  // sum: of I*I, I*Dx, I*Dy; image: one after the other
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

// All that is left where a hop has ended.
void run_round(Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) {
        double at[EVALUATIONS][2], g[EVALUATIONS][2];
        scale_all(work, job);
        use(work, 0, 1);
        memcpy(job->v, job->v_start, sizeof job->v);
        beside(job->v, at);
        for (int e = 0; e < EVALUATIONS; ++e) gradient(work, job, at[e], LEVEL, g[e]);
        newton(g, job->v);
    }
}

static size_t images(int width, int height) { return (size_t)EVALUATIONS * width * height * sizeof(Four); }

Hop *hop_new(const Job *job) {
    const int width = (job->width + 1) >> LEVEL, height = (job->height + 1) >> LEVEL;
    Hop *hop = room(sizeof *hop + images(width, height));
    if (!hop) return NULL;
    hop->width = width;
    hop->height = height;
    return hop;
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
    return hop->image + (e * hop->height + j) * hop->width + i;
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

// A whole window, event by event. What it leaves is for run_tail: all but the last event.
void run_follow(Hop *hop, Work *work, Job *job, int64_t count) {
    for (int64_t k = 0; k < count; ++k) {
        scale_all(work, job);
        beside(job->v_start, hop->v);
        memset(hop->sum, 0, sizeof hop->sum);
        memset(hop->image, 0, images(hop->width, hop->height));
        for (int event = 0; event < work->total - 1; ++event) take(hop, work, job, event);
    }
}

// The closing event and the step. Pixels are put back, for the next time; so the time includes that.
void run_tail(Hop *hop, Work *work, Job *job, int64_t count) {
    const int last = work->total - 1;
    for (int64_t k = 0; k < count; ++k) {
        Four add[4], *pixel, sums[EVALUATIONS];
        double g[EVALUATIONS][2];
        memcpy(sums, hop->sum, sizeof sums);
        take(hop, work, job, last);
        for (int j = 0; j < 2 * EVALUATIONS; ++j) g[j / 2][j % 2] = hop->sum[j / 2][1 + j % 2];
        memcpy(job->v, job->v_start, sizeof job->v);
        newton(g, job->v);
        for (int e = 0; e < EVALUATIONS; ++e)
            if ((pixel = cell(hop, work, job, e, last, add)))
                for (int corner = 0; corner < 4; ++corner)
                    pixel[(corner & 1) + (corner & 2 ? hop->width : 0)] -= add[corner];
        memcpy(hop->sum, sums, sizeof sums);
    }
}
