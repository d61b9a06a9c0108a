"""Gates before adders of a netlist for ECP5, moved into the carry cells.

A carry cell of Yosys's adders adds two of the four inputs that its table has. An addend that is inverted by a signal,
as where a sum is a difference by turns, comes through a LUT of its own, which a third input saves.
"""

from .packing import pack_registers, wires_of

#: What a carry cell computes that adds A and B, or A and the inverse of B, by C; and the opposite of that.
_ADDS, _INVERTED = "1001011010101010", "0110100110101010"


def pack(module):
    """Registers, then gates: change a module of Yosys's JSON in place; returns how many cells have gone."""
    return pack_registers(module) + pack_gates(module)


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
