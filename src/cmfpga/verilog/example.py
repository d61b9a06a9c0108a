"""An instance of the core to copy: a FIFO in front, settings as constants, tables that load themselves; and its bench.

All follows from :func:`cmfpga.verilog.ports.port_table` and the configuration's run-time fields.
"""

import math
import re

from ..config.config import unread
from ..config.windows import window_events
from ..fixed import bits_for
from ..imaging.camera import node_writes
from ..protocol.regions import Region, RegionTable
from ..protocol.settings import BatchSettings, schedule_table, settings_values
from ..protocol.tables import mask_writes
from .emit import TOP
from .ports import packed, plain

EXAMPLE = f"{TOP}_example"
BENCH = f"{EXAMPLE}_tb"
FIELDS = f"{TOP}_fields"
#: Events that the FIFO in front holds: 2 to this power.
DEPTH_BITS = 4


def example_config(config):
    """The configuration whose settings the example has: of a rotation without a camera, with one of its own.

    Nothing can be seen of a rotation without one. Its focal length is the sensor's width, or the least that the
    hardware can express; it distorts nothing.
    """
    if config.motion != "rotation" or config.camera:
        return config
    model, width, height = config.motion_model, config.sensor_width, config.sensor_height
    focal = max(width, math.ceil(config.pixel * 2 ** ((model.curve_frac - model.curve_bits) / 2)))
    return config.replace(camera=f"{focal},{focal},{(width - 1) / 2:g},{(height - 1) / 2:g}")


def example_roi(config):
    """Left column and top row of an ROI in the sensor's middle, px."""
    return (config.geometry.width - config.roi_width) // 2, (config.geometry.height - config.roi_height) // 2


def example_settings(config):
    """The example's :class:`BatchSettings` of its first batch."""
    return BatchSettings.from_config(example_config(config), example_roi(config))


def example_regions(config):
    """The rows of the example's table of regions: an ROI in the middle, where the core has a table."""
    return [Region.roi(config, example_roi(config))] if config.regions else []


