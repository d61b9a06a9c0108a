"""Words of EVT 2.0, 2.1 and 3.0, of files and of streams: encoded here, and decoded in pieces of any size.

Random words of all types are held against the model of the hardware's decoder, and EVT 3.0 against ``faery``.
"""

import functools
import io
import re

import numpy as np
import pytest

from cmfpga.config import preset
from cmfpga.events import Events
from cmfpga.events.evt import WORD_BYTES, EvtDecoder, TimeWords
from cmfpga.events.raw import FORMS
from cmfpga.reference.wire import decode, to_beats
from support.recordings import assert_cut_off, assert_reads, assert_same, evt2, evt3, evt21, make_events, refusal

#: ``(header, encoder)`` of each version, as cameras' programs write it.
VERSIONS = {
    "evt2": ("% evt 2.0\n% geometry 320x240\n", evt2),
    "evt21": ("% evt 2.1\n% format EVT21;height=240;width=320\n% end\n", evt21),
    "evt21-legacy": ("% evt 2.1\n% format EVT21;endianness=legacy;height=240;width=320\n% end\n",
                     functools.partial(evt21, legacy=True)),
    "evt3": ("% camera x\n% format EVT3;height=240;width=320\n% end\n", evt3),
    "evt3 vectors": ("% evt 3.0\n% geometry 320x240\n% end\n", functools.partial(evt3, vectors=True)),
}  # fmt: skip


def decoded(version, data, sizes, early=0):
    """All events of ``data``, given to a decoder in pieces of these sizes; so many come ahead of the first time."""
    decoder, file = EvtDecoder(version), io.BytesIO(data)
    parts = [decoder(file.read(size)) for size in sizes]
    assert not file.read() and decoder.rest == data[len(data) - len(decoder.rest) :] and decoder.early == early
    return Events(*map(np.concatenate, zip(*parts, strict=True)))


