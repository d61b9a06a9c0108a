"""Sends a recording by TCP as a camera would: each event at its time, as EVT 2.0, to whoever connects first.

Needs no extra.

    python examples/send_at_its_own_speed.py rec.h5 5000 &
    cmfpga track tcp://127.0.0.1:5000 --roi 100,30 --batch-events 4000 --out live
"""

import socket
import sys
import time

import numpy as np

from cmfpga.events import open_recording
from cmfpga.protocol.words import encode_evt20

STEP_US = 1000  # of the recording; so much is sent at once


def main(path, port):
    """Listen, send once, and say how long it took."""
    with open_recording(path) as recording, socket.create_server(("127.0.0.1", int(port))) as server:
        chunks = [*recording.chunks()]
        t, x, y, p = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txyp")
        ends = np.searchsorted(t, np.arange(t[0], t[-1] + STEP_US, STEP_US) + STEP_US)
        print(f"listening at tcp://127.0.0.1:{server.getsockname()[1]}", flush=True)
        connection, _ = server.accept()
        begin = time.monotonic()
        with connection:
            connection.sendall(f"% evt 2.0\n% geometry {recording.width}x{recording.height}\n% end\n".encode())
            for k, (first, end) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
                time.sleep(max(0.0, begin + (k + 1) * STEP_US * 1e-6 - time.monotonic()))
                part = slice(first, end)
                connection.sendall(encode_evt20(t[part], x[part], y[part], p[part]).astype("<u8").tobytes())
    took = time.monotonic() - begin
    print(f"{len(t)} events of {(t[-1] - t[0]) / 1e6:.3f} s sent in {took:.3f} s", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
