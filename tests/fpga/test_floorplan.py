"""Sites of the image's block RAMs."""

import pytest

from cmfpga.fpga.floorplan import lay


def module_of(*names, kind="DP16KD"):
    return {"cells": {name: {"type": kind, "attributes": {}} for name in names}}


def banks(images=("image.",), slices=("",), parts=1):
    return [
        f"{image}tagged_accumulator.bank_{bank}.ram{one}.0.{part}"
        for image in images
        for bank in range(4)
        for one in slices
        for part in range(parts)
    ]


def sites_of(module):
    found = {name: cell["attributes"].get("BEL") for name, cell in module["cells"].items()}
    return {name: (int(at[1:].split("/")[0]), at.split("/")[1], at.split("/")[2]) for name, at in found.items() if at}


@pytest.mark.parametrize("names", [
    banks(),
    banks(slices=[f".ram_{bit}" for bit in range(0, 56, 4)]),
    banks([f"image.image_{k}." for k in range(4)], parts=3),
    banks([f"image$309.image_{k}." for k in range(4)], parts=4),
], ids=["one RAM a bank", "deep banks", "four images", "four wide images"])  # fmt: skip
def test_a_banks_rams_lie_side_by_side(names):
    """Half of the banks in each of two rows, no two on a site, and between a bank's first and last no other bank's."""
    module = module_of(*names)
    lay(module, "LFE5U-85F")
    sites = sites_of(module)
    assert {*sites} == {*names} and len({*sites.values()}) == len(names)
    for row in ("Y22", "Y46"):
        here = sorted((site, name.split(".ram")[0]) for name, site in sites.items() if site[1] == row)
        here = [bank for _, bank in here]
        runs = [bank for k, bank in enumerate(here) if here[k - 1 : k] != [bank]]
        assert len(runs) == len({*runs}) and 2 * len(here) == len(names)


def test_the_tag_lies_in_the_middle():
    """Wherever its name comes in the order of text: the last slice has it."""
    names = banks(slices=[f".ram_{bit}" for bit in (0, 4, 8, 12, 48)])
    module = module_of(*names)
    lay(module, "LFE5U-85F")
    sites = sites_of(module)
    for bank in range(4):
        row = sorted((name for name in names if f"bank_{bank}" in name), key=lambda name: sites[name][0])
        assert [int(name.split("_")[-1].split(".")[0]) for name in row] == [0, 4, 48, 8, 12]


@pytest.mark.parametrize("module, device", [
    (module_of(*banks()), "LFE5U-25F"),
    (module_of(*banks(), kind="TRELLIS_FF"), "LFE5U-85F"),
    (module_of("event_buffer.events.0.0", "x.bank_0.ram.0.0"), "LFE5U-85F"),
    (module_of(*banks(parts=26)), "LFE5U-85F"),
], ids=["another device", "no RAM", "other RAMs", "too many"])  # fmt: skip
def test_what_stays_as_it_was(module, device):
    lay(module, device)
    assert not sites_of(module)
