"""Text recordings: exact times, forms of lines, odd lines."""

import gzip
import time
import zipfile
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from cmfpga.events import open_recording, text
from cmfpga.events.textlines import Layout, LineError, parse_fast, parse_line
from support.recordings import assert_reads, columns, make_events, refusal, text_lines, write_by_faery


@pytest.fixture
def txt(tmp_path):
    """``txt(content)``: path of a text file."""

    def write(content, name="a.txt"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.mark.parametrize("head", ["", "240 180\n", "foo bar baz qux quux\n", "# mine\n"])
def test_columns_in_the_order_that_is_told(txt, head):
    """Names that are not known, and those that say otherwise, are passed over."""
    path = txt(head + "3 4 9 1000 1\n5 6 9 2000 0\n")
    found = {"t": [1000, 2000], "x": [3, 5], "y": [4, 6], "p": [1, 0]}
    assert_reads(path, found, columns="x, y, id, T, p", time_unit="us")
    assert_reads(txt("t x y p\n1 2 3 0\n"), {"t": [0]}, columns="p,x,y,t")
    assert "line 2: t is 'x'" in refusal(txt("1 2 3 0\n1 2 3 x\n"), columns="p,x,y,t")


def test_order_of_columns_without_names(txt, rng):
    """As Metavision (commas) and eDVS (blanks) write them."""
    events = make_events(rng)
    for name, separator in (("events.csv", ","), ("edvs.txt", " ")):
        rows = zip(events.x, events.y, events.p, events.t, strict=True)
        path = txt("".join(f"{separator.join(map(str, row))}\n" for row in rows), name)
        assert_reads(path, events)
        with open_recording(path) as recording:
            taken = "columns taken as x,y,p,t, as their values are; --columns gives another order"
            assert recording.notes() == [f"{path}: {taken}"]
    message = refusal(txt("when,x,y,p\n1,2,3,1\n"))
    assert message.endswith("a number is needed; --columns (columns=) says which is which")
    message = refusal(txt("20 1 2 1\n10 1 2 0\n"), "read")
    assert "(columns t, x, y, p; --columns (columns=) gives another order): time stamp of event 1" in message


@pytest.mark.parametrize("columns", ["x,y,t", "x,y,t,t,p", "", "txyp", 3, [1, 2, 3, 4]])
def test_columns_that_are_none(txt, columns):
    assert "t, x, y and p, each once, in their order are needed" in refusal(txt("1 2 3 0\n"), columns=columns)


def test_what_cannot_be_told(txt, tmp_path):
    path = txt("1 2 3 0\n")
    assert "text; dataset can be told of ROS 2 bag, ROS 1 bag, HDF5 only" in refusal(path, dataset="a")
    path.write_bytes(gzip.compress(b"\0\1\2"))
    assert "gzip of something else than text; text is needed" in refusal(path)
    path.write_bytes(gzip.compress(b""))
    assert "an empty text; text is needed" in refusal(path)


TIMES = {
    "s": {
        "0.000000000": 0, "0.000000499": 0, "0.0000005": 1, "0.00000049999999999999999999999999999999": 0,
        "0.000001": 1, "0.003820001": 3820, "0.1234565": 123457, "1468939993.067416019": 1468939993067416,
        "1468939993.0674165": 1468939993067417, "999999999999.999999": 999999999999999999, "-0.0000005": 0,
        "-0.00000051": -1, "-1.5": -1500000, "4611686018427.387903": 2**62 - 1, "-4611686018427.387903": 1 - 2**62,
        "1e-3": 1000, "+2.5E0": 2500000, ".25": 250000, "3.": 3000000,
    },
    "ms": {"12.3456": 12346},
    "us": {"12.5": 13},
    "ns": {"1499": 1, "1468939993067416501": 1468939993067417, "1500.0": 2},
}  # fmt: skip


@pytest.mark.parametrize("unit, text_time", [(unit, text_time) for unit in TIMES for text_time in TIMES[unit]])
def test_times_are_exact(txt, unit, text_time):
    assert_reads(txt(f"{text_time} 1 2 1\n"), {"t": [TIMES[unit][text_time]]}, time_unit=unit)


# What the fast reader takes, and some that it leaves to the other.
_PLAIN_TIME = st.from_regex(r"[0-9]{1,19}(\.[0-9]{0,12})?", fullmatch=True)
_ANY_TIME = st.from_regex(r"[+-]?([0-9]{1,9}\.?[0-9]{0,20}|\.[0-9]{1,9})(e[+-]?[0-9])?", fullmatch=True)
_NUMBERS = st.integers(-9, 99999), st.integers(0, 999), st.sampled_from([-1, 0, 1])


@settings(deadline=None)
@given(
    rows=st.lists(st.tuples(_PLAIN_TIME | _ANY_TIME, *_NUMBERS), min_size=1, max_size=8),
    space=st.sampled_from([" ", "\t", "  ", ","]),
    end=st.sampled_from(["\n", "\r\n", " \n", "\n\n"]),
    last=st.booleans(),
    power=st.sampled_from([6, 3, 0, -3]),
)
def test_fast_and_slow_reader_agree_with_fractions(rows, space, end, last, power):
    block = end.join(space.join(map(str, row)) for row in rows) + (end if last else "")
    expected = [((Fraction(t) * Fraction(10) ** power + Fraction(1, 2)).__floor__(), x, y, p) for t, x, y, p in rows]
    assume(all(abs(row[0]) < 2**62 and abs(Fraction(t)) < 10**20 for row, (t, *_) in zip(expected, rows, strict=True)))
    slow = [parse_line(line, power) for line in block.encode().split(b"\n")]
    assert [row for row in slow if row] == expected
    fast = parse_fast(block.encode(), power)
    if fast is not None:
        assert list(map(tuple, np.stack(fast, axis=1).tolist())) == expected


def test_fast_reader_takes_the_usual_lines():
    """Otherwise the test above shows nothing, and reading is slow."""
    for block in (b"0.1 1 2 0\n12.000000001 3 4 1\n", b"5 1 2 -1\r\n\r\n6,3,4,1", b"0. 1 1 1\n", b"\n \n"):
        assert parse_fast(block, 6) is not None, block


@pytest.mark.parametrize("block", [
        b"1 2 3\n", b"1 2 3 4 5\n1 2 3\n", b"1 2 3 4 1 2 3 4\n", b"1.2.3 4 5 1\n", b". 1 1 1\n", b"1 2.0 3 1\n",
        b"1 - 3 1\n", b"1 2- 3 1\n", b"-1 2 3 1\n", b"1 2 3 .\n", b"1 1 9999999999999999999 1\n",
        b"1 1 1 12345678901234567890\n", b"1234567890123456789 1 1 1\n", b"# 1 1 1\n",
        b"1 1 1 1x\n", b"1 1 1 \xff\n", b"1 2 --3 1\n", b"1 2\n3 1\n",
])  # fmt: skip
def test_fast_reader_leaves_the_unusual(block):
    assert parse_fast(block, 6) is None


def test_comments_blank_lines_and_header(txt):
    path = txt("# DAVIS 240C\n\n240 180\n# t x y p\n0.001 1 2 1\n\n  # more\n0.002\t3,4 0 # last\n\r\n0.003 5 6 1")
    recording = assert_reads(path, {"t": [1000, 2000, 3000], "x": [1, 3, 5], "y": [2, 4, 6], "p": [1, 0, 1]})
    assert (recording.width, recording.height, recording.time_unit, recording.num_events) == (240, 180, "s", None)
    with open_recording(path, sensor=(346, 260)) as recording:
        assert (recording.width, recording.height) == (346, 260)


def test_columns_as_others_write_them(txt, rng):
    events = make_events(rng, 200)
    path = txt("")
    np.savetxt(path, np.stack(columns(events), axis=1) * [1e-6, 1, 1, 1])
    assert_reads(path, events)
    assert_reads(txt("1 1 1 True\n2 1 1 false\n"), {"p": [1, 0]})


@pytest.mark.parametrize("size", [100, 1000, 1 << 20])
def test_blocks_do_not_matter(txt, rng, monkeypatch, size):
    """Lines across blocks, comments that fill more than one block."""
    monkeypatch.setattr(text, "_BLOCK_BYTES", size)
    events = make_events(rng, 500)
    lines = text_lines(*columns(events))
    path = txt("# " + "c" * 90 + "\n" + "# comment\n" * 200 + "240 180\n" + lines)
    assert_reads(path, events)
    assert_reads(path, events[123:], start=123, size=45)
    assert ", line 703: 2 fields" in refusal(txt(path.read_bytes() + b"9 9\n" + lines.encode()), "either")


ODD_LINES = {
    "0.5 1 2": "3 fields in '0.5 1 2'; 4 are needed", "0.5": "1 field in '0.5'; 4 are needed",
    "0.5 1 2 1 7": "5 fields", "240 180": "2 fields", "x" * 5000: "4",
    "0.5 1 two 1": "y is 'two'; a number is needed", "0.5 1 2 -": "p is '-'; a number is needed",
    "0.5 0x1 2 1": "x is '0x1'", "0.5 1_0 2 1": "x is '1_0'", "0..5 1 2 1": "t is '0..5'", "\xff\xfe 1 2 1": "t is ",
    "0.5 1.5 2 1": "x is 1.5; a whole number is needed", "0.5 nan 2 1": "x is nan; a finite number is needed",
    "nan 1 2 1": "t is nan; a finite number is needed", "-Inf 1 2 1": "t is -Inf; a finite number is needed",
    "0.5 1 12345678901234567890 1": "y is 12345678901234567890; a number that fits in 64 bits",
    "1e30 1 2 1": "fewer than 21 digits", "99999999999999 1 2 1": "less than 2^62 µs",
    "1" * 3_000_000: "more than 4096 bytes; 't x y p' is needed",
}  # fmt: skip


@pytest.mark.parametrize("line, message", ODD_LINES.items(), ids=[line[:20] for line in ODD_LINES])
@pytest.mark.parametrize("before, after", [(1, 1), (5000, 1), (1, 0)])
def test_odd_line_is_named(txt, line, message, before, after):
    """Also if it is the last, as of a file that was cut."""
    path = txt("# header\n" + "0.25 1 2 1\n" * before + line + "\n0.75 1 2 1\n" * after)
    told = refusal(path, "either")
    assert told.startswith(f", line {before + 2}: ") and message in told


@pytest.mark.parametrize("content", ["# nothing\n", "\n\n", "240 180\n", "# a\n240 180\n# b\n"])
def test_no_events(txt, content):
    assert refusal(txt(content)).endswith("no events")


def test_line_error_says_nothing_of_places():
    with pytest.raises(LineError, match=r"^3 fields"):
        parse_line(b"1 2 3", 6)


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name.replace("__", "/").replace("_", "."), content)
    return path


