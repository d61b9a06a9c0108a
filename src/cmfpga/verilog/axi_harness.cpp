// Drives the verilated AXI top behind a C interface that Python's ctypes can call: register accesses, a queue of words
// for s_axis, a list of words from m_axis, and the interrupt. The clock only runs inside these functions.

#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "Vcore.h"
#include "verilated.h"

namespace {

struct Word {
    uint64_t data;
    bool last;
};

struct Simulation {
    std::unique_ptr<VerilatedContext> context{new VerilatedContext};
    std::unique_ptr<Vcore> top;
    std::deque<Word> sending;
    std::vector<Word> received;
    int64_t packets = 0;        // complete ones among them
    int64_t send_limit = -1;    // words that may still be offered; below 0: all
    int64_t accept_limit = -1;  // packets that may still be taken; below 0: all
    int64_t word_limit = -1;    // words that may still be taken; below 0: all
    int64_t cycles = 0;

    explicit Simulation(int seed) {
        // Memories and registers without a reset start with random contents, as after a reset in mid-flight.
        context->randReset(2);
        context->randSeed(seed);
        top.reset(new Vcore{context.get(), "top"});
    }

    // Outputs as they are in this cycle; inputs may still change.
    void settle() {
        const bool offer = !sending.empty() && send_limit != 0;
        top->s_axis_tvalid = offer;
        top->s_axis_tdata = offer ? sending.front().data : 0;
        top->s_axis_tlast = offer && sending.front().last;
        top->s_axis_tkeep = 0xff;
        top->s_axis_tuser = 0;
        top->m_axis_tready = accept_limit != 0 && word_limit != 0;
        top->aclk = 0;
        top->eval();
    }

    void edge() {
        const bool running = top->aresetn;
        const bool sent = running && top->s_axis_tvalid && top->s_axis_tready;
        const bool got = running && top->m_axis_tvalid && top->m_axis_tready;
        const Word word{top->m_axis_tdata, static_cast<bool>(top->m_axis_tlast)};
        top->aclk = 1;
        top->eval();
        ++cycles;
        if (sent) {
            sending.pop_front();
            if (send_limit > 0) --send_limit;
        }
        if (got) {
            received.push_back(word);
            packets += word.last;
            if (word.last && accept_limit > 0) --accept_limit;
            if (word_limit > 0) --word_limit;
        }
    }

    void step() {
        settle();
        edge();
    }

    void forget() {
        sending.clear();
        received.clear();
        packets = 0;
    }
};

Simulation &of(void *simulation) { return *static_cast<Simulation *>(simulation); }

}  // namespace

extern "C" {

enum Until { CYCLES = 0, INTERRUPT = 1, PACKET = 2, SENT = 3 };

void *axi_new(int seed) { return new Simulation(seed); }

void axi_free(void *simulation) { delete static_cast<Simulation *>(simulation); }

// Hold the reset for some clock cycles. Words on their way are forgotten.
void axi_reset(void *simulation, int64_t cycles) {
    Simulation &s = of(simulation);
    s.forget();
    s.top->s_axi_awvalid = s.top->s_axi_wvalid = s.top->s_axi_arvalid = 0;
    s.top->s_axi_bready = s.top->s_axi_rready = 0;
    s.top->aresetn = 0;
    for (int64_t k = 0; k < cycles; ++k) s.step();
    s.top->aresetn = 1;
}

// 0: done; 1: no answer within `max_cycles`; otherwise the response's code + 256.
int axi_read(void *simulation, uint32_t address, uint32_t *value, int64_t max_cycles) {
    Simulation &s = of(simulation);
    Vcore &top = *s.top;
    top.s_axi_araddr = address;
    top.s_axi_arprot = 0;
    top.s_axi_arvalid = 1;
    top.s_axi_rready = 1;
    int status = 1;
    for (int64_t k = 0; k < max_cycles && status == 1; ++k) {
        s.settle();
        const bool taken = top.s_axi_arvalid && top.s_axi_arready;
        if (top.s_axi_rvalid) {
            *value = top.s_axi_rdata;
            status = top.s_axi_rresp ? 256 + top.s_axi_rresp : 0;
        }
        s.edge();
        if (taken) top.s_axi_arvalid = 0;
    }
    top.s_axi_arvalid = top.s_axi_rready = 0;
    return status;
}

// As axi_read.
int axi_write(void *simulation, uint32_t address, uint32_t value, int64_t max_cycles) {
    Simulation &s = of(simulation);
    Vcore &top = *s.top;
    top.s_axi_awaddr = address;
    top.s_axi_awprot = 0;
    top.s_axi_wdata = value;
    top.s_axi_wstrb = 0xf;
    top.s_axi_awvalid = top.s_axi_wvalid = top.s_axi_bready = 1;
    int status = 1;
    for (int64_t k = 0; k < max_cycles && status == 1; ++k) {
        s.settle();
        const bool address_taken = top.s_axi_awvalid && top.s_axi_awready;
        const bool data_taken = top.s_axi_wvalid && top.s_axi_wready;
        if (top.s_axi_bvalid) status = top.s_axi_bresp ? 256 + top.s_axi_bresp : 0;
        s.edge();
        if (address_taken) top.s_axi_awvalid = 0;
        if (data_taken) top.s_axi_wvalid = 0;
    }
    top.s_axi_awvalid = top.s_axi_wvalid = top.s_axi_bready = 0;
    return status;
}

// Put words behind those that wait to be sent; the last one of them has TLAST, if `last`.
void axi_send(void *simulation, const uint64_t *words, int64_t count, int last) {
    for (int64_t k = 0; k < count; ++k)
        of(simulation).sending.push_back(Word{words[k], last && k + 1 == count});
}

int64_t axi_unsent(void *simulation) { return of(simulation).sending.size(); }

// How many words may still be offered, packets taken, and words of them taken; below 0: no limit.
void axi_limit(void *simulation, int64_t send, int64_t accept, int64_t words) {
    of(simulation).send_limit = send;
    of(simulation).accept_limit = accept;
    of(simulation).word_limit = words;
}

// Forget the words that were not sent, and those that were received.
void axi_forget(void *simulation) { of(simulation).forget(); }

// Run for at most `cycles`, until something is the case; returns whether it is.
int axi_run(void *simulation, int64_t cycles, int until) {
    Simulation &s = of(simulation);
    for (int64_t k = 0;; ++k) {
        s.settle();
        if ((until == INTERRUPT && s.top->irq) || (until == PACKET && s.packets) ||
            (until == SENT && s.sending.empty()))
            return 1;
        if (k == cycles) return until == CYCLES;
        s.edge();
    }
}

// Words of the first complete packet, 0 if there is none; copied if there is room for them, and then removed.
int64_t axi_take(void *simulation, uint64_t *to, int64_t room) {
    Simulation &s = of(simulation);
    if (!s.packets) return 0;
    int64_t count = 0;
    while (!s.received[count++].last) {
    }
    if (count <= room) {
        for (int64_t k = 0; k < count; ++k) to[k] = s.received[k].data;
        s.received.erase(s.received.begin(), s.received.begin() + count);
        --s.packets;
    }
    return count;
}

int64_t axi_cycles(void *simulation) { return of(simulation).cycles; }

}  // extern "C"
