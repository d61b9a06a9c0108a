"""The driver at the end of a serial line: the emitted Verilog of the serial top, as a board would be."""

import dataclasses
import itertools
import os
import pty
import sys

import numpy as np
import pytest

from cmfpga.cli import driver as command_line
from cmfpga.cli import track
from cmfpga.driver import Accelerator, DeviceError, DeviceTimeout
from cmfpga.driver.uart import SerialLine, UartBackend
from cmfpga.engines.model import ModelEngine
from cmfpga.events import write_hdf5
from cmfpga.protocol import link
from cmfpga.protocol.registers import formats_of
from cmfpga.protocol.settings import BatchSettings
from cmfpga.protocol.words import encode
from support import region_driving
from support.designs import SHELL_SIZES as SMALL
from support.driving import CONFIG, batch, differences, model_run, works
from support.genx320 import levels, to_bytes
from support.regions import model_of
from support.serial_line import SimulatedLine
from support.small_core import sets


@pytest.fixture
def line(compiler):
    made = SimulatedLine(CONFIG)
    yield made
    made.close()


@pytest.fixture
def accelerator(line):
    return Accelerator(UartBackend(line), CONFIG)


@pytest.mark.parametrize("form", formats_of(CONFIG))
def test_batches_equal_the_model(line, rng, form):
    accelerator = Accelerator(UartBackend(line), CONFIG, form=form)
    assert [result.batch for result in works(accelerator, rng, (2, 300, 1, 77))] == [1, 2, 3, 4]
    assert not any(accelerator.backend.counters().values())


def test_many_regions(compiler, rng):
    line, model = SimulatedLine(region_driving.CONFIG), model_of(region_driving.CONFIG)
    accelerator = Accelerator(UartBackend(line), region_driving.CONFIG)
    chosen = BatchSettings.from_config(region_driving.CONFIG)
    for table in (region_driving.TABLE, region_driving.TABLE[:1]):
        accelerator.write_regions(table), model.write(table)
        for _ in range(2):
            window = region_driving.clouds(rng)
            result = accelerator.run(region_driving.events_of(window), settings=chosen)
            region_driving.same(result, model.run(*window, chosen))
            assert len(result.regions) == len(table)
    assert not any(accelerator.backend.counters().values())
    line.close()


def test_words_are_of_four_bytes(accelerator, line, rng):
    """EVT 2.0, and little around them."""
    sent, write = [], line.write
    line.write = lambda content: (sent.append(len(content)), write(content))
    events = batch(rng, 1000)
    accelerator.run(events, roi=(8, 4))
    words = 2 * len(encode(events, "EVT20"))
    assert accelerator.form == "EVT20" and max(sent) < 4 * link.FRAME_WORDS * 1.1
    assert 4 * words < sum(size for size in sent if size > 100) < 4.2 * words + 100


