"""``cmfpga info``: what a recording holds, and an ROI and batches that suit it."""

import contextlib
import itertools
import json
import math
import shlex
import statistics
from dataclasses import asdict

import numpy as np
from tqdm import tqdm

from .. import cli
from ..engines import make_engine
from ..errors import ConfigError, needs
from ..events import BatchCutter, open_recording
from ..imaging.camera import extent
from ..imaging.survey import propose, survey_all
from ..imaging.survey.statistics import pixels_text, shown
from ..protocol.settings import BatchSettings
from ..reference.integer.filters import NoiseFilter
from ..show.gallery import draw_survey, survey_lines
from ..tracking.loop import track
from ..tracking.source import likely_sensor, own_calibration
from ..waiting import waiting

EXAMPLES = (
    "cmfpga info rec.h5",
    "cmfpga info rec.raw --objects 3 --json",
    "cmfpga info rec.h5 --check 10           # and whether the proposal keeps what it promises",
    "cmfpga info events.txt --sensor 240,180 --png frame.png --no-frame",
    "cmfpga info rec.h5 --preset fast --set roi_width=48 --set roi_height=48",
)

_BARS = " ▁▂▃▄▅▆▇█"
_NOISE_EVENTS = 1_000_000  # of which noise_shares are measured


def parser():
    """Parser of the arguments of ``cmfpga info``."""
    made = cli.parser("cmfpga info", "Say what a recording holds, and propose an ROI and batches for it.", EXAMPLES)
    cli.files(made.add_argument("recording", metavar="RECORDING", help="a file of any known format"))
    text = "propose for event K on (default: for the begin, or else the first place where something moves clearly)"
    made.add_argument("--start-event", type=cli.natural, metavar="K", help=text)
    made.add_argument("--objects", type=cli.few, default=1, metavar="N", help="propose up to N ROIs (default: 1)")
    made.add_argument("--no-proposal", action="store_true", help="only say what the recording holds")
    text = "track B batches of each proposal by the integer model (needs torch), and say how far the image moved"
    made.add_argument("--check", type=cli.positive, metavar="B", help=text)
    made.add_argument("--no-frame", action="store_true", help="do not show the events in the terminal")
    cli.files(made.add_argument("--png", metavar="FILE", help="write a picture of the events and the ROIs to FILE"))
    cli.add_reading_options(made)
    made.add_argument("--json", action="store_true", help="print all of it as JSON")
    cli.add_config_options(made)
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    with cli.noted(open_recording(options.recording, **cli.reading(options))) as recording:
        survey, broken = survey_all(recording)
        if broken is not None and not survey.events:  # otherwise what came before is worth knowing
            raise broken
        config = _config(options, recording, survey)
        proposals = []
        if not options.no_proposal:
            with tqdm(unit="place", desc="motion", disable=None, leave=False) as bar:
                proposals = propose(
                    recording, survey, config, count=options.objects, start_event=options.start_event, tick=bar.update
                )
        camera = camera_of(options.recording)
        with waiting("Looking for noise"):
            noise = noise_shares(recording, survey, config, proposals)
        told = tqdm(proposals if options.check else [], unit="place", desc="check", disable=None, leave=False)
        checked = [_check(recording, config, found, options.check) for found in told]
        if options.png is not None:
            draw_survey(options.png, survey, config, proposals)
    found = options, recording, survey, config, proposals, checked, noise, camera
    if options.json:
        print(json.dumps(_report(*found), indent=2, ensure_ascii=False))
    else:
        print("\n".join(_text(*found)))
    if broken is not None:
        raise broken
    return 0


def _config(options, recording, survey):
    """The configuration that the options ask for, on the recording's sensor, or on one that holds its events."""
    rows, columns = survey.counts.shape
    usual = cli.make_config(options)
    size = recording.width, recording.height
    if recording.width is None:
        size = likely_sensor((columns, rows), (usual.sensor_width, usual.sensor_height))
    return cli.make_config(options, **{
        "sensor_width": max(size[0], usual.roi_width), "sensor_height": max(size[1], usual.roi_height),
        **cli.config_changes(options),
    })  # fmt: skip