def test_archive_with_one_text(tmp_path):
    path = archive(tmp_path / "a.zip", data__slider_txt="240 180\n0.5 1 2 1\n", readme_md="hello")
    recording = assert_reads(path, {"t": [500_000]})
    assert (recording.format, recording.width, recording.num_events) == ("zipped text", 240, None)
    assert recording.name == f"{path}/data/slider.txt"


@pytest.mark.parametrize("members", [dict(a_txt="1 1 1 1", b_txt="1 1 1 1"), dict(a_png="x"), {}])
def test_archive_without_clear_member(tmp_path, members):
    assert "without one .txt or .csv" in refusal(archive(tmp_path / "a.zip", **members))


def test_speed(txt, rng):
    events = make_events(rng, 100_000)
    with open_recording(txt(text_lines(*columns(events)))) as recording:
        begin = time.process_time()
        count = sum(map(len, recording.chunks()))
        rate = count / (time.process_time() - begin)
    assert count == 100_000
    assert rate > 300_000  # over 1.5 million/s; line by line would be 0.15


@pytest.mark.parametrize("header, rows", [
    ("t,x,y,p", "1000,1,2,1\n2000,3,4,0\n"),
    ("timestamp,x,y,polarity", "1000,1,2,1\n2000,3,4,0\n"),
    ("timestamp [us];x;y;polarity", "1000;1;2;1\n2000;3;4;0\n"),
    ('"x","y","t (ms)","p"', "1,2,1,True\n3,4,2,False\n"),
    ("x,y,on,t_s", "1,2,1,0.001\n3,4,0,0.002\n"),
    ("x y pol time", "1 2 1 1000\n3 4 0 2000\n"),
    (",t,x,y,p,note", "0,1000,1,2,1,7\n1,2000,3,4,0,7\n"),
    ("id,t,x,y,p,quality", "a,1000,1,2,1,0.5\nb,2000,3,4,0,nan\n"),
    ("# x y p t", "1 2 1 1000\n3 4 0 2000\n"),
    ("# made on Monday\n240,180\n#x,y,t [ns],p", "1,2,1000000,1\n3,4,2000000,0\n"),
])  # fmt: skip
@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["", "BOM"])
def test_names_of_columns(txt, header, rows, mark):
    assert_reads(txt(f"{mark}{header}\n{rows}", "a.csv"), {"t": [1000, 2000], "x": [1, 3], "y": [2, 4], "p": [1, 0]})


