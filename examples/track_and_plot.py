"""Track an object and plot what was found beside what is true.

Needs torch: `make EXTRAS=reference`, or `pip install 'cmfpga[reference]'`.

A synthetic object moves to the right and down, and turns a corner after 0.25 s. The integer model of the hardware,
equal to the Verilog in every bit, tracks it batch by batch. For a recording of your own, give ``cmfpga.track`` its path
and an ROI, and leave the truth out.

    python examples/track_and_plot.py [PICTURE]
"""

import sys

import numpy as np

import cmfpga
from cmfpga.events import generate

scene = generate(
    seed=1,
    velocity=((250_000, 150.0, 100.0), (250_000, 120.0, -100.0)),  # µs, px/s, px/s
    position=(70.0, 90.0),
    duration_us=500_000,
    noise=0.05,
)
tracking = cmfpga.track(scene, engine="model", batch_events=1640)

true = scene.motion.velocity(tracking.t_ref_us)
found = np.stack([tracking.vx_px_per_s, tracking.vy_px_per_s], axis=1)
print("batch  true [px/s]      found [px/s]")
for batch, (t, f) in enumerate(zip(true, found, strict=True)):
    print(f"{batch:5}  {t[0]:6.0f} {t[1]:6.0f}   {f[0]:7.1f} {f[1]:7.1f}")

error = np.median(np.hypot(*(found - true).T))
print(f"median error: {error:.1f} px/s, of {np.hypot(*true[0]):.0f} px/s")
assert error < 0.2 * np.hypot(*true[0])

picture = sys.argv[1] if len(sys.argv) > 1 else "track_and_plot.png"
tracking.plot(picture)
print(f"wrote {picture}")