def cuts(rng, total, most):
    sizes = rng.integers(0, most, 2 * total // most + 10)
    return [*sizes.tolist(), total]


def bursts(rng, count=3000):
    """Events of which many share time, row and polarity, in rising columns."""
    events = make_events(rng, count, width=320, height=240, step=5000)
    t, y, p = (np.repeat(getattr(events, name)[: count // 6], 6) for name in "typ")
    x = (np.repeat(rng.integers(0, 290, count // 6), 6) + np.tile(np.arange(6), count // 6) * rng.integers(1, 5)) % 320
    return Events(t, x, y, p)


@pytest.mark.parametrize("form", VERSIONS)
def test_every_version(tmp_path, rng, form):
    """From a file, with a header and by ``--format`` without one; and as a stream, in pieces of any size."""
    header, encode = VERSIONS[form]
    events, form = bursts(rng), form.partition(" ")[0]
    data = encode(events)
    if form != "evt2":  # the vectors are used
        assert len(data) < 3000 * (4 if form == "evt3" and "vectors" in header else 24)
    (tmp_path / "a.raw").write_bytes(header.encode() + data)
    (tmp_path / "b.raw").write_bytes(data)
    recording = assert_reads(tmp_path / "a.raw", events)
    assert (recording.width, recording.height) == (320, 240)
    assert recording.format.startswith(f"Prophesee RAW (EVT {FORMS[form].partition(' ')[0]}")
    recording = assert_reads(tmp_path / "b.raw", events, form=form, start=0, size=700)
    assert recording.width is None and recording.notes() == []
    for most in (3, 50, 5000):
        assert_same(decoded(FORMS[form], data, cuts(rng, len(data), most)), events)


def test_any_words_of_evt3(tmp_path, rng):
    """Of all types; the time wraps, and its low part steps back."""
    faery = pytest.importorskip("faery")
    kind = rng.choice([0, 2, 2, 3, 4, 5, 6, 7, 8, 10, 14, 15], 4000)
    kind[0] = 8
    high = np.cumsum(kind == 8) + (1 << 12) - 100
    words = kind << 12 | np.where(kind == 8, high & 0xFFF, rng.integers(0, 1 << 12, 4000))
    words = np.where((kind == 0) | (kind == 2) | (kind == 3), words & ~0x400, words)  # within 0 to 1023 px
    data = words.astype("<u2").tobytes()
    (tmp_path / "a.raw").write_bytes(b"% evt 3.0\n% end\n" + data)
    stream = faery.events_stream_from_file(tmp_path / "a.raw", file_type="evt", dimensions_fallback=(2048, 2048))
    expected = Events.concatenate(Events(part["t"].astype(int), part["x"], part["y"], part["on"]) for part in stream)
    assert len(expected) > 800
    for most in (3, 50, 5000):
        assert_same(decoded("3.0", data, cuts(rng, len(data), most)), expected)


@pytest.mark.parametrize("form", ["EVT20", "EVT21"])
def test_any_words_as_the_hardware_decodes_them(rng, form):
    """Of all types; the time wraps. Polarities do not reach the hardware, and it leaves times that step back."""
    kind = rng.choice([0, 1, 8, 10, 14, 15], 4000)
    kind[0] = 8
    high = np.cumsum(kind == 8) + (1 << 28) - 100 & (1 << 28) - 1
    others = rng.integers(0, 1 << 28, 4000) & ~(0x3F << 22 | 0x3FF << 11 | 0x3FF) | 77
    low = np.where(kind <= 1, np.sort(rng.integers(0, 64, 4000)), 0)
    words = kind << 28 | np.where(kind == 8, high, others | low << 22)
    vectors = rng.integers(0, 1 << 32, 4000) * (form == "EVT21")
    pairs = zip(vectors, words, strict=True) if form == "EVT21" else words.reshape(-1, 2)
    config = preset("fast").replace(time_bits=34)
    tokens, _ = decode(config, to_beats([int(upper) << 32 | int(lower) for lower, upper in pairs]), form)
    t, x, y = np.array([token[:3] for token in tokens if token.event]).T
    t += (t < t[0]) * (1 << 34)  # wrapped once
    data = words.astype("<u4") if form == "EVT20" else np.stack([vectors, words], axis=1).astype("<u4")
    legacy = {"2.1 legacy": data[:, ::-1].tobytes()} if form == "EVT21" else {}
    for version, content in {form[3] + "." + form[4]: data.tobytes(), **legacy}.items():
        for most in (3, 50, 50_000):
            found = decoded(version, content, cuts(rng, len(content), most))
            assert len(found) > 800 and (found.t == np.maximum.accumulate(t)).all()
            assert (found.x == x).all() and (found.y == y).all() and 0.4 < found.p.mean() < 0.6


def any_evt3(rng, count):
    """Words of all types in no order, time loops in steps on and back, columns far outside: uint16 array."""
    kind = rng.choice([0, 2, 2, 3, 4, 4, 5, 6, 8, *range(16)], count)
    value = rng.integers(0, 1 << 12, count)
    high = np.cumsum((kind == 8) * rng.choice([0, 1, 40, 1500, 2047, 2048, 3000, -1, -300], count))
    kind[: count // 8][kind[: count // 8] == 8] = 6
    return (kind << 12 | np.where((kind == 8) & (rng.random(count) < 0.95), high & 0xFFF, value)).astype("<u2")


def test_any_words_of_evt3_as_the_hardware_decodes_them(rng):
    """Whatever comes ahead of a row, a base or a time; columns beyond 4096 have no value there."""
    words = any_evt3(rng, 8000)
    tokens, counts = decode(preset("fast"), to_beats(words.view("<u8")), "EVT30")
    early = sum(not token.known for token in tokens if token.event)
    t, x, y = np.array([token[:3] for token in tokens if token.event and token.known]).T
    for most in (3, 50, 50_000):
        found = decoded("3.0", words.tobytes(), cuts(rng, words.nbytes, most), early)
        assert early > 50 and len(found) == len(t) > 5000
        assert found.t.max() > 1 << 28 and (found.t % (1 << 32) == t).all() and (found.y == y).all()
        assert (np.minimum(found.x, 4096) == np.minimum(x, 4096)).all() and 20 < (x >= 2048).sum() < len(x)
    assert counts["time_high_back"] > 40 and counts["other_words"] > 800 and counts["format_errors"] > 800


def time_words(version, high, others):
    """Words of these high parts, each with so many others behind it."""
    size, shift, content = WORD_BYTES[version], 12 if version == "3.0" else 28, b""
    for one, count in zip(high.tolist(), others.tolist(), strict=True):
        for word in (0x8 << shift | one & (1 << shift) - 1, *[0x2 << shift | 77] * count):
            word, vector = word.to_bytes(min(size, 4), "little"), b"\x01\0\0\0" * (size == 8)
            content += word + vector if version == "2.1 legacy" else vector + word
    return content


def judged(version, data, sizes):
    """What is left of the bytes, given in pieces, and how many words of time were left out."""
    times, file = TimeWords(version), io.BytesIO(data)
    return b"".join([*(times(file.read(size)) for size in sizes), times(b"", last=True)]), times.wrong


@pytest.mark.parametrize("version", WORD_BYTES)
def test_wrong_words_of_time_are_left_out(rng, version):
    """Those that rise never are, whatever the gaps, nor those that step back a little; in pieces of any size."""
    most = 700 if version == "3.0" else 45_000_000
    for gaps in ([0, 0, 1], [0, 1, 3, 700], [0, 1, most], [-1, 0, 1, 1, 300]):
        high = 5000 + np.cumsum(rng.choice(gaps, 400))
        data = time_words(version, high, rng.integers(0, 4, 400))
        for pieces in (3, 50, 50_000):
            assert judged(version, data, cuts(rng, len(data), pieces)) == (data, 0)
    high, others = 5000 + np.cumsum(rng.integers(0, 2, 400)), rng.integers(0, 4, 400)
    clean, wrong, behind = time_words(version, high, others), high.copy(), others.copy()
    at = np.array([0, 9, 10, 11, 12, 30, 200, 202, 205, 390, 399])
    far = [1000, 1000, -900, 400, 1400, 500, -500, 777, 900, 1500, 700]
    # A wrong word, and the right one's others behind it.
    wrong, behind = np.insert(high, at, high[at] + far), np.insert(others, at, 0)
    data = time_words(version, wrong, behind)
    for pieces in (3, 50, 50_000):
        assert judged(version, data, cuts(rng, len(data), pieces)) == (clean, len(at))


EARLY = {
    "evt2": (np.array([0x00003801, 0x80000001, 0x10404002, 0x00805003], "<u4"), [(65, 8, 2, 1), (66, 10, 3, 0)]),
    "evt21": (
        np.array([0x00003801_00000003, 0x80000001_00000000, 0x10404002_00000001, 0x00805003_00000001], "<u8"),
        [(65, 8, 2, 1), (66, 10, 3, 0)],
    ),
    # The row of the first word holds on.
    "evt3": (np.array([0x0005, 0x6010, 0x2007, 0x8002, 0x2008, 0x6003, 0x2809], "<u2"),
             [(2 << 12, 8, 5, 0), (2 << 12 | 3, 9, 5, 1)]),
}  # fmt: skip


@pytest.mark.parametrize("form", EARLY)
def test_events_ahead_of_the_first_word_of_time(tmp_path, form):
    """They have no time: left out of files and streams alike, and counted."""
    words, events = EARLY[form]
    expected = dict(zip("txyp", map(list, zip(*events, strict=True)), strict=True))
    (tmp_path / "a.raw").write_bytes(words.tobytes())
    recording = assert_reads(tmp_path / "a.raw", expected, form=form)
    early = 2 if form == "evt21" else 1
    told = f"{early} events ahead of the first time word have no time: they are left out"
    assert recording.notes() == [f"{tmp_path / 'a.raw'}: {told}"]
    assert_same(decoded(FORMS[form], words.tobytes(), [3] * words.nbytes, early), Events(**expected))


@pytest.mark.parametrize("header, options, message", [
    ("% Date 2020\n", {}, "begins with '%', but names no version of EVT; a header of EVT 2.0, 2.1 or 3.0, or --format"),
    ("% evt 4.0\n", {}, "version '4.0'; '% evt' or '% format' of EVT 2.0, 2.1 or 3.0 is needed"),
    ("% format HISTO3D;height=320\n", {}, "version 'HISTO3D;height=320'; '% evt' or '% format' of EVT 2.0, 2.1 or 3"),
    ("% format EVT21;endianness=big\n", {}, "EVT 2.1 of endianness 'big'; little or legacy is needed"),
    ("% evt 2.0\n", {"form": "evt5"}, "format 'evt5'; did you mean 'evt3'. One of evt2, evt21, evt21-legacy, evt3"),
    ("", {}, "does not begin like it: .*--format evt2"),
])  # fmt: skip
def test_what_is_not_read(tmp_path, rng, header, options, message):
    (tmp_path / "a.raw").write_bytes(header.encode() + evt2(bursts(rng)))
    assert re.search(message, refusal(tmp_path / "a.raw", **options))


@pytest.mark.parametrize("header, sensor", [
    ("% plugin_name hal_plugin_gen3_fx3\n% evt 2.0\n", (640, 480)),
    ("% evt 2.0\n% plugin_name hal_plugin_gen41_evk3\n", (1280, 720)),
    ("% evt 2.0\n% sensor_name IMX636\n% plugin_name hal_plugin_prophesee\n", (1280, 720)),
    ("% evt 2.0\n% sensor_generation 320.0\n", (320, 320)), ("% evt 2.0\n% sensor_name GenX320\n", (320, 320)),
    ("% evt 2.0\n% generation 3.1\n", (640, 480)), ("% evt 2.0\n% plugin_name mine\n", (None, None)),
    ("% evt 2.0\n% plugin_name hal_plugin_imx636\n% geometry 330x240\n", (330, 240)),
    ("% format EVT2;width=325;height=280\n", (325, 280)),
])  # fmt: skip
def test_sensor(tmp_path, rng, header, sensor):
    events = make_events(rng, 300)
    (tmp_path / "a").write_bytes(header.encode() + evt2(events))
    recording = assert_reads(tmp_path / "a", events)
    assert (recording.width, recording.height) == sensor


@pytest.mark.parametrize("form, word", [("evt2", 4), ("evt21", 8), ("evt21-legacy", 8), ("evt3", 2)])
def test_truncated_within_a_word(tmp_path, rng, form, word):
    events, path = bursts(rng), tmp_path / "a"
    content = VERSIONS[form][0].encode() + VERSIONS[form][1](events)
    path.write_bytes(content[: len(content) - word * 100 - 1])
    message = f"truncated: {word - 1} of {word} bytes of the last word are there; the {{}} events before were read"
    assert_cut_off(path, events, message, 2201)