@pytest.mark.parametrize("content", ["0.001 1 2 1\n0.002 3 4 0", "240 180\n0.001 1 2 1\n0.002 3 4 0\n"])
def test_a_byte_order_mark_is_no_part_of_the_first_line(txt, tmp_path, content):
    for path in (txt("\ufeff" + content), archive(tmp_path / "b.zip", events_txt="\ufeff" + content)):
        assert_reads(path, {"t": [1000, 2000], "x": [1, 3], "y": [2, 4], "p": [1, 0]})


def test_what_names_say_of_unit_and_sensor(txt):
    path = txt("t_ns,x@240,y@180,on\n1000000,239,2,1\n", "a.csv")
    for told, found in (({}, ("ns", "file", 240, 180)),
                        ({"time_unit": "us", "sensor": (300, 200)}, ("us", "given", 300, 200))):  # fmt: skip
        with open_recording(path, **told) as one:
            assert (one.time_unit, one.time_unit_source, one.width, one.height) == found


@pytest.mark.parametrize("head", ["640,480\n", "640x480\n%x,y,p,t\n", "640,480\nx,y,p,timestamp_us\n"])
def test_the_head_of_metavision(txt, rng, head):
    events = make_events(rng, 20)
    rows = zip(events.x, events.y, events.p, events.t, strict=True)
    content = f"%geometry:{head}" + "".join(f"{x},{y},{p},{t}\n" for x, y, p, t in rows)
    recording = assert_reads(txt(content), events)
    assert (recording.width, recording.height) == (640, 480)


