"""What a track found, from Python."""

import base64
import functools
import html
import io

import numpy as np

from ..config.presets import CLOCK_MHZ
from ..config.windows import needs_batches
from ..errors import ConfigError, naming, needs
from ..events import Events
from ..imaging.camera import seen
from ..protocol.confidence import covariance
from ..show.export import exported
from ..show.gallery import Gallery
from ..tracking.columns import columns, csv_writer, row
from ..tracking.kept import Kept
from ..tracking.verdict import Verdict

# Lines at either end of a notebook's table.
_SHOWN = 5


class Tracking:
    """What a track found, batch by batch.

    Each column of ``track.csv`` is an attribute of the same name: an array with one element per batch, as
    :func:`~cmfpga.tracking.columns.columns` declares it. It is not rounded; a value that the CSV leaves empty is NaN.

    Parameters
    ----------
    config : Config
    engine : str
        Name of the engine that ran the batches.
    source : Source
        Where the events come from.

    Attributes
    ----------
    results : list of BatchResult
        All that the engine returned.
    """

    def __init__(self, config, engine, source):
        self.config, self.engine, self.source = config, engine, source
        self.results, self._values = [], []
        self._runs = []  # of each batch: its first event, plan, thinning and marks
        self._kept = Kept(config, engine, source.name, source.motion)
        self._gallery = Gallery(config, source.name, source.motion)

    def add(self, batch):
        """Take one :class:`~cmfpga.tracking.loop.TrackedBatch`, which follows the last one."""
        self.results.append(batch.result)
        self._values.append(batch.values)
        self._runs.append((batch.events.first_event, batch.plan, batch.thinning, batch.marks))
        for consumer in (self._gallery, self._kept):
            consumer.add(batch)

    def __len__(self):
        return len(self.results)

    def __getattr__(self, name):
        if "config" in vars(self) and name in self._columns:
            return self._columns[name].array([values[name] for values in self._values])
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    def __dir__(self):
        return [*super().__dir__(), *self._columns]

    @property
    def _columns(self):
        return columns(self.config.motion, self.config.slides)

    def __repr__(self):
        return f"<Tracking of {self.source.name}: {len(self)} {self.config.nouns}, {self.engine} engine>"

    @property
    def trusted(self):
        """Whether each batch is to be trusted: bool [batches]; False where its confidence was not measured."""
        return np.array([values["trusted"] for values in self._values], bool)

    @property
    def verdict(self):
        """:class:`~cmfpga.tracking.verdict.Verdict`: velocity, trusted batches, where the object was lost; remarks."""
        return Verdict.of(self._values, self.config)

    @property
    def covariance(self):
        """Covariance of (vx, vy) of each batch, (px/half batch)²: float64 [batches, 2, 2]; NaN where not trusted."""
        found = (covariance(self.config, result) or (np.nan,) * 3 for result in self.results)
        return np.array([[[xx, xy], [xy, yy]] for xx, yy, xy in found]).reshape(-1, 2, 2) * self.config.pixel**2

    @property
    def covariance_px_per_s(self):
        """The same of (vx_px_per_s, vy_px_per_s), (px/s)²."""
        span = np.array([result.span or np.nan for result in self.results], np.float64) * 1e-6
        return self.covariance * ((2 / span) ** 2)[:, None, None]

    def to_csv(self, path):
        """Write ``track.csv``, the same text as the command's."""
        with naming(path), open(path, "w", newline="") as file:
            write = csv_writer(file, self._columns, self.config.image)
            for values in self._values:
                write(row(values))

    def to_arrays(self):
        """``{name: array}`` of all columns of ``track.csv``."""
        return {name: getattr(self, name) for name in self._columns}

    def to_pandas(self):
        """The same as a pandas ``DataFrame``. Needs pandas: ``pip install 'cmfpga[pandas]'``."""
        with needs("pandas", "pandas", "to_pandas"):
            import pandas
        return pandas.DataFrame(self.to_arrays())

    def _repr_html_(self):
        """In a notebook: the first and last batches as a table, and the picture."""
        shown = self._values if len(self) <= 2 * _SHOWN else [*self._values[:_SHOWN], None, *self._values[-_SHOWN:]]
        declared = self._columns.values()
        lines = [[column.title + (f" [{column.unit}]" if column.unit else "") for column in declared]]
        lines += [row(values) if values else ["…"] * len(declared) for values in shown]
        table = "".join(f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in line)}</tr>" for line in lines)
        picture = io.BytesIO()
        self.plot().savefig(picture)
        return (
            f"<p>{html.escape(repr(self)[1:-1])}</p><table>{table}</table>"
            f'<img src="data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}">'
        )

    def plot(self, path=None):
        """The picture that the command writes as ``track.png``: a Matplotlib ``Figure``.

        It is written to ``path``, too: ``.png``, ``.pdf``, ``.svg``; or ``.gif``, which shows the object as it moves.
        """
        figure = self._gallery.figure(self.verdict.title)
        if path is not None:
            self._gallery.save(path, figure)
        return figure

    def export(self, path):
        """Write the track as ``track --export`` does: :func:`~cmfpga.show.export.exported`.

        Only ``.rrd`` shows events, which are read again from the recording.
        """
        with exported(path, self.config) as writer:
            for k in range(len(self)):
                writer.add(_Again(self, k))

    def report(self, path, *, clock_mhz=CLOCK_MHZ):
        """Write the page of ``track --report``: one HTML file that needs nothing else. Needs plotly.

        ``clock_mhz`` is the assumed clock of the hardware, MHz.
        """
        from ..show.report import write_page

        write_page(self._kept, path, clock_mhz=clock_mhz)

    def trace(self, batch):
        """Every intermediate of a batch: :class:`~cmfpga.tracking.trace.BatchTrace`. Needs torch; not for ``axi``.

        Its events are read again from the recording. ``batch`` is its number; negative from the end.
        """
        needs_batches(self.config, "trace")
        with needs("torch", "reference", "trace"):
            from ..tracking.trace import BatchTrace
        if not -len(self) <= batch < len(self):
            raise ConfigError(f"batch {batch}: 0 to {len(self) - 1} is needed")
        result, (_, plan, thinning, marks) = self.results[batch], self._runs[batch]
        events = self._events(batch)
        how = {"plan": plan, "thinning": thinning, "marks": marks, "name": self.source.name}
        return BatchTrace(self.config, self.engine, events, result, **how)

    def _events(self, batch):
        """The events of a batch, read again from the recording."""
        result, first = self.results[batch], self._runs[batch][0]
        return self.source.read(first, result.events) if result.events else Events.empty()


class _Again:
    """A batch of a track, once more; its events are read again where they are asked for."""

    def __init__(self, tracking, batch):
        self._tracking, self._batch = tracking, batch
        self.values, self.result = tracking._values[batch], tracking.results[batch]

    @functools.cached_property
    def events(self):
        return self._tracking._events(self._batch)

    @property
    def seen(self):
        return seen(self._tracking.config, self.events)
