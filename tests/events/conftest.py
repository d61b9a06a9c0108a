"""Files of every format."""

import numpy as np
import pytest

from support.recordings import WRITERS


@pytest.fixture(params=WRITERS)
def write(request, tmp_path):
    """``write(t, x, y, p)``: the path of a file of these columns; the test runs once per format."""

    def write(t, x, y, p):
        path = tmp_path / f"recording.{request.param}"
        WRITERS[request.param](path, *map(np.asarray, (t, x, y, p)))
        return path

    return write
