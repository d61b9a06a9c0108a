"""Blocks from an event to the sums of the image of warped events and its derivatives."""

from .one_pass_image import OnePassImage
from .swept_image import SweptImage

#: By the value of ``gradient``: the ways to sum, each an :class:`~cmfpga.rtl.image.image_sums.ImageSums`.
IMAGES = {"sweep": SweptImage, "one_pass": OnePassImage}
