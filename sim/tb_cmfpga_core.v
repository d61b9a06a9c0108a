// Test bench of cmfpga_core in plain Verilog-2001, for any simulator.
//
// make_vectors.py writes what it needs: vectors.vh with the numbers and widths, and four memories: the batches with
// their settings, the events, and what the bit-exact integer model says to each batch's result and each iteration.
//
// Inputs change at the falling edge of the clock, outputs are looked at on the rising edge. Whatever is not valid is
// X: events in a gap, the settings once they are taken over, and at first every memory of the core.
//
// The last line says PASS or FAIL.

module tb_cmfpga_core;
  `include "vectors.vh"

  localparam SHOWN = 40;  // mismatches that are printed
  localparam SETTINGS_BITS = BATCHES_BITS - 32 - STALL_BITS - RESET_BITS;

  reg clk = 0;
  reg rst = 1;
  always #5 clk = ~clk;

  // ---------------------------------------------------------------- the core

  reg event_valid = 0;
  wire event_ready;
  reg [EVENT_T-1:0] event_t;
  reg [EVENT_X-1:0] event_x;
  reg [EVENT_Y-1:0] event_y;
  reg event_last;

  reg settings_roi_load;
  reg [SETTINGS_ROI_X-1:0] settings_roi_x;
  reg [SETTINGS_ROI_Y-1:0] settings_roi_y;
  reg [SETTINGS_BATCH_EVENTS-1:0] settings_batch_events;
  reg [SETTINGS_BATCH_ROI_EVENTS-1:0] settings_batch_roi_events;
  reg [SETTINGS_THINNING-1:0] settings_thinning;
  reg [SETTINGS_THIN_TARGET-1:0] settings_thin_target;
  reg [SETTINGS_ITERATIONS-1:0] settings_iterations;
  reg [SETTINGS_ETA-1:0] settings_eta;
  reg [SETTINGS_ROI_GAIN-1:0] settings_roi_gain;
  reg settings_start_last;
  reg [SETTINGS_V_START_X-1:0] settings_v_start_x;
  reg [SETTINGS_V_START_Y-1:0] settings_v_start_y;
  reg [SETTINGS_MIN_ROI_EVENTS-1:0] settings_min_roi_events;

  wire result_valid;
  reg result_ready = 0;
  wire [RESULT_V_X-1:0] result_v_x;
  wire [RESULT_V_Y-1:0] result_v_y;
  wire [RESULT_T_FIRST-1:0] result_t_first;
  wire [RESULT_SPAN-1:0] result_span;
  wire [RESULT_EVENTS-1:0] result_events;
  wire [RESULT_ROI_EVENTS-1:0] result_roi_events;
  wire [RESULT_OUTSIDE-1:0] result_outside;
  wire [RESULT_OVERFLOW-1:0] result_overflow;
  wire [RESULT_THINNED-1:0] result_thinned;
  wire [RESULT_TIME_BACK-1:0] result_time_back;
  wire [RESULT_TIME_SPAN-1:0] result_time_span;
  wire [RESULT_ROI_X-1:0] result_roi_x;
  wire [RESULT_ROI_Y-1:0] result_roi_y;
  wire [RESULT_ROI_NEXT_X-1:0] result_roi_next_x;
  wire [RESULT_ROI_NEXT_Y-1:0] result_roi_next_y;
  wire [RESULT_ITERATIONS-1:0] result_iterations;
  wire [RESULT_SUMS_I-1:0] result_sums_i;
  wire [RESULT_SUMS_DX-1:0] result_sums_dx;
  wire [RESULT_SUMS_DY-1:0] result_sums_dy;
  wire [RESULT_SUMS_SX-1:0] result_sums_sx;
  wire [RESULT_SUMS_SY-1:0] result_sums_sy;
  wire [RESULT_CYCLES-1:0] result_cycles;
  wire [RESULT_FLAGS-1:0] result_flags;

  wire trace_valid;
  wire [TRACE_V_X-1:0] trace_v_x;
  wire [TRACE_V_Y-1:0] trace_v_y;
  wire [TRACE_SUMS_I-1:0] trace_sums_i;
  wire [TRACE_SUMS_DX-1:0] trace_sums_dx;
  wire [TRACE_SUMS_DY-1:0] trace_sums_dy;
  wire [TRACE_SUMS_SX-1:0] trace_sums_sx;
  wire [TRACE_SUMS_SY-1:0] trace_sums_sy;

  wire trace_pixels_valid;
  wire [TRACE_PIXELS_0_I-1:0] trace_pixels_0_i;
  wire [TRACE_PIXELS_1_I-1:0] trace_pixels_1_i;
  wire [TRACE_PIXELS_2_I-1:0] trace_pixels_2_i;
  wire [TRACE_PIXELS_3_I-1:0] trace_pixels_3_i;
  wire signed [TRACE_PIXELS_0_DX-1:0] trace_pixels_0_dx;
  wire signed [TRACE_PIXELS_1_DX-1:0] trace_pixels_1_dx;
  wire signed [TRACE_PIXELS_2_DX-1:0] trace_pixels_2_dx;
  wire signed [TRACE_PIXELS_3_DX-1:0] trace_pixels_3_dx;
  wire signed [TRACE_PIXELS_0_DY-1:0] trace_pixels_0_dy;
  wire signed [TRACE_PIXELS_1_DY-1:0] trace_pixels_1_dy;
  wire signed [TRACE_PIXELS_2_DY-1:0] trace_pixels_2_dy;
  wire signed [TRACE_PIXELS_3_DY-1:0] trace_pixels_3_dy;

  cmfpga_core core (
    .clk(clk),
    .rst(rst),
    .event_valid(event_valid),
    .event_t(event_t),
    .event_x(event_x),
    .event_y(event_y),
    .event_last(event_last),
    .settings_roi_load(settings_roi_load),
    .settings_roi_x(settings_roi_x),
    .settings_roi_y(settings_roi_y),
    .settings_batch_events(settings_batch_events),
    .settings_batch_roi_events(settings_batch_roi_events),
    .settings_thinning(settings_thinning),
    .settings_thin_target(settings_thin_target),
    .settings_iterations(settings_iterations),
    .settings_eta(settings_eta),
    .settings_roi_gain(settings_roi_gain),
    .settings_start_last(settings_start_last),
    .settings_v_start_x(settings_v_start_x),
    .settings_v_start_y(settings_v_start_y),
    .settings_min_roi_events(settings_min_roi_events),
    .result_ready(result_ready),
    .event_ready(event_ready),
    .result_valid(result_valid),
    .result_v_x(result_v_x),
    .result_v_y(result_v_y),
    .result_t_first(result_t_first),
    .result_span(result_span),
    .result_events(result_events),
    .result_roi_events(result_roi_events),
    .result_outside(result_outside),
    .result_overflow(result_overflow),
    .result_thinned(result_thinned),
    .result_time_back(result_time_back),
    .result_time_span(result_time_span),
    .result_roi_x(result_roi_x),
    .result_roi_y(result_roi_y),
    .result_roi_next_x(result_roi_next_x),
    .result_roi_next_y(result_roi_next_y),
    .result_iterations(result_iterations),
    .result_sums_i(result_sums_i),
    .result_sums_dx(result_sums_dx),
    .result_sums_dy(result_sums_dy),
    .result_sums_sx(result_sums_sx),
    .result_sums_sy(result_sums_sy),
    .result_cycles(result_cycles),
    .result_flags(result_flags),
    .trace_valid(trace_valid),
    .trace_v_x(trace_v_x),
    .trace_v_y(trace_v_y),
    .trace_sums_i(trace_sums_i),
    .trace_sums_dx(trace_sums_dx),
    .trace_sums_dy(trace_sums_dy),
    .trace_sums_sx(trace_sums_sx),
    .trace_sums_sy(trace_sums_sy),
    .trace_pixels_valid(trace_pixels_valid),
    .trace_pixels_0_i(trace_pixels_0_i),
    .trace_pixels_0_dx(trace_pixels_0_dx),
    .trace_pixels_0_dy(trace_pixels_0_dy),
    .trace_pixels_1_i(trace_pixels_1_i),
    .trace_pixels_1_dx(trace_pixels_1_dx),
    .trace_pixels_1_dy(trace_pixels_1_dy),
    .trace_pixels_2_i(trace_pixels_2_i),
    .trace_pixels_2_dx(trace_pixels_2_dx),
    .trace_pixels_2_dy(trace_pixels_2_dy),
    .trace_pixels_3_i(trace_pixels_3_i),
    .trace_pixels_3_dx(trace_pixels_3_dx),
    .trace_pixels_3_dy(trace_pixels_3_dy)
  );

  // ---------------------------------------------------------------- vectors

  reg [BATCHES_BITS-1:0] batches [0:BATCHES-1];
  reg [EVENTS_BITS-1:0] events [0:EVENTS-1];
  reg [RESULTS_BITS-1:0] results [0:BATCHES-1];
  reg [TRACE_BITS-1:0] trace [0:ITERATIONS-1];

  initial begin
    $readmemh("batches.hex", batches);
    $readmemh("events.hex", events);
    $readmemh("results.hex", results);
    $readmemh("trace.hex", trace);
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

  task check(input [8*20-1:0] what, input [63:0] got, input [63:0] wanted);
    begin
      checks = checks + 1;
      if (got !== wanted) begin
        mismatches = mismatches + 1;
        if (mismatches <= SHOWN)
          $display("cycle %0d, batch %0d, iteration %0d: %0s is %h, %h is right",
            cycle, batch, iteration, what, got, wanted);
      end
    end
  endtask

  task finish;
    begin
      if (mismatches == 0)
        $display("PASS: %0d batches, %0d events, %0d iterations, %0d checks in %0d clock cycles",
          BATCHES, EVENTS, ITERATIONS, checks, cycle);
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
  reg [STALL_BITS-1:0] unused_stall;
  reg [RESET_BITS-1:0] reset_after;
  reg [GAP_BITS-1:0] gap;
  reg last;
  reg [EVENT_T-1:0] t;
  reg [EVENT_X-1:0] x;
  reg [EVENT_Y-1:0] y;
  reg [SETTINGS_BITS-1:0] settings;
  integer offered [0:BATCHES-1];  // cycle in which a batch's first event was offered
  integer opened = 0;             // first cycle in which the core may take over the next batch's settings

  task drive_settings(input [SETTINGS_BITS-1:0] value);
    {settings_roi_load, settings_roi_x, settings_roi_y, settings_batch_events, settings_batch_roi_events,
      settings_thinning, settings_thin_target, settings_iterations, settings_eta, settings_roi_gain, settings_start_last, settings_v_start_x, settings_v_start_y,
      settings_min_roi_events} = value;
  endtask

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
    for (sent = 0; sent < BATCHES; sent = sent + 1) begin
      {event_count, unused_stall, reset_after, settings} = batches[sent];
      drive_settings(settings);
      offered[sent] = -1;
      repeat (event_count) begin
        {gap, t, x, y, last} = events[event_number];
        repeat (gap) @(negedge clk);
        event_valid = 1;
        event_t = t;
        event_x = x;
        event_y = y;
        event_last = last;
        if (offered[sent] < 0) offered[sent] = cycle;
        @(posedge clk);
        while (event_ready !== 1'b1) @(posedge clk);
        accepted = accepted + 1;
        event_number = event_number + 1;
        @(negedge clk);
        event_valid = 0;
        event_t = {EVENT_T{1'bx}};
        event_x = {EVENT_X{1'bx}};
        event_y = {EVENT_Y{1'bx}};
        event_last = 1'bx;
        drive_settings({SETTINGS_BITS{1'bx}});
      end
      if (reset_after != 0) begin
        repeat (reset_after) @(negedge clk);
        reset;
        next_batch;
      end
    end
  end

  // ---------------------------------------------------------------- what must come out

  reg [31:0] iterations;
  reg [RESULT_V_X-1:0] v_x;
  reg [RESULT_V_Y-1:0] v_y;
  reg [RESULT_T_FIRST-1:0] t_first;
  reg [RESULT_SPAN-1:0] span;
  reg [RESULT_EVENTS-1:0] total;
  reg [RESULT_ROI_EVENTS-1:0] roi_events;
  reg [RESULT_OUTSIDE-1:0] outside;
  reg [RESULT_OVERFLOW-1:0] overflow;
  reg [RESULT_THINNED-1:0] thinned;
  reg [RESULT_TIME_BACK-1:0] time_back;
  reg [RESULT_TIME_SPAN-1:0] time_span;
  reg [RESULT_ROI_X-1:0] roi_x;
  reg [RESULT_ROI_Y-1:0] roi_y;
  reg [RESULT_ROI_NEXT_X-1:0] roi_next_x;
  reg [RESULT_ROI_NEXT_Y-1:0] roi_next_y;
  reg [RESULT_ITERATIONS-1:0] iterations_done;
  reg [RESULT_SUMS_I-1:0] sums_i;
  reg [RESULT_SUMS_DX-1:0] sums_dx;
  reg [RESULT_SUMS_DY-1:0] sums_dy;
  reg [RESULT_SUMS_SX-1:0] sums_sx;
  reg [RESULT_SUMS_SY-1:0] sums_sy;
  reg [RESULT_CYCLES-1:0] cycles;
  reg [RESULT_FLAGS-1:0] flags;

  // The memories' words; the first port is at the top.
  task look_up_result;
    {iterations, v_x, v_y, t_first, span, total, roi_events, outside, overflow, thinned, time_back, time_span, roi_x, roi_y,
      roi_next_x, roi_next_y, iterations_done, sums_i, sums_dx, sums_dy, sums_sx, sums_sy, cycles,
      flags} = results[batch];
  endtask

  reg [TRACE_V_X-1:0] used_v_x;
  reg [TRACE_V_Y-1:0] used_v_y;
  reg [TRACE_SUMS_I-1:0] found_i;
  reg [TRACE_SUMS_DX-1:0] found_dx;
  reg [TRACE_SUMS_DY-1:0] found_dy;
  reg [TRACE_SUMS_SX-1:0] found_sx;
  reg [TRACE_SUMS_SY-1:0] found_sy;

  task look_up_iteration;
    {used_v_x, used_v_y, found_i, found_dx, found_dy, found_sx, found_sy} = trace[traced + iteration];
  endtask

  // On to the next one, of which the core knows nothing yet.
  task next_batch;
    begin
      look_up_result;
      traced = traced + iterations;
      iteration = 0;
      clear_pixels;
      batch = batch + 1;
    end
  endtask

  // ---------------------------------------------------------------- iterations

  // The images, summed here: what trace_pixels shows must be what the core's own sums say.
  integer pixel_words = 0;
  reg [63:0] pixels_i = 0;
  reg signed [63:0] pixels_dx = 0, pixels_dy = 0;

  task clear_pixels;
    begin
      pixel_words = 0;
      pixels_i = 0;
      pixels_dx = 0;
      pixels_dy = 0;
    end
  endtask

  task sum_pixels;
    begin
      pixel_words = pixel_words + 1;
      pixels_i = pixels_i + trace_pixels_0_i + trace_pixels_1_i + trace_pixels_2_i + trace_pixels_3_i;
      pixels_dx = pixels_dx + trace_pixels_0_dx + trace_pixels_1_dx + trace_pixels_2_dx + trace_pixels_3_dx;
      pixels_dy = pixels_dy + trace_pixels_0_dy + trace_pixels_1_dy + trace_pixels_2_dy + trace_pixels_3_dy;
    end
  endtask

  task check_iteration;
    begin
      look_up_iteration;
      check("trace_v_x", trace_v_x, used_v_x);
      check("trace_v_y", trace_v_y, used_v_y);
      check("trace_sums_i", trace_sums_i, found_i);
      check("trace_sums_dx", trace_sums_dx, found_dx);
      check("trace_sums_dy", trace_sums_dy, found_dy);
      check("trace_sums_sx", trace_sums_sx, found_sx);
      check("trace_sums_sy", trace_sums_sy, found_sy);
      check("words of pixels", pixel_words, BANK_WORDS);
      check("sum of pixels, i", pixels_i, found_i);
      check("sum of pixels, dx", pixels_dx[TRACE_SUMS_DX-1:0], found_dx);
      check("sum of pixels, dy", pixels_dy[TRACE_SUMS_DY-1:0], found_dy);
      clear_pixels;
      iteration = iteration + 1;
    end
  endtask

  // ---------------------------------------------------------------- results

  integer waited = 0;  // clock cycles for which the result has been waiting
  integer started;
  integer idle = 0;    // clock cycles after the last batch
  reg [RESULTS_BITS-1:0] now, earlier;
  reg [31:0] unused_count;
  reg [STALL_BITS-1:0] stall;
  reg [RESET_BITS-1:0] doomed;
  reg [SETTINGS_BITS-1:0] unused_settings;

  task check_result;
    begin
      look_up_result;
      check("reset expected", 0, doomed);
      check("iterations traced", iteration, iterations);
      check("result_v_x", result_v_x, v_x);
      check("result_v_y", result_v_y, v_y);
      check("result_t_first", result_t_first, t_first);
      check("result_span", result_span, span);
      check("result_events", result_events, total);
      check("result_roi_events", result_roi_events, roi_events);
      check("result_outside", result_outside, outside);
      check("result_overflow", result_overflow, overflow);
      check("result_thinned", result_thinned, thinned);
      check("result_time_back", result_time_back, time_back);
      check("result_time_span", result_time_span, time_span);
      check("result_roi_x", result_roi_x, roi_x);
      check("result_roi_y", result_roi_y, roi_y);
      check("result_roi_next_x", result_roi_next_x, roi_next_x);
      check("result_roi_next_y", result_roi_next_y, roi_next_y);
      check("result_iterations", result_iterations, iterations_done);
      check("result_flags", result_flags, flags);
      // They mean nothing in a degenerate batch.
      if (!flags[0]) begin
        check("result_sums_i", result_sums_i, sums_i);
        check("result_sums_dx", result_sums_dx, sums_dx);
        check("result_sums_dy", result_sums_dy, sums_dy);
        check("result_sums_sx", result_sums_sx, sums_sx);
        check("result_sums_sy", result_sums_sy, sums_sy);
      end
      // The core's count must be what the formula says (0: it says nothing of this batch), and what is seen here.
      if (cycles != 0) check("result_cycles", result_cycles, cycles);
      started = offered[batch] > opened ? offered[batch] : opened;
      check("cycles measured", cycle - started, result_cycles);
    end
  endtask

  always @(posedge clk) if (!rst) begin
    if (trace_pixels_valid !== 1'b0) sum_pixels;
    if (batch == BATCHES) begin
      check("trace_valid", trace_valid, 0);
      check("result_valid", result_valid, 0);
      idle = idle + 1;
      if (idle == 100) begin
        check("events accepted", accepted, EVENTS);
        check("iterations", traced, ITERATIONS);
        finish;
      end
    end
    else begin
      if (trace_valid !== 1'b0) check_iteration;
      now = {result_v_x, result_v_y, result_t_first, result_span, result_events, result_roi_events, result_outside,
        result_overflow, result_thinned, result_time_back, result_time_span, result_roi_x, result_roi_y, result_roi_next_x,
        result_roi_next_y, result_iterations, result_sums_i, result_sums_dx, result_sums_dy, result_sums_sx,
        result_sums_sy, result_cycles, result_flags};
      if (waited != 0) begin
        // Nothing may change while the result waits.
        check("result_valid", result_valid, 1);
        check("the waiting result", now === earlier, 1);
      end
      else if (result_valid !== 1'b0) check_result;
      earlier = now;
      if (result_valid !== 1'b0) begin
        check("event_ready", event_ready, 0);
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
    {unused_count, stall, doomed, unused_settings} = batches[batch];
    result_ready = waited >= stall;
  end
endmodule
