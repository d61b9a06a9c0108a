"""``cmfpga generate``: write a synthetic recording with known motion."""

import json
from dataclasses import asdict, astuple
from types import SimpleNamespace

import numpy as np

from .. import cli
from ..config.checks import parse_camera
from ..errors import ConfigError
from ..events import Events, Hdf5Writer, generate, open_recording
from ..events.synthetic import TEXTURES
from ..imaging.camera import Camera, camera_fields
from ..waiting import waiting

#: Options of motions beyond translation, and the attributes of the file that tell them.
_TURNING = {"zoom": "zoom_per_s", "roll": "roll_rad_per_s", "rotation": "angular_velocity_rad_per_s"}

EXAMPLES = (
    "cmfpga generate scene.h5 --velocity 120,-40",
    "cmfpga generate noisy.h5 --texture dense --noise 0.3 --hot-pixels 5 --seed 7",
    "cmfpga generate lens.h5 --camera 200,200,120,90,-0.35,0.12,0,0,0    # then track --camera lens.h5",
    "cmfpga generate turn.h5 --rotation 0.3,-0.6,0.2 --camera 200,200,120,90 --bars 40    # the camera turns",
    "cmfpga generate long.h5 --velocity 100,0 --there-and-back --repeat 100   # 50 s in pieces",
    "cmfpga generate two.h5 --seed 2 --position 60,60 --velocity 0,90 --over scene.h5    # a second object",
)


_two = cli.numbers(float, 2, "two numbers, as in 120,-40, are")
_three = cli.numbers(float, 3, "three numbers, as in 0,0.6,-0.1, are")
_number = cli.number(float, "a number is")


def parser():
    """Parser of the arguments of ``cmfpga generate``."""
    made = cli.parser("cmfpga generate", "Write a synthetic recording whose motion is known, as HDF5.", EXAMPLES)
    cli.files(made.add_argument("out", metavar="FILE", help="file to write (.h5); one that exists is replaced"))
    made.add_argument("--seed", type=cli.natural, default=0, metavar="S", help="equal seeds, equal events (default: 0)")
    text = "sensor size, px (default: 240,180)"
    made.add_argument("--sensor", type=cli.pair("W,H"), default=(240, 180), metavar="W,H", help=text)
    made.add_argument("--texture", choices=TEXTURES, default="lines", help="lines: thin bars; dense: a random pattern")
    text = "size of the object, px (default: 40,40; with --rotation one and a half times the sensor's)"
    made.add_argument("--size", type=cli.pair("W,H"), metavar="W,H", help=text)
    text = "centre of the object at the start, px (default: the middle)"
    made.add_argument("--position", type=_two, metavar="X,Y", help=text)
    made.add_argument("--velocity", type=_two, metavar="VX,VY", help="px/s (default: 100,0)")
    made.add_argument("--zoom", type=_number, default=0.0, metavar="Z", help="growth of the object, 1/s (default: 0)")
    text = "turn of the object, rad/s, clockwise (default: 0)"
    made.add_argument("--roll", type=_number, default=0.0, metavar="R", help=text)
    made.add_argument(
        "--rotation", type=_three, metavar="WX,WY,WZ",
        help="the camera turns, rad/s about x (right), y (down), z (forward), in front of what is far away; needs "
        "--camera, and excludes all other motion",
    )  # fmt: skip
    made.add_argument("--bars", type=cli.positive, metavar="N", help="bars of the texture lines (default: by the size)")
    text = "length, µs (default: 500000)"
    made.add_argument("--duration-us", type=cli.positive, default=500_000, metavar="D", help=text)
    made.add_argument("--there-and-back", action="store_true", help="turn round after half of the length")
    text = "events per edge point and pixel moved"
    made.add_argument("--contrast", type=_number, default=1.0, metavar="C", help=text)
    made.add_argument("--noise", type=_number, default=0.0, metavar="F", help="noise, as a fraction of all events")
    made.add_argument("--hot-pixels", type=cli.natural, default=0, metavar="N", help="pixels that emit by themselves")
    made.add_argument("--hot-rate", type=_number, default=1000.0, metavar="R", help="of each of them, events/s")
    cli.files(made.add_argument(
        "--camera", metavar="FILE",
        help="distort the image as this camera does (a file or numbers, as for track), and write its calibration; "
        "position and velocity are those of the undistorted image",
    ))  # fmt: skip
    text = "the scene K times, one after the other, written in pieces (default: 1)"
    made.add_argument("--repeat", type=cli.positive, default=1, metavar="K", help=text)
    cli.files(made.add_argument(
        "--over", metavar="RECORDING",
        help="add the events of this recording, of a sensor of the same size: several objects, and no true motion in "
        "the file",
    ))  # fmt: skip
    made.add_argument("--json", action="store_true", help="print what was written as JSON")
    return made


