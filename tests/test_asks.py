"""What makes a test long is found."""

import contextlib
import subprocess

import pytest

from cmfpga.config import preset
from cmfpga.fpga import levels
from cmfpga.verilog.simulation import VerilatedCore
from support import asks, designs

#: Hardware that no other test makes: what was made before is kept, and no longer asked for.
OTHER = preset("fast").replace(sensor_width=231)


def starts():
    subprocess.run(["true"], check=True)


@contextlib.contextmanager
def through():
    yield [starts() for _ in range(2)]


def decorated():
    with through():
        pass


class Holder:
    @property
    def value(self):
        return levels.levels("")


@pytest.mark.parametrize("function, why", [
    (starts, {"process"}), (through, {"process"}), (decorated, {"process"}), (Holder, {"Yosys"}),
    (lambda: VerilatedCore(designs.SMALL), set()), (lambda: VerilatedCore(designs.configured(designs.FAST)), set()),
    (lambda: VerilatedCore({"a": [OTHER]}["a"][0]), {"design"}), (lambda: (OTHER, designs.QUICK), set()),
])  # fmt: skip
def test_what_a_function_asks_for_is_found(function, why):
    found = asks.Asked()
    found._callable(function)
    assert found.why == why


def rooms(names):
    """First folders of test names."""
    return {name.partition("/")[0] for name in names if "/" in name}


def test_one_test_of_each_kind_and_of_each_room_is_quick(request):
    found = asks.collected
    if request.config.args != ["tests"]:
        pytest.skip("of the whole suite")
    assert set(asks.SMOKE) <= set(found)
    quick = {name for name, why in found.items() if not why or name in asks.SMOKE}
    kinds = {kind for why in found.values() for kind in why}
    assert kinds - asks.SLOW_TO_START == {kind for name in quick for kind in found[name]}
    assert rooms(found) - {"formal"} == rooms(quick)  # which is the solver's alone
