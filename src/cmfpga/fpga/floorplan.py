"""Where the image's block RAMs lie on an ECP5: those of a bank side by side.

nextpnr's placer takes no notice of what belongs together among block RAMs, of which there are few sites. It strews a
bank over the whole width of the device, and the wires to its adders are longer than all that they compute.
"""

import re

#: Columns in which a row of block RAMs has four of them each, two apart, and the rows that are used.
_COLUMNS = {"LFE5U-85F": (4, 13, 22, 31, 40, 49, 58, 69, 78, 87, 96, 105, 114)}
_ROWS = 22, 46
#: Sites at the row's left end that stay free.
_FREE = 2
#: A RAM of a bank of a :class:`~cmfpga.rtl.image.tagged_accumulator.TaggedAccumulator`.
_RAM = re.compile(r"(?P<bank>(?:.*\.)?tagged_accumulator\.bank_\d)\.ram(?:\.ram_(?P<slice>\d+))?\.0\.(?P<part>\d+)")


def lay(module, device):
    """Give the banks' RAMs of a module of Yosys's JSON their sites, in place: half of the banks in each of two rows.

    The last RAM, which has the tag that all others' sums hang on, lies in the middle of its bank. Nothing changes on
    other devices than an LFE5U-85F, and where a row has too few sites.
    """
    sites = [(column + 2 * k, k) for column in _COLUMNS.get(device, ()) for k in range(4)][_FREE:]
    banks = {}
    for name, cell in module["cells"].items():
        if cell["type"] == "DP16KD" and (found := _RAM.fullmatch(name)):
            place = int(found["slice"] or 0), int(found["part"])
            banks.setdefault(found["bank"], []).append((place, cell))
    rows = [], []
    for number, bank in enumerate(sorted(banks)):
        *rams, tagged = (cell for _, cell in sorted(banks[bank], key=lambda ram: ram[0]))
        rams.insert(len(rams) // 2, tagged)
        rows[2 * number // len(banks)].extend(rams)
    if max(map(len, rows)) > len(sites):
        return
    for y, row in zip(_ROWS, rows, strict=True):
        for cell, (x, k) in zip(row, sites, strict=False):
            cell.setdefault("attributes", {})["BEL"] = f"X{x}/Y{y}/EBR{k}"
