"""What ``track`` prints of its batches; consumers, as :mod:`cmfpga.tracking.loop` takes them."""

import json


class Truth(list):
    """Lines that show the true motion beside the found one, batch by batch; a consumer."""

    def __init__(self, motion):
        super().__init__(["batch   true vx, vy [px/s]      found vx, vy [px/s]"])
        self._motion = motion

    def add(self, batch):
        speed = batch.v_px_per_s
        if speed is None:
            self.append(f"{batch.index:5}   (degenerate)")
            return
        true = batch.true_px_per_s(self._motion)
        self.append(f"{batch.index:5}   {true[0]:8.1f} {true[1]:8.1f}       {speed[0]:8.1f} {speed[1]:8.1f}")


class Lines:
    """Prints a line for each batch of a stream as it is found; a consumer."""

    def __init__(self, as_json):
        self._as_json = as_json

    def add(self, batch):
        if self._as_json:
            print(json.dumps(batch.values), flush=True)
            return
        (x, y), speed = batch.result.roi_next, batch.v_px_per_s
        at = "" if batch.t_ref is None else f"{batch.t_ref / 1e6:.6f} s"
        found = "no motion" if speed is None else f"{speed[0]:8.1f} {speed[1]:8.1f} px/s"
        print(f"{batch.index:5}  {at}  {found:>22}  next ROI {x},{y}  {batch.flags.text}".rstrip(), flush=True)
