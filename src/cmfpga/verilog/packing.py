"""Registers behind RAMs and multipliers of a netlist for ECP5, moved into them.

Both have an output register, which Yosys 0.70 leaves unused. Other tools do this; without it, the wires to a register
outside and its set-up time add to the slowest elements that there are.
"""

from collections import defaultdict

#: What a cell is told of its register, beside the clock; and the names of its outputs.
_OUTPUTS = {"DP16KD": "DOB", "MULT18X18D": "P"}


def pack_registers(module):
    """Change a module of Yosys's JSON in place; returns how many registers have gone.

    A cell's register is used where every output in use goes to a register and nowhere else, all have the cell's clock,
    no enable, start at zero, and have no reset or, behind a multiplier, one synchronous reset.
    """
    cells, sinks = module["cells"], defaultdict(list)
    for name, cell in cells.items():
        for pin, bits in cell["connections"].items():
            if cell["port_directions"][pin] == "input":
                for bit in bits:
                    sinks[bit].append((name, pin))
    for port in module["ports"].values():
        for bit in port["bits"]:
            sinks[bit].append((None, None))
    gone = 0
    for cell in [cell for cell in cells.values() if cell["type"] in _OUTPUTS]:
        prefix, wires = _OUTPUTS[cell["type"]], cell["connections"]
        used = {
            pin: sinks[bits[0]]
            for pin, bits in wires.items()
            if pin.startswith(prefix) and cell["port_directions"][pin] == "output" and bits and sinks[bits[0]]
        }
        if not used or any(len(to) != 1 or not _is_plain(cells.get(to[0][0]), to[0][1]) for to in used.values()):
            continue
        registers = {pin: to[0][0] for pin, to in used.items()}
        kinds = {(*cells[name]["connections"]["CLK"], _reset(cells[name])) for name in registers.values()}
        if len(kinds) != 1 or any(pin.startswith("DOA") and sinks[bits[0]] for pin, bits in wires.items() if bits):
            continue
        ((clock, reset),) = kinds
        if cell["type"] == "DP16KD":
            if reset != "0" or wires["CLKB"] != [clock]:
                continue
            cell["parameters"]["REGMODE_B"] = "OUTREG"
        else:
            cell["parameters"] |= {
                "REG_OUTPUT_CLK": "CLK0", "REG_OUTPUT_CE": "CE0", "REG_OUTPUT_RST": "RST0", "CLK0_DIV": "ENABLED",
                "RESETMODE": "SYNC", "GSR": "DISABLED",
            }  # fmt: skip
            wires |= {"CLK0": [clock], "CE0": ["1"], "RST0": [reset]}
            cell["port_directions"] |= dict.fromkeys(("CLK0", "CE0", "RST0"), "input")
        for pin, name in registers.items():
            wires[pin] = cells.pop(name)["connections"]["Q"]
        gone += len(registers)
    return gone


def _reset(register):
    """The net that sets it to zero; ``"0"`` without one."""
    return register["connections"].get("LSR", ["0"])[0]


def _is_plain(cell, pin):
    """Whether this is the data input of a register that takes it in every cycle."""
    if cell is None or cell["type"] != "TRELLIS_FF" or pin != "DI":
        return False
    found = cell["parameters"]
    synchronous = _reset(cell) == "0" or found.get("SRMODE") == "LSR_OVER_CE"
    kept = {"CEMUX": "1", "CLKMUX": "CLK", "REGSET": "RESET"}
    return synchronous and all(found.get(name, value).strip() == value for name, value in kept.items())
