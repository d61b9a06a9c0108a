"""Registers beside RAMs and multipliers of a netlist for ECP5, and gates before adders, moved into them.

RAMs and multipliers have an output register, multipliers have input registers, which Yosys 0.70 leaves unused. Other
tools do this; without it, the wires to a register outside and its set-up time add to the slowest elements that there
are. A carry cell of Yosys's adders adds two of the four inputs that its table has. An addend that is inverted by a
signal, as where a sum is a difference by turns, comes through a LUT of its own, which a third input saves.
"""

from collections import defaultdict
from itertools import count
from typing import NamedTuple

#: How the names of a cell's outputs begin.
_OUTPUTS = {"DP16KD": "DOB", "MULT18X18D": "P"}
#: What a carry cell computes that adds A and B, or A and the inverse of B, by C; and the opposite of that.
_ADDS, _INVERTED = "1001011010101010", "0110100110101010"
#: What a register has its data from that goes into a multiplier where both factors' do: nothing slower than an adder.
_GATES = frozenset({"TRELLIS_FF", "CCU2C", "LUT4", "PFUMX", "L6MUX21"})
#: A RAM of words so wide is read by both ports' outputs, with the clock and the enable of port B.
_WIDE = 36


class _Kind(NamedTuple):
    """The nets of a register: clock, synchronous reset to zero, enable; ``"0"`` and ``"1"`` without one."""

    clock: object
    reset: object
    enable: object


def pack(module):
    """Registers, then gates: change a module of Yosys's JSON in place; returns how many cells have gone."""
    return pack_registers(module) + pack_gates(module)


def pack_registers(module):
    """Change a module of Yosys's JSON in place; returns how many registers have gone.

    A cell's output register is used where every output in use goes to a register and nowhere else, all have the cell's
    clock, one enable or none, start at zero, and have no reset or, behind a multiplier, one synchronous reset.
    A multiplier's input register is used where every bit of the factor comes from such a register, which has it from
    another one: a factor that waits for a cycle. Or from gates or an adder, if the other factor's is used as well. Each
    of a multiplier's registers has one of four enables and resets. Where others read a register, too, it stays beside.

    Where both factors wait for a cycle more, in registers of the same kind, the product does that in their place, for
    its wires are long as well; and where both terms of an adder before a multiplier do, their sum.
    """
    cells, before = module["cells"], len(module["cells"])
    _, sinks = wires_of(module)
    for cell in [cell for cell in cells.values() if cell["type"] in _OUTPUTS]:
        _pack_output(cells, cell, sinks)
    drivers, _ = wires_of(module)
    packed = set()
    multipliers = [cell for cell in cells.values() if cell["type"] == "MULT18X18D"]
    for cell in multipliers:
        for factor in "AB":
            packed |= _pack_inputs(cells, cell, factor, drivers, {"TRELLIS_FF"})
    for cell in multipliers:
        others = [factor for factor in "AB" if _kind_of(cell, f"INPUT{factor}") is None]
        packed |= _pack_inputs(cells, cell, others, drivers, _GATES)
    _drop(module, packed)
    drivers, sinks = wires_of(module)
    new = count(1 + max((bit for bit in [*drivers, *sinks] if isinstance(bit, int)), default=0))
    multipliers = [name for name, cell in cells.items() if cell["type"] == "MULT18X18D"]
    _drop(module, {register for name in multipliers for register in _move_behind(cells, name, sinks, drivers, new)})
    return before - len(cells)


def _drop(module, registers):
    """Delete those of the ``registers`` that nothing reads; one may have been the only reader of another."""
    cells, dead = module["cells"], registers
    while dead:
        _, sinks = wires_of(module)
        dead = {name for name in registers & {*cells} if not sinks[cells[name]["connections"]["Q"][0]]}
        for name in dead:
            del cells[name]


