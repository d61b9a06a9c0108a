// Test bench of cmfpga_core in plain Verilog-2001, for any simulator.
//
// make_vectors.py writes what it needs: vectors.vh with numbers and the core's ports, and memories: the batches with their
// settings, the events, the schedules, and what the bit-exact integer model says to each batch's result and iteration.
//
// Inputs change at the falling edge of the clock, outputs are looked at on the rising edge. Whatever is not valid is
// X: events in a gap, the settings once they are taken over, and at first every memory of the core.
//
// The last line says PASS or FAIL.

module tb_cmfpga_core;
  localparam SHOWN = 64;  // mismatches that are printed; one more ends the run

  reg clk = 0;
  reg rst = 1;
  always #5 clk = ~clk;

  // The core, and what goes through all of its ports: drive_…, write_schedule, write_nodes, compare_…, sum_pixels, clear_pixels.
  `include "vectors.vh"

  // ---------------------------------------------------------------- vectors

  reg [BATCHES_BITS-1:0] batches [0:BATCHES-1];
  reg [EVENTS_BITS-1:0] events [0:EVENTS-1];
  reg [RESULTS_BITS-1:0] results [0:BATCHES-1];
  reg [TRACE_BITS-1:0] trace [0:TRACE-1];

  initial begin
    $readmemb("batches.mem", batches);
    $readmemb("events.mem", events);
    $readmemb("results.mem", results);
    $readmemb("trace.mem", trace);
  end

  // ---------------------------------------------------------------- bookkeeping

  integer cycle = 0;
  integer checks = 0;
  integer mismatches = 0;
  integer quiet = 0;     // clock cycles since something happened
  integer accepted = 0;  // events, of all batches
  integer batch = 0;     // that the core is busy with
  integer iteration = 0; // of this batch
  integer traced = 0;    // iterations of the batches before

  task check(input [8*32-1:0] what, input [63:0] got, input [63:0] wanted);
    begin
      checks = checks + 1;
      if (got !== wanted) begin
        mismatches = mismatches + 1;
        if (mismatches <= SHOWN)
          $display("cycle %0d, batch %0d, iteration %0d: %0s is %h, %h is right",
            cycle, batch, iteration, what, got, wanted);
        if (mismatches == SHOWN + 1) finish;
      end
    end
  endtask

  task finish;
    begin
      if (mismatches == 0)
        $display("PASS: %0d batches, %0d events, %0d iterations, %0d checks in %0d clock cycles",
          BATCHES, EVENTS, TRACE, checks, cycle);
      else
        $display("FAIL: %0d of %0d checks in %0d clock cycles", mismatches, checks, cycle);
      $finish(0);
    end
  endtask

  always @(posedge clk) begin
    cycle <= cycle + 1;
    quiet <= quiet + 1;
    if (rst | trace_valid | event_valid & event_ready | result_valid & result_ready) quiet <= 0;
    if (quiet > PATIENCE) begin
      $display("nothing happened for %0d clock cycles: %0d of %0d events accepted, %0d of %0d batches done",
        quiet, accepted, EVENTS, batch, BATCHES);
      $display("FAIL: time-out, and %0d of %0d checks in %0d clock cycles", mismatches, checks, cycle);
      $finish(0);
    end
  end

  // ---------------------------------------------------------------- events and settings, as fast as they are taken

  integer sent, event_number;
  reg [31:0] event_count;
  reg [15:0] stall;
  reg [31:0] reset_after;
  reg alone;
  reg [BATCHES_PORTS-1:0] settings;
  reg [7:0] gap;
  reg [EVENTS_PORTS-1:0] event_word;
  integer offered [0:BATCHES-1];  // cycle in which a batch's first event was offered
  integer began [0:BATCHES-1];    // cycle before it was accepted: in this one the core took the settings over
  integer opened = 0;             // first cycle in which an idle core may do so

  task reset;
    begin
      rst = 1;
      repeat (3) @(negedge clk);
      rst = 0;
      // Then the core sweeps its banks, one address per cycle.
      opened = cycle + CLEARING;
    end
  endtask

  initial begin
    event_number = 0;
    reset;
    write_schedule;
    write_nodes;
    for (sent = 0; sent < BATCHES; sent = sent + 1) begin
      {event_count, stall, reset_after, alone, settings} = batches[sent];
      if (alone) while (batch < sent) @(negedge clk);
      drive_batches(settings);
      offered[sent] = -1;
      repeat (event_count) begin
        {gap, event_word} = events[event_number];
        repeat (gap) @(negedge clk);
        event_valid = 1;
        drive_events(event_word);
        if (offered[sent] < 0) begin
          offered[sent] = cycle;
          began[sent] = -1;
        end
        @(posedge clk);
        while (event_ready !== 1'b1) @(posedge clk);
        if (began[sent] < 0) begin
          began[sent] = cycle - 1;
          check("no more batches than buffers", sent - batch < BUFFERS, 1);
        end
        accepted = accepted + 1;
        event_number = event_number + 1;
        @(negedge clk);
        event_valid = 0;
        drive_events({EVENTS_PORTS{1'bx}});
        drive_batches({BATCHES_PORTS{1'bx}});
      end
      if (reset_after != 0) begin
        repeat (reset_after) @(negedge clk);
        reset;
        next_batch;
      end
    end
  end

  // ---------------------------------------------------------------- what must come out

  // The part of a word without ports, and nothing of the part with them.
  reg [31:0] iterations;
  reg [RESULTS_BITS-33:0] unused_result;
  reg [31:0] unused_count;
  reg [15:0] wait_for;
  reg [31:0] doomed;
  reg was_alone;
  reg [BATCHES_PORTS-1:0] unused_settings;

  task look_up_batch;
    begin
      {iterations, unused_result} = results[batch];
      {unused_count, wait_for, doomed, was_alone, unused_settings} = batches[batch];
    end
  endtask

  // On to the next one, of which the core knows nothing yet, or with two buffers nothing but its events.
  task next_batch;
    begin
      look_up_batch;
      traced = traced + iterations;
      iteration = 0;
      clear_pixels;
      batch = batch + 1;
    end
  endtask

  task check_iteration;
    begin
      compare_trace(trace[traced + iteration]);
      compare_pixels(trace[traced + iteration]);
      clear_pixels;
      iteration = iteration + 1;
    end
  endtask

  // ---------------------------------------------------------------- results

  integer waited = 0;  // clock cycles for which the result has been waiting
  integer idle = 0;    // clock cycles after the last batch
  reg [RESULTS_BITS-33:0] earlier;

  task check_result;
    begin
      look_up_batch;
      check("reset expected", 0, doomed);
      check("iterations traced", iteration, iterations);
      compare_results(results[batch]);
      // The core's count must be what the formula says, where that holds, and what is seen here.
      check("cycles measured", cycle - began[batch], result_cycles);
      if (BUFFERS == 1 || was_alone)
        check("cycles until opened", began[batch], offered[batch] > opened ? offered[batch] : opened);
    end
  endtask

  always @(posedge clk) if (!rst) begin
    sum_pixels;
    if (batch == BATCHES) begin
      check("trace_valid", trace_valid, 0);
      check("result_valid", result_valid, 0);
      idle = idle + 1;
      if (idle == 100) begin
        check("events accepted", accepted, EVENTS);
        check("iterations", traced, TRACE);
        finish;
      end
    end
    else begin
      if (trace_valid !== 1'b0) check_iteration;
      if (waited != 0) begin
        // Nothing may change while the result waits.
        check("result_valid", result_valid, 1);
        check("the waiting result", results_now === earlier, 1);
      end
      else if (result_valid !== 1'b0) check_result;
      earlier = results_now;
      if (result_valid !== 1'b0) begin
        if (BUFFERS == 1) check("event_ready", event_ready, 0);
        waited = waited + 1;
        if (result_ready) begin
          waited = 0;
          opened = cycle + 1;
          next_batch;
        end
      end
    end
  end

  // A result that must not wait finds result_ready high already.
  always @(negedge clk) if (batch < BATCHES) begin
    look_up_batch;
    result_ready = waited >= wait_for;
  end
endmodule
