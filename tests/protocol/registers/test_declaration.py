"""The register map: sound, the same for every configuration where it must be, and what it is read by."""

import numpy as np
import pytest
from amaranth.hdl import Signal

from cmfpga import __version__
from cmfpga.config import Config, preset
from cmfpga.errors import ConfigError
from cmfpga.protocol.flags import Flag
from cmfpga.protocol.registers import Field, Register, RegisterMap, register_map
from cmfpga.protocol.registers.contract import COUNTERS
from cmfpga.protocol.results import RESULTS, packet_beats
from cmfpga.protocol.settings import BatchSettings, settings_values
from cmfpga.protocol.shapes import leaves
from cmfpga.protocol.tables import tables_of, window_of, window_words
from cmfpga.protocol.words import result_values, setting_words, split_packets
from cmfpga.rtl.shell.tables import WRITES, leaves_of
from support.configs import WRAPPED


@pytest.fixture(scope="module", params=WRAPPED)
def config(request):
    return preset(request.param)


@pytest.fixture
def registers(config):
    return register_map(config)


def test_the_first_bytes_are_those_of_hls(registers):
    """AMD UG1399: control signals, global enable, enables and states of interrupts."""
    assert [register.name for register in registers][:4] == ["CTRL", "GIE", "IER", "ISR"]
    assert [register.offset for register in registers][:4] == [0x0, 0x4, 0x8, 0xC]
    bits = {f.name: f.lsb for f in registers["CTRL"].fields}
    assert (bits["START"], bits["DONE"], bits["IDLE"], bits["READY"], bits["AUTO_RESTART"]) == (0, 1, 2, 3, 7)
    assert [f.name for f in registers["IER"].fields] == [f.name for f in registers["ISR"].fields]


def test_discovery(registers, config):
    assert registers["ID"].offset == 0x10 and registers["ID"].reset.to_bytes(4, "big") == b"CMAX"
    version = registers["VERSION"].unpack(registers["VERSION"].reset)
    assert "{MAJOR}.{MINOR}.{PATCH}".format(**version) == __version__
    assert registers["BUILD"].reset == int(config.hardware_hash[:8], 16)
    sensor = registers["SENSOR"].unpack(registers["SENSOR"].reset)
    assert sensor == {"WIDTH": config.sensor_width, "HEIGHT": config.sensor_height}
    assert registers["RESULT_SIZE"].reset == packet_beats(config)


def test_offsets_do_not_depend_on_the_configuration():
    found = {}
    for name in WRAPPED:
        for register in register_map(preset(name)):
            assert found.setdefault(register.name, register.offset) == register.offset
    assert len(found) > 90


def test_run_time_values_do_not_change_it(config):
    own = {"sign": {"cold": "0:0"}, "newton": {"cold": "0:1:1"}, "constant": {"iterations": 3}}[config.ascent]
    own = own | ({} if config.regions else {"thinning": 2})
    own |= {"window_events": 70, "hop_us": 9} if config.slides else {"start": "zero"}
    changed = config.replace(min_roi_events=7, roi_gain=0.5, **own)
    assert register_map(changed) == register_map(config)


def test_every_setting_and_every_flag_has_its_place(registers, config):
    """All of BatchSettings, and where batches end; all flags of a result; no two counters on one word."""
    links = set(registers.linked("Settings"))
    seen = config.replace(camera="200,200,120,90") if config.motion == "rotation" else config
    wanted = set(settings_values(config, BatchSettings.from_config(seen)))
    unused = set() if config.ascent == "constant" else {"iterations", "eta"}
    unused |= {"roi_gain"} if config.motion == "rotation" else set()
    if config.regions:
        unused |= {"roi_load", "roi_x", "roi_y", "batch_roi_events", "thinning", "thin_target", "start_last"}
        unused |= {f"{plan}_{part}" for plan in ("cold", "warm") for part in ("first", "count")}
    assert links == (wanted - unused) | ({"every"} if config.slides else {"duration", "by_tlast"})
    flags = {f.name: f.lsb for f in registers["RESULT_FLAGS"].fields}
    wanted = {flag.name: flag.bit_length() - 1 for flag in Flag} | {"WIRE": 16, "CONFIG_RANGE": 17, "RESTARTED": 18}
    wanted |= {"LAST": 19, "REGION": 20} if config.regions else {}
    if not config.confidence:
        wanted = {name: bit for name, bit in wanted.items() if name not in ("DOUBTFUL", "SHORT", "RESTARTED")}
    assert flags == wanted
    more = {"results_skipped"} if config.slides else set()
    assert set(registers.linked("Counters")) == {name.lower() for name in COUNTERS} | more