def wires_of(module):
    """By net: the name of the cell that drives it; and all that it goes to, by cell and pin."""
    drivers, sinks = {}, defaultdict(list)
    for name, cell in module["cells"].items():
        for pin, bits in cell["connections"].items():
            for bit in bits:
                if cell["port_directions"][pin] == "input":
                    sinks[bit].append((name, pin))
                else:
                    drivers[bit] = name
    for port in module["ports"].values():
        for bit in port["bits"]:
            sinks[bit].append((None, None))
    return drivers, sinks


def _pack_output(cells, cell, sinks):
    prefix, wires = _OUTPUTS[cell["type"]], cell["connections"]
    ports = "B"
    if cell["type"] == "DP16KD" and int(cell["parameters"].get("DATA_WIDTH_B", "0"), 2) == _WIDE:
        prefix, ports = "DO", "AB"
    used = {
        pin: sinks[bits[0]]
        for pin, bits in wires.items()
        if pin.startswith(prefix) and cell["port_directions"][pin] == "output" and bits and sinks[bits[0]]
    }
    if not used or any(len(to) != 1 or to[0][1] != "DI" for to in used.values()):
        return
    registers = {pin: to[0][0] for pin, to in used.items()}
    kinds = {_kind(cells[name]) for name in registers.values()}
    if len(kinds) != 1 or None in kinds:
        return
    (kind,) = kinds
    if cell["type"] == "DP16KD":
        if kind.reset != "0" or wires["CLKB"] != [kind.clock]:
            return
        if any(pin.startswith("DOA") and sinks[bits[0]] for pin, bits in wires.items() if bits and pin not in used):
            return
        cell["parameters"] |= {f"REGMODE_{port}": "OUTREG" for port in ports}
        wires["OCEB"] = [kind.enable]
        cell["port_directions"]["OCEB"] = "input"
    else:
        _set(cell, "OUTPUT", kind)
    for pin, name in registers.items():
        wires[pin] = cells.pop(name)["connections"]["Q"]


def _pack_inputs(cells, cell, factors, drivers, sources):
    """All of the ``factors``, or none; returns the names of the registers that these no longer need.

    ``sources``: what a register may have a bit from.
    """
    wires, kinds, registers = cell["connections"], {}, []
    for factor in factors:
        bits = {f"{factor}{bit}": (wires.get(f"{factor}{bit}") or ["0"])[0] for bit in range(18)}
        pins = [pin for pin, bit in bits.items() if bit not in ("0", "x")]
        kinds[factor] = _kind(cells.get(drivers.get(bits[pins[0]]))) if pins else None
        found = kinds[factor] and _registers(cells, [(wires, pin) for pin in pins], kinds[factor], drivers, sources)
        if not found:
            return set()
        registers += found
    if len({kind.clock for kind in kinds.values()} | {bit for bit in wires.get("CLK0", ()) if bit != "0"}) > 1:
        return set()
    for factor, kind in kinds.items():
        _set(cell, f"INPUT{factor}", kind)
    return _skip(registers)


