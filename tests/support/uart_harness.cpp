// Drives the verilated serial top behind a C interface that Python's ctypes can call: bytes to uart_rx, bytes from
// uart_tx, and whatever is put on the pins of the sensor's port. The clock only runs inside these functions.

#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "Vcore.h"
#include "verilated.h"

namespace {

struct Pins {
    uint8_t data, hsync, vsync;
};

struct Simulation {
    std::unique_ptr<VerilatedContext> context{new VerilatedContext};
    std::unique_ptr<Vcore> top;
    std::deque<uint8_t> sending, received;
    std::deque<Pins> pins;  // one for each cycle of the sensor's clock
    int64_t divisor, cycles = 0;
    int64_t send_cycle = -1, receive_cycle = -1;  // since the start bit's begin
    int64_t sensor_step, sensor_time = 0;         // half periods, in parts of 1000 of a clock cycle
    uint32_t shift = 0;

    Simulation(int seed, int64_t divisor, int64_t sensor_step) : divisor(divisor), sensor_step(sensor_step) {
        context->randReset(2);
        context->randSeed(seed);
        top.reset(new Vcore{context.get(), "top"});
        top->uart_rx = 1;
    }

    void step() {
        // The line to the board: a start bit, eight bits, a stop bit.
        if (send_cycle < 0 && !sending.empty()) send_cycle = 0;
        if (send_cycle >= 0) {
            const int64_t bit = send_cycle / divisor;
            top->uart_rx = bit == 0 ? 0 : bit <= 8 ? (sending.front() >> (bit - 1)) & 1 : 1;
            if (++send_cycle == 10 * divisor) {
                send_cycle = -1;
                sending.pop_front();
            }
        }
        // And from it, in the middle of each bit.
        if (receive_cycle < 0 && !top->uart_tx) receive_cycle = 0;
        if (receive_cycle >= 0) {
            const int64_t bit = receive_cycle / divisor;
            if (receive_cycle % divisor == divisor / 2) {
                if (bit >= 1 && bit <= 8) shift = (shift >> 1) | (top->uart_tx ? 0x80 : 0);
                if (bit == 9) received.push_back(shift);
            }
            receive_cycle = bit == 9 && receive_cycle % divisor == divisor / 2 ? -1 : receive_cycle + 1;
        }
        // The sensor's clock: pins change at its falling edge.
        for (sensor_time += 1000; sensor_time >= sensor_step; sensor_time -= sensor_step) {
            top->cpi_pclk = !top->cpi_pclk;
            if (!top->cpi_pclk && !pins.empty()) {
                top->cpi_data = pins.front().data;
                top->cpi_hsync = pins.front().hsync;
                top->cpi_vsync = pins.front().vsync;
                pins.pop_front();
            }
            top->eval();
        }
        top->clk = 0;
        top->eval();
        top->clk = 1;
        top->eval();
        ++cycles;
    }
};

Simulation &of(void *simulation) { return *static_cast<Simulation *>(simulation); }

}  // namespace

extern "C" {

// `sensor_step`: half a period of the sensor's clock, in thousandths of a clock cycle.
void *uart_new(int seed, int64_t divisor, int64_t sensor_step) {
    auto *made = new Simulation(seed, divisor, sensor_step);
    made->top->rst = 1;
    for (int k = 0; k < 16; ++k) made->step();
    made->top->rst = 0;
    made->receive_cycle = -1;  // whatever the wire was before the reset
    made->received.clear();
    return made;
}

void uart_free(void *simulation) { delete static_cast<Simulation *>(simulation); }

void uart_send(void *simulation, const uint8_t *bytes, int64_t count) {
    of(simulation).sending.insert(of(simulation).sending.end(), bytes, bytes + count);
}

// Three bytes for each cycle of the sensor's clock: data, HSYNC, VSYNC.
void uart_sensor(void *simulation, const uint8_t *levels, int64_t count) {
    for (int64_t k = 0; k < count; ++k)
        of(simulation).pins.push_back(Pins{levels[3 * k], levels[3 * k + 1], levels[3 * k + 2]});
}

int64_t uart_sensor_left(void *simulation) { return of(simulation).pins.size(); }

// Run for at most `cycles`, or until bytes have come and so many cycles without another; the bytes, at most `room`.
int64_t uart_run(void *simulation, int64_t cycles, uint8_t *to, int64_t room) {
    Simulation &s = of(simulation);
    const int64_t quiet = 12 * s.divisor;
    int64_t last = 0, seen = s.received.size();
    for (int64_t k = 0; k < cycles && !(seen && k - last > quiet); ++k) {
        s.step();
        if (static_cast<int64_t>(s.received.size()) != seen) {
            seen = s.received.size();
            last = k;
        }
    }
    int64_t count = 0;
    for (; count < room && !s.received.empty(); ++count) {
        to[count] = s.received.front();
        s.received.pop_front();
    }
    return count;
}

int64_t uart_cycles(void *simulation) { return of(simulation).cycles; }

}  // extern "C"
