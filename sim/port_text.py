"""Verilog of what tb_cmfpga_core.v does with every port of the core: lines, from the tables of ports and columns."""

from cmfpga.rtl.image.sliced_memory import SHALLOW, slices
from cmfpga.verilog.emit import TOP


def declarations(core):
    """A register for each input, a wire for each output, and the core."""
    for kind, ports in (("reg", core.inputs), ("wire", core.outputs)):
        for name, port in ports.items():
            sign = " signed" if port.shape().signed else ""
            start = " = 0" if kind == "reg" and name.endswith(("_valid", "_ready")) else ""
            yield f"{kind}{sign} [{len(port) - 1}:0] {name}{start};"
    yield f"{TOP} core (" + ", ".join(f".{name}({name})" for name in core.port_order) + ");"


def fill_banks(core):
    """Words in tagged banks, as in a device: 0·X, in a simulator, is X. Random ones."""
    config = core.config
    bank = next((block.banks[0] for name, block in core.blocks.items() if name.startswith("tagged_accumulator")), None)
    if bank is None:
        return
    count, depth = config.geometry.images, config.geometry.bank_depth
    images = [f"image_{number}." for number in range(count)] if count > 1 else [""]
    parts = slices(bank.word.size, depth, config.ram_style)
    rams = [f"ram.{part}" for part in parts] if depth > SHALLOW and config.ram_style != "ultra" else ["ram"]
    yield "integer word;"
    yield "initial begin"
    for path in (f"{image}tagged_accumulator.bank_{n}.{ram}" for image in images for ram in rams for n in range(4)):
        some = "{$random, $random, $random}"
        yield f"  for (word = 0; word < {depth}; word = word + 1) core.image.{path}[word] = {some};"
    yield "end"


def drive(memory, columns, ports):
    """A task that puts the ports' part of a word, which is its lower one, on them."""
    names = [name for name in columns if name in ports]
    bits = sum(columns[name] for name in names)
    yield f"localparam {memory.upper()}_PORTS = {bits};"
    yield f"task drive_{memory}(input [{bits - 1}:0] word); {{{', '.join(names)}}} = word; endtask"


def write_table(memory, port, columns):
    """A task that fills a table of the core, of schedules or nodes, where it has one."""
    if not columns:
        yield f"task write_{memory}; begin end endtask"
        return
    names, size, row = f"{{{', '.join(columns)}}}", memory.upper(), f"{memory}_row"
    yield f"reg [{size}_BITS-1:0] {memory} [0:{size}-1];"
    yield f"integer {row};"
    yield f"task write_{memory}; begin"
    yield f'  $readmemb("{memory}.mem", {memory});'
    yield f"  {port}_valid = 1;"
    yield f"  for ({row} = 0; {row} < {size}; {row} = {row} + 1) begin {names} = {memory}[{row}]; @(negedge clk); end"
    yield f"  {port}_valid = 0;"
    yield f"  {names} = {{{size}_BITS{{1'bx}}}};"
    yield "end endtask"


def parts_of(columns):
    """``{column: its part of a word, as text}``."""
    high, found = sum(columns.values()), {}
    for name, width in columns.items():
        found[name] = f"wanted[{high - 1}:{high - width}]"
        high -= width
    return found


def compare(memory, columns, ports):
    """All of the ports as one wire, and a task that compares each with a word's part; X there says nothing."""
    parts = {name: part for name, part in parts_of(columns).items() if name in ports}
    yield f"wire [{sum(columns[name] for name in parts) - 1}:0] {memory}_now = {{{', '.join(parts)}}};"
    yield f"task compare_{memory}(input [{sum(columns.values()) - 1}:0] wanted); begin"
    for name, part in parts.items():
        yield f'  if (^{part} !== 1\'bx) check("{name}", {{{name}}}, {part});'
    yield "end endtask"


def pixels(names, trace):
    """Sums of the images that the sweep reads, of a core that sweeps: each must be what the model's is."""
    fields = {}
    for name in names:
        fields.setdefault(name.split("_", 3)[3], []).append(name)
    zero = " ".join(f"sum_of_{field} = 0;" for field in fields)
    yield from (f"reg signed [63:0] sum_of_{field} = 0;" for field in fields)
    yield "integer pixel_words = 0;"
    yield f"task clear_pixels; begin pixel_words = 0; {zero} end endtask"
    yield "task sum_pixels; begin"
    if fields:
        yield "  if (trace_pixels_valid !== 1'b0) begin"
        yield "    pixel_words = pixel_words + 1;"
        yield from (f"    sum_of_{name} = {' + '.join([f'sum_of_{name}', *ports])};" for name, ports in fields.items())
        yield "  end"
    yield "end endtask"
    yield f"task compare_pixels(input [{sum(trace.values()) - 1}:0] wanted); begin"
    if fields:
        yield '  check("words of pixels", pixel_words, BANK_WORDS);'
    for field in fields:
        width = trace[f"trace_sums_{field}"]
        part = parts_of(trace)[f"trace_sums_{field}"]
        yield f'  check("sum of pixels, {field}", sum_of_{field}[{width - 1}:0], {part});'
    yield "end endtask"
