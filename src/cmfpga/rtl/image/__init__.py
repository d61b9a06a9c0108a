"""Blocks from an event to the sums of the image of warped events and its derivatives."""

from .one_pass_image import FourImages, OnePassImage
from .swept_image import SweptImage

#: By the value of ``gradient``: the ways to sum, each an :class:`~cmfpga.rtl.image.image_sums.ImageSums`.
IMAGES = {"sweep": SweptImage, "one_pass": OnePassImage}


def image_of(config):
    """The class of a configuration's image."""
    return FourImages if config.geometry.images > 1 else IMAGES[config.gradient]
