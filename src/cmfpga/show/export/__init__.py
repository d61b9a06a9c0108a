"""What a track or a flow found, as files of other tools; the ending of a name says which."""

import contextlib
import os
import tempfile
from pathlib import Path

from ...errors import ConfigError, naming
from .ros import bag
from .viewer import rerun

#: Of a track: ``opened(path, config)`` gives what takes its batches. A name without an ending is a folder.
TRACK = {".mcap": bag, ".bag": bag, ".rrd": rerun, "": bag}


def checked_path(path, endings):
    """``path`` as a :class:`Path`; :exc:`ConfigError` unless it can be written and its ending is one of ``endings``."""
    path = Path(path)
    if path.suffix.lower() not in endings or not path.name:
        named = ", ".join(filter(None, endings))
        raise ConfigError(f"export {path}: a name that ends in {named}, or a folder's without an ending, is needed")
    if not path.parent.is_dir():
        raise ConfigError(f"export {path}: {path.parent}: no such folder")
    if path.is_dir() or (path.exists() and not path.suffix):
        raise ConfigError(f"export {path}: exists already; another name is needed")
    return path


@contextlib.contextmanager
def placed(path):
    """A path in a folder beside ``path``; what is there takes its place at the end, or nothing does after an error."""
    try:
        folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=".export-")
    except OSError as error:
        raise ConfigError(f"export {path}: cannot be written: {error.strerror}") from None
    with folder, naming(path):
        made = Path(folder.name) / path.name
        yield made
        os.replace(made, path)


@contextlib.contextmanager
def exported(path, config):
    """What takes the batches of a track, ``add(batch)``, and writes them to ``path``.

    Parameters
    ----------
    path : str or Path
        One of :data:`TRACK`: MCAP, a bag of ROS 1, a recording of rerun, or the folder of a bag of ROS 2. A file is
        replaced, a folder must not be there yet.
    config : Config

    Raises
    ------
    ConfigError
        The path cannot be written, or a package is missing.
    """
    path = checked_path(path, TRACK)
    with placed(path) as made, TRACK[path.suffix.lower()](made, config) as writer:
        yield writer
