"""Events in: recordings, synthetic scenes, and batches cut from them."""

from .arrays import Events

__all__ = ["Events"]