def test_a_line_that_damages_what_it_carries(accelerator, line, rng):
    """Every seventh frame to the board has a wrong bit: it comes again, and results are the same."""
    model, numbers, write = ModelEngine(CONFIG), itertools.count(1), line.write

    def damage(content):
        content = bytearray(content)
        if next(numbers) % 7 == 0:
            content[len(content) // 2] ^= 0x08
        write(content)

    line.write = damage
    for k in range(2):
        events = batch(rng, 400, begin=1000 * k)
        assert differences(accelerator.run(events, roi=(8, 4)), model_run(model, events, (8, 4))) == []
    line.write = write
    count = accelerator.backend.counters()
    assert count["bad_frames"] >= 2 and count["repeats"] == count["overruns"] == 0


def test_replies_that_are_lost_do_nothing_twice(accelerator, line, rng):
    """Every ninth piece that comes is lost: the request comes again, and is answered without being carried out."""
    numbers, read = itertools.count(1), line.read

    def lose(timeout):
        content = read(timeout)
        return b"" if content and next(numbers) % 9 == 0 and len(content) < 30 else content

    line.read = lose
    events = batch(rng, 300)
    result = accelerator.run(events, roi=(8, 4))
    line.read = read
    assert differences(result, model_run(ModelEngine(CONFIG), events, (8, 4))) == []
    count = accelerator.counters()
    assert (count["events_in"], count["batches"]) == (300, 1) and accelerator.backend.counters()["repeats"] >= 1


def test_a_board_whose_buffer_is_full(accelerator, rng):
    """Words that the core does not take: the board refuses them, and a reset forgets them."""
    backend = accelerator.backend
    backend.send(encode(batch(rng, 3000), "EVT20"))
    with pytest.raises(DeviceTimeout, match=r"^simulated board: \d+ frames were not taken within 0\.2 s$"):
        backend.wait_sent(0.2)
    with pytest.raises(DeviceError, match="were not sent yet"):
        backend.send(np.zeros(1, np.uint64))
    assert backend.counters()["busy"] >= 1
    accelerator.reset()
    found = accelerator.self_test()
    assert found["counters"] == "1200 events in, 1 result" and found["interrupt"] == "not used"
    assert found["golden batch"].endswith("as the integer model")


def test_events_of_the_sensors_port(accelerator, line, rng):
    """The other source: what a GenX320's pins show, on its own clock, becomes the same batches."""
    events, model = batch(rng, 900), ModelEngine(CONFIG)
    words = encode(events, "EVT20").view("<u4")
    line.play(levels(to_bytes(words)))  # paused
    accelerator.backend.select("cpi", big_endian=True, vsync_low=True)
    accelerator.start(roi=(8, 4), events=300, form="EVT20")
    line.play(levels(to_bytes(words, big_endian=True), low=(False, True), gaps=rng, packet=320, packets=4))
    for k, result in enumerate(accelerator.results(3)):
        part = dataclasses.replace(events, **{n: getattr(events, n)[300 * k : 300 * k + 300] for n in "txyp"})
        assert differences(result, model_run(model, part, (8, 4) if k == 0 else None)) == []
    accelerator.stop()
    count = accelerator.backend.counters()
    assert (count["cpi_words"], count["cpi_skipped"], count["cpi_overflow"]) == (len(words), len(words), 0)
    assert count["cpi_padding"] > 0
    accelerator.backend.select("uart")
    accelerator.reset()
    assert accelerator.self_test()


def test_a_recording_is_tracked(command, compiler, monkeypatch, rng, rows, tmp_path):
    """By the command, batch after batch; the same as by the integer model."""
    monkeypatch.setattr("cmfpga.driver.uart.SerialLine", lambda port: SimulatedLine(CONFIG))
    write_hdf5(tmp_path / "rec.h5", batch(rng, 900), CONFIG.sensor_width, CONFIG.sensor_height)
    size, found = sets({name: SMALL[name] for name in SMALL if not name.startswith("sensor")}), []
    for engine in ("serial:/dev/ttyUSB0", "model"):
        options = ("--roi", "8,4", "--batch-events", 300, "--engine", engine, "--out", tmp_path / engine[:5])
        assert command(track, tmp_path / "rec.h5", *size, *options).status == 0
        found.append([{**row, "cycles": None} for row in rows(tmp_path / engine[:5])])
    assert found[0] == found[1] and len(found[0]) == 3


def test_nobody_answers(command):
    """A pseudo-terminal that nobody reads."""
    pytest.importorskip("serial", reason="needs pyserial")
    master, slave = pty.openpty()
    try:
        done = command(command_line, "--backend", "serial", "--port", os.ttyname(slave))
    finally:
        os.close(master)
        os.close(slave)
    assert done.status == 2 and not done.out
    assert "no reply to 4 requests at 3000000 baud: is the bitstream loaded?" in done.error


@pytest.mark.parametrize("name", ["track", "driver"])
def test_a_bad_port(command, name, dot, small, tmp_path):
    pytest.importorskip("serial", reason="needs pyserial")
    port = tmp_path / "ttyNONE"
    if name == "driver":
        done = command(command_line, "--backend", "serial", "--port", port)
    else:
        done = command(track, dot, *small, "--roi", "8,4", "--engine", f"serial:{port}", "--out", tmp_path / "out")
    assert done.status == 2 and f"serial port {port}: " in done.error and "No such file" in done.error


def test_a_port_has_one_owner():
    pytest.importorskip("serial", reason="needs pyserial")
    master, slave = pty.openpty()
    line = SerialLine(os.ttyname(slave))
    with pytest.raises(DeviceError, match=r"^serial port /dev/pts/\d+: .*exclusively lock") as caught:
        SerialLine(os.ttyname(slave))
    assert "\n" not in str(caught.value)
    line.close(), os.close(master), os.close(slave)


def test_without_pyserial(monkeypatch):
    monkeypatch.setitem(sys.modules, "serial", None)
    message = r"^serial port /dev/x: serial is not installed; pip install 'cmfpga\[serial\]'$"
    with pytest.raises(ValueError, match=message):
        SerialLine("/dev/x")


@pytest.mark.parametrize("options", [("--backend", "serial"), ("--port", "x"), ("--baud", "9600")])
def test_options_that_belong_together(command, options):
    assert command(command_line, *options).error.startswith("--backend serial needs --port")


def test_a_serial_port_that_echoes():
    """Requests come back as they are: no reply, and no board."""
    pytest.importorskip("serial", reason="needs pyserial")
    with pytest.raises(DeviceTimeout, match="damaged frames came from it"):
        UartBackend(SerialLine("loop://"))