def _check(recording, config, proposal, batches):
    """How far the image moves in half of each of so many batches at most, px, and whether that is trusted: two lists.

    As the integer model tracks them; needs torch.
    """
    with needs("torch", "reference", "--check"):
        engine = make_engine("model", config.replace(**proposal.fields))
    with contextlib.closing(engine):
        size = {"events": proposal.batch_events, "max_events": engine.config.max_batch_events}
        cutter = BatchCutter(recording, start_event=proposal.start_event, **size)
        tracked = [*track(engine, cutter, roi=proposal.roi, batches=batches)]
    found = [batch for batch in tracked if batch.v_px_per_s is not None]
    px = [extent(engine.config, batch.result.v, batch.result.roi) for batch in found]
    return px, [batch.trusted for batch in found]


def _command(options, proposal, recording, config):
    words = ["cmfpga", "track", options.recording, "--roi", "{},{}".format(*proposal.roi)]
    words += ["--batch-events", str(proposal.batch_events)]
    if proposal.start_event:
        words += ["--start-event", str(proposal.start_event)]
    for name, value in proposal.fields.items():
        words += ["--set", f"{name}={value}"]
    for name, option in cli.READING.items():
        if (value := getattr(options, name)) is not None:
            words += [option, value if isinstance(value, str) else "{},{}".format(*value)]
    if recording.width is None and "sensor_width" not in cli.config_changes(options):
        words += ["--sensor", f"{config.sensor_width},{config.sensor_height}"]
    words += ["--preset", options.preset, *(word for text in options.assignments for word in ("--set", text))]
    return shlex.join(words)


def camera_of(path):
    """The calibration that an HDF5 file holds, JSON-ready, or why it cannot be read; None without one."""
    try:
        found = own_calibration(path)
    except ConfigError as error:
        return {"error": str(error)}
    return found and {"text": str(found.camera), **asdict(found.camera)}


def noise_shares(recording, survey, config, proposals):
    """What the filters in front of the ROI would drop of the recording's first events, and the options that say so.

    ``{options of track: share}``, empty where neither filter has a reason. Background activity: what no other pixel of
    the cell supports in the time in which the image of the first proposal moves by a cell.
    """
    hot, found, fields = survey.hot_pixels(), {}, {}
    if hot:
        fields = {"hot_pixels": 1, "hot_mask": pixels_text(hot)}
        found["--hot-pixels auto"] = sum(events for *_, events in hot) / survey.events
    speed = math.hypot(*proposals[0].px_per_s) if proposals else 0
    if speed:
        cell_us = (1 << config.background_cell) / speed * 1e6
        unit = 10 ** math.floor(math.log10(cell_us))
        period = min(round(cell_us / unit) * unit, config.widths.background_us_max)
        filtering = config.replace(background=1, background_us=period, **fields)
        model, settings, dropped, seen = NoiseFilter(filtering), BatchSettings.from_config(filtering), 0, 0
        for chunk in recording.chunks():
            dropped += int(model.judge(chunk.t, chunk.x, chunk.y, settings)[1].sum())
            seen += len(chunk)
            if seen >= min(_NOISE_EVENTS, survey.events):
                break
        found[f"--background-us {period}"] = dropped / seen
    return found