def main(arguments=None):
    """Run the command; returns the exit status."""
    options = parser().parse_args(arguments)
    if not options.out.lower().endswith((".h5", ".hdf5")):
        raise ConfigError(f"{options.out}: only HDF5 is written; a name that ends with .h5 is needed")
    width, height = options.sensor
    velocity, size = options.velocity or (100.0, 0.0), options.size or (40, 40)
    if options.rotation:
        if options.velocity or options.there_and_back or options.zoom or options.roll:
            raise ConfigError("--rotation: nothing but the camera moves; --velocity, --zoom … go without it")
        velocity, size = (0.0, 0.0), options.size or (width * 3 // 2, height * 3 // 2)
    if options.there_and_back:
        half = options.duration_us // 2
        velocity = ((half, *velocity), (options.duration_us - half, *(-axis for axis in velocity)))
    camera = None
    if options.camera is not None:
        fields = camera_fields(options.camera, SimpleNamespace(width=width, height=height))
        camera = Camera(*parse_camera(fields["camera"]))
    with waiting("Making the events"):
        scene = generate(
            seed=options.seed, width=width, height=height, texture=options.texture, size=size, bars=options.bars,
            position=options.position, velocity=velocity, duration_us=options.duration_us, contrast=options.contrast,
            noise=options.noise, hot_pixels=options.hot_pixels, hot_rate=options.hot_rate,
            camera=camera, zoom=options.zoom, roll=options.roll, rotation=options.rotation,
        )  # fmt: skip
    events, motion = scene.events, scene.motion
    if not len(events):
        raise ConfigError(f"{options.out}: no events to write; the object does not move, or not on the sensor")
    if options.over is not None:
        events = Events.merge([_others(options), events])
    # The motion as it is stored: begin of each piece in µs, and its velocity.
    times = np.concatenate([motion.times + k * options.duration_us for k in range(options.repeat)])
    velocities = np.tile(motion.velocities, (options.repeat, 1))
    turning = {told: getattr(options, name) for name, told in _TURNING.items() if getattr(options, name)}
    with Hdf5Writer(options.out, width, height) as writer:
        writer.attributes(source="synthetic: cmfpga generate", seed=options.seed, texture=options.texture)
        if camera:
            writer.calibration(astuple(camera))
        writer.attributes(**turning)
        if not options.rotation and options.over is None:
            writer.ground_truth(times, velocities, motion.position(0))
        with waiting("Writing the scenes", total=options.repeat) as bar:
            for k in range(options.repeat):
                writer.write(Events(events.t + k * options.duration_us, events.x, events.y, events.p))
                bar.update()
    count, duration = len(events) * options.repeat, options.duration_us * options.repeat
    if options.over is not None:
        duration = max(duration, int(events.t[-1]) + 1)
    if options.json:
        summary = {
            "file": options.out,
            "events": count,
            "duration_us": duration,
            "sensor": [width, height],
            "velocity_px_per_s": [[int(t), *v] for t, v in zip(motion.times, motion.velocities.tolist(), strict=True)],
            **turning,
            "start_px": motion.position(0).tolist(),
            **({"camera": asdict(camera)} if camera else {}),
        }
        print(json.dumps(summary, indent=2))
    else:
        print(f"wrote {options.out}: {count:,} events in {duration / 1e6:g} s")
    return 0


def _others(options):
    if options.repeat > 1:
        raise ConfigError("--over: it goes without --repeat")
    with open_recording(options.over) as recording:
        size = recording.width, recording.height
        if size != options.sensor:
            told = "no size" if None in size else "{}×{} px".format(*size)
            raise ConfigError(
                f"--over {options.over}: a sensor of {told}; {'×'.join(map(str, options.sensor))} is needed"
            )
        return Events.concatenate(recording.chunks())