def _move_behind(cells, name, sinks, drivers, new):
    """Registers of both factors to the product, or of an adder's terms to the sum, which is 0 as well at the start.

    Returns the names of the registers that are no longer needed there; ``new`` are numbers for nets.
    """
    cell = cells[name]
    wires = cell["connections"]
    own = [_kind_of(cell, f"INPUT{factor}") for factor in "AB"]
    kinds = {*own, _kind_of(cell, "OUTPUT")} - {None}
    if None in own or len(kinds) > 1:
        return set()
    (kind,) = kinds
    factors = {
        factor: [pin for pin in (f"{factor}{bit}" for bit in range(18)) if (wires.get(pin) or ["0"]) != ["0"]]
        for factor in "AB"
    }
    passed = set()  # registers between an adder and its factor

    def terms_of(pins, bits):
        return _terms(cells, bits, {(name, pin) for pin in pins}, passed, sinks, drivers)

    def sums():
        """Registers of the terms of a factor's adder, to behind the adder."""
        for pins in factors.values():
            terms = terms_of(pins, [wires[pin][0] for pin in pins])
            found = terms and _registers(cells, terms, kind, drivers)
            if found:
                moved, behind = _skip(found), {}
                for pin in pins:
                    (bit,) = wires[pin]
                    if bit not in behind:
                        behind[bit] = next(new)
                        _register(cells, f"{name}_{pin}", moved, bit, behind[bit], drivers)
                    wires[pin] = [behind[bit]]
                return moved
        return set()

    moved = sums()
    products = [pin for pin in (f"P{bit}" for bit in range(36)) if wires.get(pin) and sinks[wires[pin][0]]]
    if "REG_OUTPUT_CLK" not in cell["parameters"]:
        return moved
    found = []
    for pins in factors.values():
        inputs = [(wires, pin) for pin in pins]
        before = _registers(cells, inputs, kind, drivers)
        if not before:  # those behind an adder only where its terms have others that take their place
            behind = _registers(cells, inputs, kind, drivers, {"CCU2C"})
            passed |= {register for register, *_ in behind or ()}
            terms = behind and terms_of(pins, [data[0] for *_, data in behind])
            before = terms and _registers(cells, terms, kind, drivers) and behind
        if not before:
            return moved
        found += before
    skipped = _skip(found)
    for pin in products:
        behind, wires[pin] = wires[pin][0], [next(new)]
        _register(cells, f"{name}_{pin}", skipped, wires[pin][0], behind, drivers)
    return moved | skipped | sums()


def _terms(cells, bits, readers, passed, sinks, drivers):
    """The terms' inputs, pairs of wires and pin, of the adders that the ``bits`` come from; None if there are others.

    The adders may do nothing but add, carries may not come from others or go to them, and nothing but the ``readers``,
    pairs of cell and pin, may read a bit of the sum, be it through the registers ``passed``.
    """
    adders = {drivers.get(bit) for bit in bits}
    if any(cells.get(adder, {"type": None})["type"] != "CCU2C" for adder in adders):
        return None
    if not all(_adds(cells[adder], adders, drivers) for adder in adders):
        return None
    allowed = readers | {(register, "DI") for register in passed} | {(adder, "CIN") for adder in adders}
    read = [bit for adder in adders for pin in ("S0", "S1", "COUT") for bit in cells[adder]["connections"].get(pin, ())]
    read += [bit for register in passed for bit in cells[register]["connections"]["Q"]]
    if any(sink not in allowed for bit in read for sink in sinks[bit]):
        return None
    return [(cells[adder]["connections"], f"{term}{k}") for adder in adders for term in "AB" for k in range(2)]


def _adds(cell, adders, drivers):
    """Whether a carry cell is one of those that add two terms, and nothing else; ``adders`` are those of the sum."""
    found, wires = cell["parameters"], cell["connections"]
    if any(found.get(f"INIT{k}") != _ADDS or (wires[f"C{k}"], wires[f"D{k}"]) != (["0"], ["1"]) for k in range(2)):
        return False
    (carry,) = wires["CIN"]
    return carry == "0" or drivers.get(carry) in adders


def _registers(cells, inputs, kind, drivers, sources=frozenset({"TRELLIS_FF"})):
    """The registers of the ``kind`` before ``inputs``: name, the input's wires and pin, and what they have in turn.

    None where there is another before one of them, or what it has is not from one of the ``sources``.
    """
    found = []
    for wires, pin in inputs:
        if wires[pin] != ["0"]:
            name = drivers.get(wires[pin][0])
            if _kind(cells.get(name)) != kind:
                return None
            data = cells[name]["connections"]["DI"]
            if cells.get(drivers.get(data[0]), {"type": None})["type"] not in sources:
                return None
            found.append((name, wires, pin, data))
    return found


def _skip(found):
    """Have the inputs what :func:`_registers` of them have; returns the names of these."""
    for _, wires, pin, data in found:
        wires[pin] = data
    return {name for name, *_ in found}


