"""What was computed, one file each, so that a sweep goes on where it stopped."""

import json
import os
import tempfile
from pathlib import Path

from ..errors import naming
from ..forms import check

#: A larger file is not read: some 40,000 batches, which become twenty times as many bytes in memory.
MOST_BYTES = 1 << 24


class Store:
    """Outcomes by their key, in a folder that is made when it is first written to.

    A file is complete or absent: it is written under another name and then renamed. Only ``"ok"`` is kept; what failed
    is tried again the next time.
    """

    def __init__(self, folder):
        self.folder = Path(folder)

    def get(self, key, form):
        """The outcome kept under ``key``; None where it has another form (:mod:`cmfpga.forms`): a changed file."""
        path = self.folder / f"{key}.json"
        try:
            if not path.is_file() or path.stat().st_size > MOST_BYTES:
                return None
            outcome = json.loads(path.read_text(encoding="utf-8"))
            check(outcome, form, key)
            return outcome if outcome["status"] == "ok" else None
        except (OSError, ValueError, RecursionError):  # damaged, or changed
            return None

    def put(self, key, outcome):
        """Keep ``outcome`` if it is ``"ok"``; returns it as :meth:`get` would."""
        text = json.dumps(outcome)
        if outcome["status"] == "ok":
            self.folder.mkdir(parents=True, exist_ok=True)
            write_atomically(self.folder / f"{key}.json", text.encode())
        return json.loads(text)


def write_atomically(path, content):
    """Write bytes so that whoever reads ``path`` finds what was there before, or all of it."""
    handle, scratch = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with naming(path), os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(scratch, 0o666 & ~umask)  # mkstemp's are for their owner only
        os.replace(scratch, path)
    except BaseException:
        os.unlink(scratch)
        raise
