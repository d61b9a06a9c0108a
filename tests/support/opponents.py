"""Programs of ``studies.bench``: skipped where they cannot be made, and broken on purpose."""

from pathlib import Path

import pytest
from studies.bench.opponents import Unavailable

from studies.bench import opponents


def made(program, *arguments, **options):
    try:
        return program(*arguments, **options)
    except Unavailable as reason:
        pytest.skip(str(reason))


def broken(folder, files, old, new):
    """Their sources in a folder, with ``old``, which stands in them once, replaced."""
    texts = {file: (Path(opponents.__file__).parent / file).read_text(encoding="utf-8") for file in files}
    assert sum(text.count(old) for text in texts.values()) == 1
    for file, text in texts.items():
        (folder / file).write_text(text.replace(old, new), encoding="utf-8")
    return folder
