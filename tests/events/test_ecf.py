"""Prophesee's HDF5: the layout ``CD/events``, and its compression, against chunks encoded as it is published."""

import base64

import h5py
import numpy as np
import pytest

from cmfpga.errors import RecordingError
from cmfpga.events import ecf, open_recording

#: :func:`events`, encoded as https://github.com/prophesee-ai/hdf5_ecf describes it. No file of a camera, nor of
#: Prophesee's software, was tried.
CHUNKS = {
    "scattered": (
        "VgLXDKub&j000004-^3K_wn)Z0}%=U000zdv=ko_5h*h$#w9%@a1BS;2_jojf*xexHU@8$0vdvNNEeKz@++25C=;uo1Q4`hxFo+8Aq>;WzzE"
        "$abRFl?83h"
    ),
    "rows": (
        "p#T5?Kub&j000004-^3K_wn)Z0}<l?0r2<n@$mx@;{O5g_wn)Z0}<jM03rZ}3<>}gKp%pGVm$*#NE;<&Wp4z6hm0teU<*pLioYh44BbuVf(v"
        "g14-Q#^F)VU76$_MAG+%L(R(zL-Hv"
    ),
    "close": (
        "SONe5Kub&j000004-^3K_wn)Z0}<l?0r2<n@$mx@;{O5g_wn)Z0}<~R0RI8-_wn)Z0}<l?0r2<n@$mx@;{O5g_wn)Z10NLt5#s*=@b~fY@dF"
        "X!{{is#@$vBk5#s*=@b~fY@eddP5#s*=@b~fY@dFVb03raN3?cv@86p6mB_aS0G8O>V0G0t(0u}?-1C|6<1rrAL2DS%w2sR1!3APG$3pNZE4"
        "b}~o4pt8q5Y`Zu5mpit6ZR9f6m}Ih7WNjl7j_sn85SDW8kQSS9Dj@eiU"
    ),
}
COUNTS = {"scattered": 24, "rows": 40, "close": 150}


def events(kind):
    """Events of which the encoder packs y, x and p; x and p; or nothing."""
    k = np.arange(COUNTS[kind])
    found = np.zeros(len(k), ecf.DTYPE)
    found["t"] = 5_000_000 + np.cumsum(np.array([0, 0, 1, 14, 0, 15, 70_000])[k % 7] * (k % 40 > 19))
    found["p"] = k // 140 if kind == "close" else k * k // 7 % 2
    found["x"] = k // 34 + k * 3 // 2 % 256 if kind == "close" else k * 517 % 1280
    found["y"] = k * 331 % 720 if kind == "scattered" else k // 34 * 100
    return found


@pytest.mark.parametrize("kind", CHUNKS)
def test_chunks_of_the_encoder(kind):
    data = base64.b85decode(CHUNKS[kind])
    assert data[0] & 3 == {"scattered": 2, "rows": 1, "close": 0}[kind]
    np.testing.assert_array_equal(ecf.decode(data), events(kind))


@pytest.mark.parametrize("kind", CHUNKS)
def test_damaged_chunks(kind, rng):
    """Cut anywhere they are refused; a changed byte gives other events or a refusal, and nothing else."""
    data = base64.b85decode(CHUNKS[kind])
    for size in range(len(data) - 1):
        with pytest.raises(ecf.EcfError, match=f"damaged chunk of {size} bytes"):
            ecf.decode(data[:size])
    refused = 0
    for at in range(len(data)):
        changed = bytearray(data)
        changed[at] ^= int(rng.integers(1, 256))
        try:
            assert not np.array_equal(ecf.decode(bytes(changed)), events(kind)) or at >= len(data) - 12
        except ecf.EcfError:
            refused += 1
    assert refused > 3


def write(path, chunks=None, plain=None, geometry="1280x720"):
    """A file as Metavision writes it: of one compressed chunk each, or not compressed."""
    with h5py.File(path, "w") as file:
        group = file.create_group("CD")
        if plain is not None:
            group["events"] = plain
        else:
            size = max(COUNTS.values())
            layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            layout.set_chunk((size,))
            layout.set_filter(ecf.FILTER, h5py.h5z.FLAG_OPTIONAL)
            space = h5py.h5s.create_simple((size * (len(chunks) - 1) + COUNTS[chunks[-1]],), (h5py.h5s.UNLIMITED,))
            made = h5py.h5d.create(group.id, b"events", h5py.h5t.py_create(ecf.DTYPE), space, dcpl=layout)
            for k, kind in enumerate(chunks):
                made.write_direct_chunk((size * k,), base64.b85decode(CHUNKS[kind]))
        if geometry:
            file.attrs["geometry"] = geometry
    return path


def test_a_file_of_the_camera(tmp_path):
    """Two chunks; the second one's times go on from the first one's, and its last events are not there yet."""
    path = write(tmp_path / "a.hdf5", ["close", "scattered"])
    expected = np.concatenate([events("close"), events("scattered")])
    with open_recording(path) as recording:
        assert (recording.width, recording.height, recording.num_events) == (1280, 720, 174)
        assert (recording.time_unit, recording.time_unit_source, recording.format) == ("us", "file", "HDF5")
        found = next(recording.chunks(0, 150))
        assert [getattr(found, name).tolist() for name in "txyp"] == [expected[name][:150].tolist() for name in "txyp"]
        with pytest.raises(RecordingError, match="time stamp of event 150 is 5000000"):
            list(recording.chunks(0, 100))
        for start, size in ((3, 50), (149, 1), (150, 24)):
            assert next(recording.chunks(start, size)).x.tolist() == expected["x"][start : start + size].tolist()


def test_without_compression_and_damaged(tmp_path):
    plain, packed = write(tmp_path / "a.h5", plain=events("rows")), write(tmp_path / "b.h5", ["rows"], geometry=None)
    with open_recording(plain) as one, open_recording(packed, sensor=(1280, 720)) as other:
        for name in "txyp":
            assert getattr(next(one.chunks()), name).tolist() == getattr(next(other.chunks()), name).tolist()
    packed.write_bytes(packed.read_bytes().replace(base64.b85decode(CHUNKS["rows"])[4:40], bytes(36)))
    with pytest.raises(RecordingError, match=r"b.h5: events 0 to 39 cannot be read \(truncated or damaged\): ECF: "):
        open_recording(packed)
