"""Decoding EVT 2.0 and EVT 3.0 as it comes: equal to ``faery``'s decoding of whole files, however the bytes are cut."""

import numpy as np
import pytest

from cmfpga.events import Events, open_recording
from cmfpga.events.cameras import prophesee_header
from cmfpga.events.evt import EvtDecoder
from support.recordings import assert_same

WORDS = {"2.0": "<u4", "3.0": "<u2"}


def decoded(version, data, sizes):
    """All events of ``data``, given to a decoder in pieces of these sizes."""
    decoder, parts, at = EvtDecoder(version), [], 0
    for size in sizes:
        parts.append(decoder(data[at : at + size]))
        at += size
    assert at >= len(data) and decoder.rest == data[len(data) - len(decoder.rest) :]
    return Events(*map(np.concatenate, zip(*parts, strict=True)))


def cuts(rng, total, most):
    sizes = rng.integers(0, most, 2 * total // most + 10)
    return [*sizes.tolist(), total]


@pytest.mark.parametrize("name, version", [
    ("prophesee_driving_1280x720_evt3.raw", "3.0"), ("prophesee_spinner_640x480_evt2.raw", "2.0"),
])  # fmt: skip
def test_real_files(data_dir, rng, name, version):
    pytest.importorskip("faery")
    path = data_dir / "original_formats" / name
    if not path.exists():
        pytest.skip(f"no {name}")
    with open_recording(path) as recording:
        expected = Events.concatenate(recording.chunks())
    data = path.read_bytes()
    data = data[prophesee_header(data[:4096])[1] :]
    assert_same(decoded(version, data, cuts(rng, len(data), 9000)), expected)


@pytest.mark.parametrize("version", WORDS)
def test_any_words(tmp_path, rng, version):
    """Of all types; the time wraps, and its low part steps back."""
    pytest.importorskip("faery")
    kinds = [0, 1, 8, 10, 14, 15] if version == "2.0" else [0, 2, 2, 3, 4, 5, 6, 7, 8, 10, 14, 15]
    kind = rng.choice(kinds, 4000)
    kind[0] = 8
    high = np.cumsum(kind == 8) + (1 << 27) - 100
    if version == "2.0":
        words = kind << 28 | np.where(kind == 8, high, rng.integers(0, 1 << 28, 4000) & ~0x3FF & ~(0x3FF << 11) | 77)
    else:
        words = kind << 12 | np.where(kind == 8, high & 0xFFF, rng.integers(0, 1 << 12, 4000))
        words = np.where((kind == 0) | (kind == 2) | (kind == 3), words & ~0x400, words)  # within 0 to 1023 px
    data = words.astype(WORDS[version]).tobytes()
    (tmp_path / "a.raw").write_bytes(f"% evt {version}\n% end\n".encode() + data)
    with open_recording(tmp_path / "a.raw", sensor=(2048, 2048)) as recording:
        expected = Events.concatenate(recording.chunks())
    assert len(expected) > 800
    for most in (3, 50, 5000):
        assert_same(decoded(version, data, cuts(rng, len(data), most)), expected)


def test_joining_a_running_stream(rng):
    """What comes before the first high part of the time has no time."""
    words = np.array([0x0005, 0x6010, 0x2007, 0x8002, 0x2008, 0x6003, 0x2809], "<u2").tobytes()
    found = decoded("3.0", words, [3, 20])
    assert (found.t.tolist(), found.x.tolist(), found.y.tolist(), found.p.tolist()) == (
        [2 << 12, 2 << 12 | 3], [8, 9], [0, 0], [0, 1]
    )  # fmt: skip
