"""What the decoders of all word formats have in common."""

from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from ...protocol.word_format import EVENT_TYPES, OTHER_TYPES, TIME_HIGH
from . import payloads


class Decoder(wiring.Component):
    """Words in, events out.

    Members
    -------
    i : ``In``, stream of :func:`payloads.beat`
    o : ``Out``, stream of :func:`payloads.token`
    format_error, other, back : ``Out(1)``
        One cycle each: a word was dropped, or is of no use here, or is a time word that steps back. A format without
        types of words has only the first.
    time_known, empty : ``Out(1)``
        A time word came, or none is needed; no word is held.
    """

    def __init__(self, config):
        self.config = config
        super().__init__(
            {
                "i": In(stream.Signature(payloads.beat())),
                "o": Out(stream.Signature(payloads.token(config))),
                **dict.fromkeys(("format_error", "other", "back", "time_known", "empty"), Out(1)),
            }
        )

    def _by_type(self, m, kind, event, load, use):
        """What a whole EVT 2.x word of some ``kind`` does: the assignment ``event``, ``load`` or a count by ``use``."""
        with m.Switch(kind):
            with m.Case(*EVENT_TYPES):
                m.d.comb += event
            with m.Case(TIME_HIGH):
                m.d.comb += load.eq(use)
            with m.Case(*OTHER_TYPES):
                m.d.comb += self.other.eq(use)
            with m.Default():
                m.d.comb += self.format_error.eq(use)
