"""Windows that overlap, over the bus of the simulated AXI top: each slice's result is that of the integer model."""

import pytest

from cmfpga.driver import Accelerator
from cmfpga.driver.simulation import SimulationBackend
from cmfpga.errors import ConfigError
from cmfpga.protocol.words import encode
from support.region_driving import CONFIG, TABLE, clouds, events_of, same
from support.regions import model_of, random_settings, random_window


def test_windows_that_overlap(compiler, rng):
    """The result of a slice is that of the last ones; after a reset, and after a stream, of fewer."""
    config = CONFIG.replace(slices=3)
    with Accelerator(SimulationBackend(config)) as made:
        limit = made.registers.by_name["BATCH_LIMIT"].fields[0].reset
        assert limit == config.slice_events == config.max_batch_events // 3
        made.write_regions(TABLE)
        chosen = random_settings(config, rng)
        for what in ("begin", "reset", "stream"):
            model = model_of(config)
            model.write(TABLE)
            for number in range(5):
                window = random_window(config, rng)
                result = made.run(events_of(window), settings=chosen)
                same(result, model.run(*window, chosen))
                assert result.batch == number + 1 and made.control.read("COUNT_EMPTY_ENDS")["VALUE"] == number
                made.control.write("CTRL", END_BATCH=1)  # of a slice without events, which takes no place in a window
            if what == "reset":
                made.start(settings=chosen, events=10)
                made.send(encode(events_of(clouds(rng, 20)), made.form))
                sizes = [result.events for result in made.results(2)]
                assert sizes[1] - sizes[0] < 10 and sizes[0] > 10  # two slices of ten, behind the last two
                made.stop()
            else:
                made.reset()
        with pytest.raises(ConfigError, match=f"at most {limit} are allowed"):
            made.run(events_of(clouds(rng, limit + 1)))
