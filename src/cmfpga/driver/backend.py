"""What the driver needs of whatever leads to the registers and streams of the AXI top."""

from abc import ABC, abstractmethod


class Backend(ABC):
    """Registers, words in, packets out, and the interrupt of one AXI top.

    Nothing waits without an end: what may wait takes a time-out in seconds (0: look once).

    Attributes
    ----------
    name : str
        For messages.
    has_interrupt : bool
        Whether :meth:`wait_interrupt` can be used; otherwise the driver polls.
    form : str
        Words that events are best encoded into, a key of :data:`cmfpga.protocol.registers.FORMATS`.
    max_words : int
        Most 64-bit words of one :meth:`send`.
    config : Config or None
        What hardware this is, where the back end knows.
    """

    name = ""
    config = None
    has_interrupt = True
    form = "PACKED"
    max_words = 1 << 62

    @abstractmethod
    def read32(self, offset):
        """The register at a byte offset from the map's begin; :exc:`DeviceError` where there is no answer."""

    @abstractmethod
    def write32(self, offset, value):
        """Write all 32 bits of a register."""

    @abstractmethod
    def send(self, words):
        """Begin to send words to ``s_axis``, with TLAST at the end; returns at once.

        Parameters
        ----------
        words : uint64 array
            1 to :attr:`max_words` of them.

        Raises
        ------
        DeviceError
            The transfer before it is still under way.
        """

    @abstractmethod
    def wait_sent(self, timeout):
        """Wait until all words were taken. Raises :exc:`DeviceTimeout`."""

    @abstractmethod
    def receive(self, timeout):
        """The next packet from ``m_axis``: uint64 array, up to and with the word that has TLAST.

        Raises :exc:`DeviceTimeout`; the packet can be received later then.
        """

    @abstractmethod
    def wait_interrupt(self, timeout):
        """Whether ``irq`` was, or became, high. It may have fallen again: the register ISR says what for."""

    @abstractmethod
    def stop(self):
        """Give up transfers that are under way, and forget packets that came. The registers stay."""

    def hint(self):
        """What to look at where the hardware is silent; empty or one sentence."""
        return ""

    def close(self):  # noqa: B027 - a back end may hold nothing
        """Release what is held. Safe to call twice."""
