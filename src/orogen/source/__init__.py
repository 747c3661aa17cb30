"""Files and arrays in, heights and colours out."""

from orogen.source.contract import Source
from orogen.source.open import open_colour, open_height

__all__ = ["Source", "open_colour", "open_height"]
