"""How few fraction bits do votes and their derivatives need? A study of word widths with ``sweep``.

Needs torch and the packages of sweep: `make EXTRAS=reference,sweep`, or `pip install 'cmfpga[reference,sweep]'`.

Two synthetic recordings whose motion is known are tracked by the integer model, with each pair of widths. The tables
say how far the velocity found is from the truth, and how wide a word of the image memory is. With more recordings,
``--workers`` runs the same on all processors.

    python examples/word_widths.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import pandas

from cmfpga.cli import sweep
from cmfpga.config import preset
from cmfpga.events import generate, write_hdf5

WIDTHS = (1, 2, 4, 8)

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
recordings = []
for seed, (vx, vy) in enumerate([(180.0, 60.0), (-120.0, 140.0)], 1):
    scene = generate(seed=seed, velocity=(vx, vy), duration_us=250_000, noise=0.2, contrast=2.0)
    path = folder / f"scene{seed}.h5"
    write_hdf5(path, scene.events, 240, 180)
    # The truth, where `sweep` looks for it: one line per piece of constant velocity.
    Path(f"{path}.truth.csv").write_text(f"t_us,vx_px_per_s,vy_px_per_s\n0,{vx},{vy}\n")
    x, y = scene.roi_start(64, 64)
    recordings.append(f"{path}@{x},{y}")

bits = ",".join(map(str, WIDTHS))
status = sweep.main(
    [*recordings, "--vary", f"weight_frac={bits}", "--vary", f"derivative_frac={bits}", "--engine", "model",
     "--batch-events", "3000", "--workers", "0", "--out", str(folder)]
)  # fmt: skip
assert status == 0

print("\nMedian error [px/half batch]; rows: fraction bits of a vote, columns: of its derivative")
batches = pandas.read_parquet(folder / "batches.parquet")
batches = batches.rename(columns={"config.weight_frac": "vote", "config.derivative_frac": "derivative"})
errors = batches.pivot_table("error_px", "vote", "derivative", aggfunc="median")
print(errors.round(3).to_string())

print("\nWord of the image memory [bits]")
words = errors.copy()
for vote in WIDTHS:
    for derivative in WIDTHS:
        config = preset("fast").replace(weight_frac=vote, derivative_frac=derivative)
        words.loc[vote, derivative] = (
            config.tag_bits + config.widths.image_bits + 2 * config.widths.derivative_image_bits
        )
print(words.astype(int).to_string())

assert errors.loc[4, 4] < errors.loc[8, 8] + 0.1, "the four bits of the preset `fast` do as well as eight"