def example_batch(config):
    """The batch that the bench plays: [(t, x, y)], of 40 points that move by 8 px to the right and 4 px down.

    Where windows slide it is as long as one of them.
    """
    count = window_events(config) if config.slides else min(240, config.buffer_events, config.slice_events)
    step = max(1, min(50, ((1 << config.span_bits) - 1) // count))
    sizes, events = (config.sensor_width, config.sensor_height), []
    for k in range(count):
        point = 17 * k % 40
        # Anywhere in the middle half of the ROI, but no two alike.
        spread = 611 * point % 64 - 32, 829 * point % 64 - 32
        places = [
            size // 2 + config.pixel * (spread[axis] * roi // 128 + (2 * k - count) * (4, 2)[axis] // count)
            for axis, (size, roi) in enumerate(zip(sizes, (config.roi_width, config.roi_height), strict=True))
        ]
        events.append((k * step, *(min(max(at, 0), size - 1) for at, size in zip(places, sizes, strict=True))))
    return events


def memory(config, table):
    """:func:`example_batch` for ``$readmemh``: a word of each event, its fields where ``fields.vh`` says."""
    places, bits = packed(table, "event")
    words, events = [], example_batch(config)
    for k, event in enumerate(events):
        values = {**dict(zip("txy", event, strict=True)), "last": k == len(events) - 1}
        word = sum(values[port.field] << lsb for port, lsb in places)
        words.append(f"{word:0{(bits + 3) // 4}x}\n")
    return "".join(words)


def loads(config, table):
    """What is written into the core's tables after a reset: ``{group of ports: [values in the ports' order]}``."""
    config, settings, found = example_config(config), example_settings(config), {}
    schedule = schedule_table(config, settings)
    if config.regions:
        regions = RegionTable(config)
        regions.replace(example_regions(config))
        found["row"], schedule = regions.changes(settings)
    found["schedule"] = [(address, *entry) for address, entry in enumerate(schedule)]
    if settings.camera:
        found["node"] = node_writes(config, settings.camera)
    if config.hot_pixels and settings.hot_mask:
        found["mask"] = mask_writes(config, settings.hot_mask)
    groups = {port.group for port in table}
    return {group: rows for group, rows in found.items() if rows and group in groups}


def _constant(value, bits, signed=False):
    return f"{'-' * (value < 0)}{bits}'{'s' * signed}d{abs(value)}"


def _range(bits):
    return f"[{bits - 1}:0] " if bits > 1 else ""


def _settings(config, table):
    """``{port: what it is tied to}``."""
    values = settings_values(config, example_settings(config))
    tied = {
        port.name: _constant(values[port.field], port.bits, port.signed) for port in table if port.group == "settings"
    }
    return tied if config.regions else tied | {"settings_roi_load": "!placed"}


def _loader(rows, ports):
    """Lines of what fills the core's tables, an entry a cycle; ``ports`` of each begin with its valid."""
    total = sum(map(len, rows.values()))
    bits = bits_for(total)
    yield "  // ---------------------------------------------------------------- tables, written once after a reset"
    yield ""
    yield f"  reg {_range(bits)}entry;  // which is written; {total}: all are"
    yield f"  wire loaded = entry == {bits}'d{total};"
    yield "  always @(posedge clk)"
    yield f"    if (rst) entry <= {bits}'d0;"
    yield f"    else if (!loaded) entry <= entry + {bits}'d1;"
    number = 0
    for group, entries in rows.items():
        _, *fields = ports[group]
        width = 1 + sum(port.bits for port in fields)
        names = ", ".join(port.name for port in fields)
        yield ""
        yield f"  // Valid, and {names}."
        yield f"  reg [{width - 1}:0] {group};"
        yield "  always @* begin"
        yield f"    {group} = {width}'d0;"
        yield "    if (!rst) case (entry)"
        for values in entries:
            text = ", ".join(
                _constant(int(value), port.bits, port.signed) for value, port in zip(values, fields, strict=True)
            )
            yield f"      {bits}'d{number}: {group} = {{1'd1, {text}}};"
            number += 1
        yield f"      default: {group} = {width}'d0;"
        yield "    endcase"
        yield "  end"


def _fifo():
    """Lines of a FIFO of one clock, whose memory is read without a cycle's delay: a few LUTs."""
    high = DEPTH_BITS
    return f"""\
  // ---------------------------------------------------------------- a FIFO in front: the core pauses between batches

  reg [EVENT_BITS-1:0] fifo [0:{(1 << high) - 1}];
  reg [{high}:0] written, read;  // counts, modulo twice the depth
  wire empty = written == read;
  wire full = written == {{!read[{high}], read[{high - 1}:0]}};
  wire [EVENT_BITS-1:0] event_word = fifo[read[{high - 1}:0]];
  assign event_in_ready = !full;

  always @(posedge clk) begin
    if (event_in_valid && event_in_ready) fifo[written[{high - 1}:0]] <= event_in;
    if (rst) begin
      written <= {high + 1}'d0;
      read <= {high + 1}'d0;
    end else begin
      if (event_in_valid && event_in_ready) written <= written + {high + 1}'d1;
      if (event_valid && event_ready) read <= read + {high + 1}'d1;
    end
  end
""".splitlines()


def _instance(config, tied, table):
    """Lines of the core's instance: what each port is connected to, and what it is for."""
    idle = unread(vars(config))
    before = table[0]
    for number, port in enumerate(table):
        if port.field and port.group != before.group:
            yield ""
            if port.group == "trace":
                yield "    // For verification."
        before = port
        comma = "," if number < len(table) - 1 else ""
        kind = f"{port.direction} {port.bits}{' signed' * port.signed}"
        meaning = plain(port.meaning) + "; not read" * (port.group == "settings" and port.field in idle)
        yield f"    .{port.name}({tied[port.name]}){comma}  // {kind}; {meaning}"


def example(config, table):
    """Verilog-2001 of the module :data:`EXAMPLE`; run-time fields of ``config`` are the settings' constants."""
    rows = loads(config, table)
    ports = {
        group: sorted((port for port in table if port.group == group), key=lambda port: port.field != "valid")
        for group in rows
    }
    tied = {"clk": "clk", "rst": "rst", **_settings(config, table)}
    tied |= {name: name for name in ("event_valid", "event_ready", "result_valid", "result_ready")}
    for port in table:
        if port.name in tied:
            continue
        field = f"{port.name.upper()}_LSB +: {port.name.upper()}_BITS"
        if port.group in ("event", "result"):
            tied[port.name] = f"{'event_word' if port.group == 'event' else 'result'}[{field}]"
        elif port.group in rows:
            of_word = ports[port.group]  # from the highest bit on
            low = sum(later.bits for later in of_word[of_word.index(port) + 1 :])
            part = f"{low + port.bits - 1}:{low}" if port.bits > 1 else f"{low}"
            tied[port.name] = f"{port.group}[{part}]"
        else:
            tied[port.name] = _constant(0, port.bits) if port.direction == "input" else ""
    camera = []
    if (shown := example_config(config)) is not config:
        camera = [f"// No camera was given: that of the example has a focal length of {shown.lens[0]:g} px."]
    loader = [*_loader(rows, ports), ""] if rows else []
    placing = [] if config.regions else [
        "  // The first batch is cropped at this ROI; a later one where the batches before moved it.",
        "  reg placed;",
        "  always @(posedge clk)",
        "    if (rst) placed <= 1'd0;",
        "    else if (event_valid && event_ready) placed <= 1'd1;",
        "",
    ]  # fmt: skip
    lines = [
        f"// {EXAMPLE}: an instance of {TOP} to copy. Events wait in a FIFO; settings are those of the configuration.",
        f"// An item moves in a cycle in which its valid and ready are high. {FIELDS}.vh says where fields lie.",
        *camera,
        "// SPDX-License-Identifier: BSD-2-Clause",
        "",
        f"module {EXAMPLE}(",
        "  clk, rst, event_in_valid, event_in_ready, event_in, result_valid, result_ready, result",
        ");",
        f'  `include "{FIELDS}.vh"',
        "",
        "  input clk;                     // the only clock; rising edge",
        "  input rst;                     // synchronous reset, active high",
        "  input event_in_valid;",
        "  output event_in_ready;",
        "  input [EVENT_BITS-1:0] event_in;",
        "  output result_valid;           // stays, as result does, until it is taken",
        "  input result_ready;",
        "  output [RESULT_BITS-1:0] result;",
        "",
        *loader,
        "  wire event_valid, event_ready;  // between the FIFO and the core",
        "",
        *_fifo(),
        "",
        "  // ---------------------------------------------------------------- the core",
        "",
        *placing,
        f"  assign event_valid = !empty{' && loaded' if rows else ''};",
        "",
        "  // verilator lint_off PINCONNECTEMPTY",
        "  // Outputs that the example has no use for stay open.",
        f"  {TOP} core (",
        *_instance(config, tied, table),
        "  );",
        "  // verilator lint_on PINCONNECTEMPTY",
        "endmodule",
    ]
    return "\n".join(lines) + "\n"


def memories(verilog, module=TOP, path=""):
    """Memories of a module of the emitted text, and of those in it: (path, bits of a word, words) each."""
    text = re.search(rf"^module {re.escape(module)} ?\(.*?^endmodule$", verilog, re.DOTALL | re.MULTILINE)[0]
    for high, name, last in re.findall(r"^  reg (?:\[(\d+):0\] )?(\S+ ?) ?\[(\d+):0\];$", text, re.MULTILINE):
        yield path + name, int(high or 0) + 1, int(last) + 1
    for inner, name in re.findall(rf"^  (\\?{TOP}\S+) +(\S+ ?) ?\($", text, re.MULTILINE):
        # An escaped name ends with a blank.
        yield from memories(verilog, inner, f"{path}{name if name.startswith(chr(92)) else name.rstrip()}.")


def bench(config, table, verilog):
    """Verilog-2001 of the module :data:`BENCH`: plays :func:`example_batch`, prints the first result with a velocity.

    ``verilog`` is the core's text. Memories have some contents in a device; in a simulator they are X, and 0·X is X:
    the bench fills them.
    """
    results, _ = packed(table, "result")
    events = len(example_batch(config))
    prints = []
    for port, _ in results:
        value = f"result[{port.name.upper()}_LSB +: {port.name.upper()}_BITS]"
        value = f"$signed({value})" if port.signed else value
        prints.append(f'      $display("{port.name} = %0d", {value});')
    filled = []
    for path, bits, depth in memories(verilog):
        some = f"{{{(bits + 31) // 32}{{$random}}}}"
        filled.append(f"    for (word = 0; word < {depth}; word = word + 1) example.core.{path}[word] = {some};")
    return f"""\
// {BENCH}: plays {events} events, those of {EXAMPLE}.mem, into {EXAMPLE}, and prints the first result
// that is not degenerate. Waveforms go to {EXAMPLE}.vcd with +waves.
// SPDX-License-Identifier: BSD-2-Clause

module {BENCH};
  `include "{FIELDS}.vh"

  reg clk = 0;
  reg rst = 1;
  always #5 clk = ~clk;

  reg [EVENT_BITS-1:0] events [0:{events - 1}];
  reg event_valid = 0;
  reg [EVENT_BITS-1:0] event_word;
  wire event_ready, result_valid;
  wire [RESULT_BITS-1:0] result;
  integer number = 0, cycles = 0;

  {EXAMPLE} example (
    .clk(clk), .rst(rst),
    .event_in_valid(event_valid), .event_in_ready(event_ready), .event_in(event_word),
    .result_valid(result_valid), .result_ready(1'b1), .result(result)
  );

  // Any contents of the memories, as in a device: here they would be X, and 0 * X is X.
  integer word;
  initial begin
{chr(10).join(filled)}
  end

  // Inputs change at the falling edge.
  initial begin
    $readmemh("{EXAMPLE}.mem", events);
    if ($test$plusargs("waves")) begin
      $dumpfile("{EXAMPLE}.vcd");
      $dumpvars(2, {BENCH});
    end
    repeat (3) @(negedge clk);
    rst = 0;
    for (number = 0; number < {events}; number = number + 1) begin
      event_word = events[number];
      event_valid = 1;
      @(posedge clk);
      while (!event_ready) @(posedge clk);
      @(negedge clk);
    end
    event_valid = 0;
  end

  always @(posedge clk) begin
    cycles <= cycles + 1;
    if (!rst && result_valid && !result[RESULT_FLAGS_LSB]) begin
{chr(10).join(prints)}
      $display("DONE: %0d events, %0d clock cycles", number, cycles);
      $finish(0);
    end else if (cycles == 1000000) begin
      $display("FAIL: no result after %0d clock cycles", cycles);
      $finish(0);
    end
  end
endmodule
"""