def _register(cells, name, like, data, out, drivers):
    """A register from net ``data`` to net ``out``, of the kind of those that are named in ``like``."""
    found = cells[min(like)]
    name = f"{name}_behind"
    while name in cells:
        name += "_too"
    cells[name] = found | {"connections": found["connections"] | {"DI": [data], "Q": [out]}, "attributes": {}}
    drivers[out] = name


def _kind_of(multiplier, name):
    """None if it does not use this one of its registers."""
    found, wires = multiplier["parameters"], multiplier["connections"]
    pins = [found.get(f"REG_{name}_{part}", "NONE").strip() for part in ("CLK", "RST", "CE")]
    return None if pins[0] == "NONE" else _Kind(*(wires[pin][0] for pin in pins))


def _set(multiplier, name, kind):
    """Use one of its registers, with the first enable and reset that are the same, or free."""
    found, wires = multiplier["parameters"], multiplier["connections"]
    found |= {"CLK0_DIV": "ENABLED", "RESETMODE": "SYNC", "GSR": "DISABLED"}
    for part, net in (("CLK", kind.clock), ("RST", kind.reset), ("CE", kind.enable)):
        pin = next(pin for pin in (f"{part}{k}" for k in range(4)) if wires.get(pin, [net]) == [net])
        found[f"REG_{name}_{part}"], wires[pin] = pin, [net]
        multiplier["port_directions"][pin] = "input"


def _kind(cell):
    """None if this is no register that starts at zero and takes its data input."""
    if cell is None or cell["type"] != "TRELLIS_FF":
        return None
    found, wires = cell["parameters"], cell["connections"]
    reset, enabled = wires.get("LSR", ["0"])[0], found.get("CEMUX", "1").strip() == "CE"
    synchronous = reset == "0" or found.get("SRMODE") == "LSR_OVER_CE"
    kept = {"CEMUX": "CE" if enabled else "1", "CLKMUX": "CLK", "REGSET": "RESET", "LSRMUX": "LSR"}
    if not synchronous or any(found.get(name, value).strip() != value for name, value in kept.items()):
        return None
    return _Kind(wires["CLK"][0], reset, wires["CE"][0] if enabled else "1")


def pack_gates(module):
    """Where nothing but an adder's B reads what a LUT makes of two nets, A ⊕ B or its opposite, the adder makes it."""
    cells, before = module["cells"], len(module["cells"])
    drivers, sinks = wires_of(module)
    for cell in [cell for cell in cells.values() if cell["type"] == "CCU2C"]:
        wires, found = cell["connections"], cell["parameters"]
        for k in range(2):
            c, d = (wires.get(f"{pin}{k}", ["0"])[0] for pin in "CD")
            name = drivers.get(wires.get(f"B{k}", ["0"])[0])
            gate = _gate(cells.get(name))
            if found.get(f"INIT{k}") != _ADDS or c not in ("0", "1") or d != "1" or not gate:
                continue
            if len(sinks[wires[f"B{k}"][0]]) > 1:
                continue
            one, other, inverts = gate
            wires[f"B{k}"], wires[f"C{k}"] = [one], [other]
            found[f"INIT{k}"] = _INVERTED if inverts ^ (c == "1") else _ADDS
            cell["port_directions"] |= {f"{pin}{k}": "input" for pin in "BC"}
            del cells[name]
    return before - len(cells)


def _gate(cell):
    """Two nets and whether the LUT inverts, if it makes their sum without a carry; else None."""
    if cell is None or cell["type"] != "LUT4":
        return None
    table, wires = cell["parameters"]["INIT"][::-1], cell["connections"]
    pins = [pin for pin in "ABCD" if wires.get(pin, ["0"])[0] not in ("0", "x")]
    if len(pins) != 2 or "1" in (wires[pin][0] for pin in pins):
        return None
    weights = [1 << "ABCD".index(pin) for pin in pins]
    made = [table[a * weights[0] + b * weights[1]] for a in range(2) for b in range(2)]
    if made not in (["0", "1", "1", "0"], ["1", "0", "0", "1"]):
        return None
    return (*(wires[pin][0] for pin in pins), made[0] == "1")
