"""Registers beside RAMs and multipliers of a netlist for ECP5, moved into them.

Both have an output register, multipliers have input registers, which Yosys 0.70 leaves unused. Other tools do this;
without it, the wires to a register outside and its set-up time add to the slowest elements that there are.
"""

from collections import defaultdict
from typing import NamedTuple

#: How the names of a cell's outputs begin.
_OUTPUTS = {"DP16KD": "DOB", "MULT18X18D": "P"}
#: A RAM of words so wide is read by both ports' outputs, with the clock and the enable of port B.
_WIDE = 36


class _Kind(NamedTuple):
    """The nets of a register: clock, synchronous reset to zero, enable; ``"0"`` and ``"1"`` without one."""

    clock: object
    reset: object
    enable: object


def pack_registers(module):
    """Change a module of Yosys's JSON in place; returns how many registers have gone.

    A cell's output register is used where every output in use goes to a register and nowhere else, all have the cell's
    clock, one enable or none, start at zero, and have no reset or, behind a multiplier, one synchronous reset.
    A multiplier's input register is used where every bit of the factor comes from such a register, which has it from
    another one: a factor that waits for a cycle. Or from an adder, if the other factor waits in its register already.
    Where others read it as well, it stays beside.
    """
    cells, before = module["cells"], len(module["cells"])
    _, sinks = _wires(module)
    for cell in [cell for cell in cells.values() if cell["type"] in _OUTPUTS]:
        _pack_output(cells, cell, sinks)
    drivers, _ = _wires(module)
    packed = set()
    multipliers = [cell for cell in cells.values() if cell["type"] == "MULT18X18D"]
    for cell in multipliers:
        for factor in "AB":
            packed |= _pack_input(cells, cell, factor, drivers, {"TRELLIS_FF"})
    for cell in multipliers:
        for factor, other in ("AB", "BA"):
            if _waits(cell, other) and not _waits(cell, factor):
                packed |= _pack_input(cells, cell, factor, drivers, {"TRELLIS_FF", "CCU2C"})
    _, sinks = _wires(module)
    for name in packed:
        if not sinks[cells[name]["connections"]["Q"][0]]:
            del cells[name]
    return before - len(cells)


def _wires(module):
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


def _pack_input(cells, cell, factor, drivers, kinds_before):
    """Returns the names of the registers that the factor no longer needs.

    ``kinds_before``: what a register may have a bit from.
    """
    wires = cell["connections"]
    pins = {f"{factor}{bit}": wires[f"{factor}{bit}"][0] for bit in range(18) if wires.get(f"{factor}{bit}")}
    registers = {pin: drivers.get(bit) for pin, bit in pins.items() if bit not in ("0", "x")}
    kinds = {_kind(cells.get(name)) for name in registers.values()}
    if len(kinds) != 1 or None in kinds:
        return set()
    (kind,) = kinds
    # The other registers of the multiplier have the same clock, enable and reset, which are the first of four.
    if wires.get("CLK0", ["0"]) != ["0"] and _Kind(*(wires[pin][0] for pin in ("CLK0", "RST0", "CE0"))) != kind:
        return set()
    before = {pin: cells[name]["connections"]["DI"][0] for pin, name in registers.items()}
    if any(cells.get(drivers.get(bit), {"type": None})["type"] not in kinds_before for bit in before.values()):
        return set()
    _set(cell, f"INPUT{factor}", kind)
    wires |= {pin: [bit] for pin, bit in before.items()}
    return set(registers.values())


def _waits(multiplier, factor):
    """Whether it uses its register of a factor."""
    return multiplier["parameters"].get(f"REG_INPUT{factor}_CLK", "NONE").strip() != "NONE"


def _set(multiplier, name, kind):
    """Use one of its registers."""
    multiplier["parameters"] |= {
        f"REG_{name}_CLK": "CLK0", f"REG_{name}_CE": "CE0", f"REG_{name}_RST": "RST0", "CLK0_DIV": "ENABLED",
        "RESETMODE": "SYNC", "GSR": "DISABLED",
    }  # fmt: skip
    multiplier["connections"] |= {"CLK0": [kind.clock], "CE0": [kind.enable], "RST0": [kind.reset]}
    multiplier["port_directions"] |= dict.fromkeys(("CLK0", "CE0", "RST0"), "input")


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