def test_csv_as_faery_writes_it(tmp_path, rng):
    events = make_events(rng)
    write_by_faery(tmp_path / "a.csv", events)
    recording = assert_reads(tmp_path / "a.csv", events)
    assert (recording.width, recording.height) == (240, 180)


@pytest.mark.parametrize("content, message", [
    ("t,x,y,p\n1,2,3\n", "line 2: 3 fields in '1,2,3'; 4 are needed (t x y p)"),
    ("a,x,y,t,p\n0,1,2,3\n", "line 2: 4 fields in '0,1,2,3'; 5 are needed (… x y t p)"),
    ("t,x,y,polarity,t\n0,1,2,33,4\n", "polarity of event 0 is 33"),
    ("when,x,y,p\n0,1,2,1\n", "line 1: t is 'when'; a number is needed"),
    ("t,x,y,p\nt,x,y,p\n1,2,3,1\n", "line 2: t is 't'; a number is needed"),
    ("t,x@0,y@180,p\n1,2,3,1\n", "line 1: sensor of 0×180 px"),
    ("t,x,y,p\n", "no events"),
])  # fmt: skip
def test_names_that_do_not_fit(txt, content, message):
    assert message in refusal(txt(content, "a.csv"), "either")


@given(st.lists(st.tuples(*[st.integers(0, 999)] * 6), min_size=1, max_size=9), st.permutations(range(6)))
@settings(max_examples=50, deadline=None)
def test_fast_and_slow_reader_agree_on_any_layout(rows, order):
    layout = Layout(*order[:4], fields=6)
    block = "".join(",".join(map(str, row)) + "\n" for row in rows).encode()
    expected = [tuple(row[k] for k in order[:4]) for row in rows]
    assert [parse_line(line, 0, layout) for line in block.splitlines()] == expected
    assert list(map(tuple, np.stack(parse_fast(block, 0, layout), axis=1).tolist())) == expected
