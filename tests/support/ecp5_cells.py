"""Small netlists of ECP5 cells (Yosys's JSON), and what they do in every cycle."""

import random

OUTPUTS = {"P0", "P1", "DOB0", "DOB1", "Q", "S0", "S1", "COUT", "Z"}


def cell(kind, parameters=None, **wires):
    directions = {pin: "output" if pin in OUTPUTS else "input" for pin in wires}
    wires = {pin: [bit] for pin, bit in wires.items()}
    return {"type": kind, "parameters": dict(parameters or {}), "connections": wires, "port_directions": directions}


def register(data, out, **changes):
    """Register with an enable; ``changes``: of its parameters."""
    parameters = {"CEMUX": "CE", "CLKMUX": "CLK", "REGSET": "RESET"} | changes
    return cell("TRELLIS_FF", parameters, CLK=2, CE=4, DI=data, Q=out)


def twice_waiting(**changes):
    """A multiplier, both factors of which come through three registers in a row, and its product through one.

    ``changes``: parameters of the second before factor B.
    """
    cells = {"it": cell("MULT18X18D", A0=13, A1="0", B0=23, P0=30), "product": register(30, 31)}
    for net in (10, 11, 12, 20, 21, 22):
        cells[f"register_{net}"] = register(net, net + 1, **(changes if net == 21 else {}))
    return {"ports": {"o": {"bits": [31]}}, "cells": cells}


def adder(**wires):
    """A carry cell that adds; what is not told is 0."""
    unused = {pin: "0" for pin in ("A0", "B0", "C0", "A1", "B1", "C1", "CIN")} | {"D0": "1", "D1": "1"}
    return cell("CCU2C", dict.fromkeys(("INIT0", "INIT1"), "1001011010101010"), **unused | wires)


class Netlist:
    """Registers, LUTs, carry cells, multipliers: two values, one clock; all begins at 0. Other cells raise."""

    def __init__(self, module):
        self.cells = module["cells"]
        self.outputs = sorted(bit for port in module["ports"].values() for bit in port["bits"] if isinstance(bit, int))
        self.drivers = {
            bits[0]: name
            for name, cell in self.cells.items()
            for pin, bits in cell["connections"].items()
            if cell["port_directions"][pin] == "output"
        }
        self.state = {}

    @property
    def inputs(self):
        read = {bits[0] for cell in self.cells.values() for bits in cell["connections"].values()}
        return sorted(bit for bit in read - {*self.drivers} if isinstance(bit, int))

    def run(self, rows):
        """The outputs' values of each row of inputs, ``{net: value}``, a row a cycle."""
        found = []
        for row in rows:
            self.known = {"0": 0, "1": 1, "x": 0, **row}
            found.append([self._net(bit) for bit in self.outputs])
            self.state = {name: self._next(name, cell) for name, cell in self.cells.items() if self._clocked(cell)}
        return found

    def _net(self, bit):
        if bit not in self.known:
            self.known |= self._outputs(self.drivers[bit])
        return self.known[bit]

    def _pin(self, cell, pin, default=0):
        return self._net(cell["connections"][pin][0]) if pin in cell["connections"] else default

    def _outputs(self, name):
        cell, wires = self.cells[name], self.cells[name]["connections"]
        pins = getattr(self, f"_{cell['type'].lower()}")(name, cell)
        return {wires[pin][0]: value for pin, value in pins.items() if pin in wires}

    def _trellis_ff(self, name, cell):
        return {"Q": self.state.get(name, 0)}

    def _lut4(self, name, cell):
        return {"Z": int(cell["parameters"]["INIT"][::-1][self._address(cell, "")])}

    def _pfumx(self, name, cell):
        return {"Z": self._pin(cell, "ALUT" if self._pin(cell, "C0") else "BLUT")}

    def _ccu2c(self, name, cell):
        carry, found = self._pin(cell, "CIN"), {}
        for k in range(2):
            table, address = cell["parameters"][f"INIT{k}"][::-1], self._address(cell, k)
            found[f"S{k}"] = int(table[address]) ^ carry
            carry = carry if table[address] == "1" else int(table[address & 3])
        return found | {"COUT": carry}

    def _mult18x18d(self, name, cell):
        *_, kept = self.state.get(name, (0, 0, 0))
        product = kept if self._has(cell, "OUTPUT") else self._product(name, cell)
        return {f"P{bit}": product >> bit & 1 for bit in range(36)}

    def _address(self, cell, k):
        return sum(self._pin(cell, f"{pin}{k}", pin == "D") << number for number, pin in enumerate("ABCD"))

    def _factor(self, cell, factor):
        return sum(self._pin(cell, f"{factor}{bit}") << bit for bit in range(18))

    def _product(self, name, cell):
        product = 1
        for kept, factor in zip(self.state.get(name, (0, 0)), "AB", strict=False):
            value = kept if self._has(cell, f"INPUT{factor}") else self._factor(cell, factor)
            product *= value - (value >> 17 << 18) * self._pin(cell, f"SIGNED{factor}")
        return product % (1 << 36)

    @staticmethod
    def _clocked(cell):
        return cell["type"] == "TRELLIS_FF" or "CLK0" in cell["connections"]

    @staticmethod
    def _has(cell, register):
        return cell["parameters"].get(f"REG_{register}_CLK", "NONE").strip() != "NONE"

    def _next(self, name, cell):
        """A register's next value; of a multiplier those of its factors and its product."""
        before = self.state.get(name)
        if cell["type"] == "TRELLIS_FF":
            enabled = cell["parameters"].get("CEMUX", "1").strip() != "CE" or self._pin(cell, "CE")
            if self._pin(cell, "LSR"):
                return 0
            return self._pin(cell, "DI") if enabled else before or 0
        now = self._factor(cell, "A"), self._factor(cell, "B"), self._product(name, cell)
        rows = zip(("INPUTA", "INPUTB", "OUTPUT"), before or (0, 0, 0), now, strict=True)
        return tuple(self._kept(cell, *row) for row in rows)

    def _kept(self, cell, register, before, now):
        if not self._has(cell, register) or self._pin(cell, cell["parameters"][f"REG_{register}_RST"]):
            return 0
        return now if self._pin(cell, cell["parameters"][f"REG_{register}_CE"]) else before


def difference(before, after, cycles=40, seed=1):
    """The first cycle in which two modules differ for random inputs, or None."""
    one, other, rng = Netlist(before), Netlist(after), random.Random(seed)
    rows = [{bit: rng.getrandbits(1) for bit in one.inputs} for _ in range(cycles)]
    return next((k for k, (a, b) in enumerate(zip(one.run(rows), other.run(rows), strict=True)) if a != b), None)