def test_the_packet_is_the_result_registers(registers, config):
    """From word 0 on; only words of what this hardware has not are left out."""
    words = [(register.offset - 0x100) // 4 for register in registers.group("Result")]
    has = {leaf for f in RESULTS if f.when(config) for leaf in leaves(f.name, f.shape(config))}
    absent = {place.word for f in RESULTS for place in f.places if f.name + place.part not in has}
    assert words == sorted(set(words)) and {*range(28)} <= set(words) and words[-1] < 2 * packet_beats(config)
    assert {*range(words[-1])} - set(words) <= absent


def test_results_are_read_back(registers, config, rng):
    """Every value of a result, signed and long ones too, out of words that are packed here by hand."""
    words = rng.integers(0, 1 << 32, 2 * packet_beats(config), dtype=np.uint64)
    group = registers.group("Result")
    at = {register.name: int(words[(register.offset - 0x100) // 4]) for register in group}
    (row,) = split_packets(registers, words[0::2] | words[1::2] << np.uint64(32))
    assert row.tolist() == words.tolist()
    values = result_values(registers, row.tolist())

    def signed(value, bits):
        return value - (1 << bits) if value >> (bits - 1) else value

    assert values["batch"] == at["RESULT_BATCH"] and values["t_ref"] == at["RESULT_T_REF"]
    assert values["v_x"] == signed(at["RESULT_V_X"], 32) and values["roi_next_y"] == at["RESULT_ROI_NEXT"] >> 16
    assert values["sums_i"] == at["RESULT_SUM_I_HIGH"] << 32 | at["RESULT_SUM_I_LOW"]
    assert values["sums_sy"] == signed(at["RESULT_SY_HIGH"] << 32 | at["RESULT_SY_LOW"], 64)
    assert values["flags"] == at["RESULT_FLAGS"] & (int(sum(Flag)) if "confidence_limit" in values else 511)
    assert values["wire"] == at["RESULT_FLAGS"] >> 16 & 1
    if "confidence_limit" in values:
        assert values["sum_squares"] == at["RESULT_SQUARES_HIGH"] << 32 | at["RESULT_SQUARES_LOW"]
        part = "least" if "sums_sroll" in values else "cross"
        fallen = at[f"RESULT_CURVATURE_{part.upper()}_HIGH"] << 32 | at[f"RESULT_CURVATURE_{part.upper()}_LOW"]
        assert values[f"curvature_{part}"] == signed(fallen, 64)
    if "sums_sroll" in values:
        assert values["v_roll"] == signed(at["RESULT_V_ROLL"], 32)
        assert values["sums_sroll"] == signed(at["RESULT_SROLL_HIGH"] << 32 | at["RESULT_SROLL_LOW"], 64)
    with pytest.raises(ValueError, match=f"27 words of a result: {group[-1].offset // 4 - 63}"):
        result_values(registers, row[:27].tolist())


def test_settings_are_packed(registers, config):
    settings = {"roi_x": 3, "roi_y": 5, "v_start_x": -1, "start_last": True, "nothing": 7}
    words = setting_words(registers, settings)
    of_one = {} if config.regions else {"ROI": 5 << 16 | 3} | ({} if config.slides else {"START_MODE": 1})
    assert words == {"V_START_X": 0xFFFFFFFF, **of_one}
    with pytest.raises(ValueError, match="VALUE = 4294967296: 0 to 4294967295"):
        setting_words(registers, {"hop_events" if config.slides else "batch_events": 1 << 32})


@pytest.mark.parametrize("name", ["objects", "flow"])
def test_a_row_of_a_table_fits_its_registers(name):
    """Every leaf of a row once, with its own largest value; what is beyond a field is refused before it is written."""
    config = preset(name)
    registers = register_map(config)
    sizes = registers["REGIONS"].unpack(registers["REGIONS"].reset)
    assert sizes == {"ROWS": config.regions, "UNITS": config.units, "BIN_BITS": config.bin_bits}
    for table in tables_of(config):
        fields = {f.link: f for register in window_of(registers, table) for f in register.fields}
        assert list(fields) == [*dict.fromkeys(fields)] and set(fields) == set(leaves_of(Signal(WRITES[table](config))))
        values = {link: f.range[1] if f.high is None else f.high for link, f in fields.items()}
        assert all(f.high is None or f.high <= f.range[1] for f in fields.values())
        words = window_words(registers, table, values)
        assert [register.name for register, _ in words][-1] == f"{table.upper()}_WRITE"
        assert all(f.unpack(word) == values[f.link] for register, word in words for f in register.fields)


def test_time_stamps_of_more_bits_are_refused():
    with pytest.raises(ConfigError, match="time_bits = 34: at most 32"):
        register_map(Config(time_bits=34))


def register(name="A", offset=0, **fields):
    keys = "lsb", "width", "access"
    made = (Field(name=one, doc="", **dict(zip(keys, what, strict=True))) for one, what in fields.items())
    return Register(name=name, offset=offset, group="g", doc="", fields=tuple(made))


@pytest.mark.parametrize("wrong", [
    (register(), register(offset=4)),  # a name twice
    (register(), register("B")),  # an offset twice
    (register(offset=2),),  # not a word
    (register(offset=0x1000),),  # beyond the map
    (register(f=(0, 8, "stored"), g=(7, 1, "status")),),  # bits twice
    (register(f=(30, 3, "stored")),),  # too many bits
    (register(f=(0, 1, "rw")),),  # an access that is none
])  # fmt: skip
def test_a_map_that_is_not_sound_is_refused(wrong):
    with pytest.raises(ValueError, match=r"used twice|out of place"):
        RegisterMap(wrong)


def test_names_that_are_not_there():
    found = register(f=(0, 1, "stored"))
    with pytest.raises(KeyError, match="A has no field g; it has f"):
        found["g"]