def _report(options, recording, survey, config, proposals, checked, noise, camera):
    bin_us, rate = survey.rate()
    return {
        "file": options.recording,
        "format": recording.format,
        "sensor": None if recording.width is None else [recording.width, recording.height],
        "covered": [survey.counts.shape[1], survey.counts.shape[0]],
        "time_unit": recording.time_unit,
        "time_unit_source": recording.time_unit_source,
        "events": survey.events,
        "on_events": survey.on_events,
        "t_first_us": survey.t_first,
        "t_last_us": survey.t_last,
        "rate_bin_us": bin_us,
        "rate_per_s": [round(value, 3) for value in rate.tolist()],
        "hot_pixels": [{"x": x, "y": y, "events": events} for x, y, events in survey.hot_pixels()],
        **({"camera": camera} if camera else {}),
        "noise": [{"options": name, "share": round(share, 4)} for name, share in noise.items()],
        "roi_size": [config.roi_width, config.roi_height],
        "proposals": [
            {
                **asdict(found),
                "px_per_half_batch": found.px,
                "reason": found.reason,
                "command": _command(options, found, recording, config),
                **dict(zip(("checked_px_per_half_batch", "checked_trusted"), tracked, strict=False)),
            }
            for found, tracked in itertools.zip_longest(proposals, checked, fillvalue=())
        ],
    }


def _text(options, recording, survey, config, proposals, checked, noise, camera):
    rows, columns = survey.counts.shape
    sensor = f"{recording.width}×{recording.height} px"
    if recording.width is None:
        taken = f"taking {config.sensor_width}×{config.sensor_height} px; say it with --sensor W,H"
        sensor = f"not said; the events cover {columns}×{rows} px: {taken}"
    source = {"given": "given", "file": "the format or the file says so", "assumed": "guessed"}
    span = survey.span_us / 1e6
    yield f"{options.recording}: {recording.format}"
    yield f"sensor      {sensor}"
    yield f"events      {survey.events:,}, {survey.on_events / survey.events:.0%} of them ON"
    yield f"span        {span:.6g} s, from {survey.t_first:,} µs to {survey.t_last:,} µs"
    yield f"time unit   {recording.time_unit} ({source[recording.time_unit_source]})"
    bin_us, rate = survey.rate()
    if span:
        yield f"rate        {survey.events / span:,.0f} events/s on average; each sign is {bin_us / 1e3:,.6g} ms:"
        top = rate.max()
        yield "            " + "".join(_BARS[int(np.ceil(value / top * 8))] for value in rate) + f"  0 to {top:,.0f}"
    if camera:
        yield f"camera      {camera.get('text') or camera['error']}"
    hot = survey.hot_pixels()
    yield f"hot pixels  {shown(hot) if hot else 'none'}"
    for k, (name, share) in enumerate(noise.items()):
        yield f"{'' if k else 'noise':12}{name} drops {share:.1%} of the events{' more' if k else ''}"
    if not options.no_frame:
        yield ""
        yield from survey_lines(survey, config, proposals)
    if options.no_proposal:
        return
    yield ""
    if not proposals:
        yield f"No proposal: nothing moves clearly and far enough in any {config.roi_width}×{config.roi_height} px."
        return
    for k, found in enumerate(proposals):
        name = "Proposal" if options.objects == 1 else f"Proposal {k}"
        yield (
            f"{name}: ROI {found.roi[0]},{found.roi[1]} of {config.roi_width}×{config.roi_height} px from event "
            f"{found.start_event:,} on, {found.batch_events:,} events a batch"
        )
        yield f"  because {found.reason}."
        vx, vy = found.px_per_s
        yield (
            f"  Velocity there: {vx:,.0f}, {vy:,.0f} px/s; contrast {found.gain:.2f} times that "
            f"at rest; {found.roi_events:,} of a batch's events in the ROI."
        )
        if "thinning" in found.fields:
            one = f"one in {found.fields['thinning']} is taken, evenly (thinning)"
            yield f"  The buffer holds {config.buffer_events:,}, so {one}."
        if "max_batch_events" in found.fields:
            yield "  The hardware has to count further than by default (max_batch_events)."
        px, trusted = checked[k] if checked else ((), ())
        if px:
            yield (
                f"  Checked: in {len(px)} batches the integer model found {statistics.median(px):.1f} px per half "
                f"batch (median; {min(px):.1f} to {max(px):.1f}); {sum(trusted)} are to be trusted."
            )
        yield f"  {_command(options, found, recording, config)}"
    if len(proposals) < options.objects:
        yield f"Only {len(proposals)} of {options.objects} objects move clearly at one time."
