// Drives the verilated core batch by batch, behind a C interface that Python's ctypes can call.
//
// ports.inc is generated from the core's port list: set_settings(), set_table(), get_result(), get_traces(),
// get_pixels(), get_wave(), and the number of values that each handles.

#include <cstdint>
#include <memory>
#include <vector>

#include "Vcore.h"
#include "verilated.h"

#include "ports.inc"

namespace {

// A wave port has another value than in the cycle before.
struct Change {
    int64_t value;
    int32_t cycle, port;
};

struct Simulation {
    std::unique_ptr<VerilatedContext> context{new VerilatedContext};
    std::unique_ptr<Vcore> top;
    bool recording = false;  // of the wave ports
    int32_t now = 0;         // clock cycles since it began
    std::vector<int64_t> last;
    std::vector<Change> changes;

    explicit Simulation(int seed) {
        // Memories and registers without a reset start with random contents, as after a reset in mid-flight.
        context->randReset(2);
        context->randSeed(seed);
        top.reset(new Vcore{context.get(), "cmfpga_core"});
    }
    void settle() {
        top->clk = 0;
        top->eval();
    }
    void record() {
        int64_t values[WAVE_VALUES + 1];
        get_wave(*top, values);
        for (int32_t port = 0; port < WAVE_VALUES; ++port)
            if (!now || values[port] != last[port]) changes.push_back({values[port], now, port});
        last.assign(values, values + WAVE_VALUES);
        ++now;
    }
    void edge() {
        if (recording) record();
        top->clk = 1;
        top->eval();
    }
};

}  // namespace

extern "C" {

// Batches and what comes of them; the layout is repeated in core.py.
struct Run {
    const int64_t *settings;       // [batches][SETTINGS_VALUES]: from its batch's first offer on
    const int64_t *t, *x, *y;      // events of all batches; the last one of each ends it, unless `open_end`
    const int64_t *ends;           // [batches]: index behind each batch's last event
    const int64_t *gaps;           // idle cycles before each event, or null
    const int64_t *stalls;         // [outcomes]: cycles for which each result is left waiting
    int64_t *results;              // [outcomes][RESULT_VALUES]
    int64_t *offered, *valid;      // [batches], [outcomes]: cycle of the first offer, and of the result
    int64_t *trace;                // [trace_rows][TRACE_VALUES], of all batches
    int64_t *pixels;               // [pixel_rows][PIXEL_VALUES], of all batches, or null
    int64_t batches, outcomes;     // results come as often as that, of all batches; of windows that slide at most
    int64_t open_end;              // do not mark the last event of a batch
    int64_t max_cycles;            // give up after these
    int64_t trace_rows, pixel_rows;
    // Returned:
    int64_t accepted;              // events that the core took
    int64_t trace_count;           // iterations seen
    int64_t pixel_count;           // sweep addresses seen
    int64_t results_count;
};

enum Status { DONE = 0, TIMED_OUT = 1, RESULT_CHANGED = 2 };

void *core_new(int seed) { return new Simulation(seed); }

void core_free(void *simulation) { delete static_cast<Simulation *>(simulation); }

void core_reset(void *simulation, int64_t cycles) {
    Simulation &s = *static_cast<Simulation *>(simulation);
    s.top->event_valid = 0;
    s.top->result_ready = 0;
    s.top->rst = 1;
    for (int64_t k = 0; k < cycles; ++k) {
        s.settle();
        s.edge();
    }
    s.top->rst = 0;
}

// Record the wave ports from now on.
void core_wave_start(void *simulation) { static_cast<Simulation *>(simulation)->recording = true; }

int64_t core_wave_count(void *simulation) { return static_cast<Simulation *>(simulation)->changes.size(); }

// The recorded changes, in the order of time; each array has core_wave_count() elements.
void core_wave_take(void *simulation, int32_t *cycles, int32_t *ports, int64_t *values) {
    for (const Change &change : static_cast<Simulation *>(simulation)->changes) {
        *cycles++ = change.cycle;
        *ports++ = change.port;
        *values++ = change.value;
    }
}

// Write so many words of a table, one a clock cycle: what each of its ports but `valid` gets, `ports` values in a row.
// Only while no batch is under way.
void core_write_table(void *simulation, int table, const int64_t *rows, int64_t ports, int64_t words) {
    Simulation &s = *static_cast<Simulation *>(simulation);
    s.top->event_valid = 0;
    s.top->result_ready = 0;
    for (int64_t k = 0; k < words; ++k) {
        set_table(*s.top, table, true, rows + ports * k);
        s.settle();
        s.edge();
    }
    if (words) set_table(*s.top, table, false, rows);
    s.settle();
    s.edge();
}

// Offer batches without a pause between them, and take results at once or after a stall.
int core_run(void *simulation, Run *run) {
    Simulation &s = *static_cast<Simulation *>(simulation);
    Vcore &top = *s.top;
    int64_t event = 0, batch = 0, waited = -1;
    int64_t gap = run->gaps ? run->gaps[0] : 0;
    for (int64_t b = 0; b < run->batches; ++b) run->offered[b] = -1;
    for (int64_t cycle = 0; cycle < run->max_cycles; ++cycle) {
        const bool offer = batch < run->batches && gap == 0;
        top.event_valid = offer;
        if (offer) {
            if (run->offered[batch] < 0) {
                set_settings(top, run->settings + SETTINGS_VALUES * batch);
                run->offered[batch] = cycle;
            }
            set_event(top, run->t[event], run->x[event], run->y[event],
                      event + 1 == run->ends[batch] && !run->open_end);
        }
        const int64_t number = run->results_count;
        top.result_ready = waited >= run->stalls[number];
        s.settle();

        const bool pixels = pixels_valid(top);
        run->trace_count += get_traces(top, run->trace + TRACE_VALUES * run->trace_count,
                                       run->trace_rows - run->trace_count);
        if (run->pixels && pixels && run->pixel_count < run->pixel_rows)
            get_pixels(top, run->pixels + PIXEL_VALUES * run->pixel_count);
        run->pixel_count += pixels;

        if (batch == run->batches && !busy(top)) return DONE;

        const bool accepted = offer && top.event_ready;
        bool taken = false;
        if (top.result_valid) {
            int64_t now[RESULT_VALUES], *kept = run->results + RESULT_VALUES * number;
            get_result(top, now);
            for (int k = 0; k < RESULT_VALUES; ++k) {
                if (waited >= 0 && kept[k] != now[k]) return RESULT_CHANGED;
                kept[k] = now[k];
            }
            if (++waited == 0) run->valid[number] = cycle;
            taken = top.result_ready;
        } else if (waited >= 0) {
            return RESULT_CHANGED;
        }
        s.edge();
        if (accepted) {
            run->accepted = ++event;
            if (event == run->ends[batch]) ++batch;
            gap = run->gaps && batch < run->batches ? run->gaps[event] : 0;
        } else if (gap > 0) {
            --gap;
        }
        if (taken) {
            waited = -1;
            if (++run->results_count == run->outcomes) return DONE;
        }
    }
    return TIMED_OUT;
}

}  // extern "C"
