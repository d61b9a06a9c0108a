"""What goes wrong, on the emitted AXI top in Verilator: said in one line, and afterwards all works again."""

import pytest

from cmfpga.driver import DeviceError, DeviceTimeout
from cmfpga.events import Events
from cmfpga.protocol.words import encode
from support.driving import BEATS, batch, within, works


@pytest.mark.parametrize("sent", [0, 1, 37, 99])
def test_words_that_stop_in_the_middle_of_a_batch(accelerator, top, rng, sent):
    top.limit(send=sent)
    with within(5), pytest.raises(DeviceTimeout, match=rf"(?s)no result within 0\.1 s .*: {sent} words taken") as error:
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    assert "\n" not in str(error.value) and accelerator.timeout == 10
    top.limit()
    assert accelerator.run(Events.empty()).v == (0, 0) and accelerator.engine.places == [(0, 0)]
    works(accelerator, rng)


def test_interrupt_that_never_comes(accelerator, backend, rng, monkeypatch):
    """The result is there, but the line is dead: said so; without the interrupt all works."""

    def dead(timeout):
        backend.top.run(20_000)
        return False

    monkeypatch.setattr(backend, "wait_interrupt", dead)
    message = r"the result came, but no interrupt within 0\.1 s; interrupt=False"
    with within(5), pytest.raises(DeviceTimeout, match=message):
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    accelerator.interrupt = False
    accelerator.reset()
    works(accelerator, rng)


def test_interrupts_that_nobody_asked_for(accelerator, backend, rng, monkeypatch):
    usual, woken = backend.wait_interrupt, []

    def early(timeout):
        woken.append(timeout)
        return True if len(woken) % 3 else usual(timeout)

    monkeypatch.setattr(backend, "wait_interrupt", early)
    works(accelerator, rng)
    assert len(woken) >= 6


def test_reset_in_between(accelerator, top, rng):
    """Of the software in the middle of a batch, and of the hardware behind the driver's back."""
    accelerator.start(roi=(8, 4), events=100)
    accelerator.send(encode(batch(rng, 250), "PACKED"))
    top.run(180)
    accelerator.reset()
    works(accelerator, rng)
    top.reset()
    with within(5), pytest.raises(DeviceError):
        accelerator.run(batch(rng, 100), timeout=0.1)
    works(accelerator, rng)


def test_somebody_else_sends_words(accelerator, top, rng):
    works(accelerator, rng)
    top.send(encode(batch(rng, 5), "PACKED"))
    top.run(100)
    with pytest.raises(DeviceError, match="something else sends"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    works(accelerator, rng)


def test_packets_of_another_length_and_lost_results(accelerator, backend, rng, monkeypatch):
    usual = backend.receive
    monkeypatch.setattr(backend, "receive", lambda timeout: usual(timeout)[:9])
    with pytest.raises(DeviceError, match=f"a packet of 9 words; {BEATS} make a result"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    monkeypatch.undo()
    works(accelerator, rng)
    accelerator.start(events=30)
    accelerator.send(encode(batch(rng, 90), "PACKED"))
    usual(1)
    with pytest.raises(DeviceError, match="batch 4 came, not of 3"):
        next(accelerator.results(1))
    accelerator.stop()


def test_words_that_get_lost(accelerator, backend, rng, monkeypatch):
    usual = backend.send
    monkeypatch.setattr(backend, "send", lambda words: usual(words[3:]))
    with pytest.raises(DeviceError, match="the result is of 97 events; 100 were sent"):
        accelerator.run(batch(rng, 100), roi=(8, 4))
    monkeypatch.undo()
    works(accelerator, rng)


def test_input_that_does_not_change(accelerator, backend, rng):
    backend.override("STATUS", INPUT_PENDING=1)
    message = r"the kind of input does not change within 0\.1 s: 0 words taken"
    with within(5), pytest.raises(DeviceTimeout, match=message):
        accelerator.run(batch(rng, 100), roi=(8, 4), timeout=0.1)
    backend.overrides.clear()
    works(accelerator, rng)


def test_registers_that_do_not_answer(accelerator, top):
    top._call("axi_reset", 0)  # then held in reset: nothing answers
    top.read32 = lambda offset: (_ for _ in ()).throw(DeviceTimeout("no answer"))
    with pytest.raises(DeviceTimeout):
        accelerator.counters()
    accelerator.close()  # says nothing, and does not hang
    accelerator.close()
    with pytest.raises(ValueError, match="closed"):
        top.run(1)
