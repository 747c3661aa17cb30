"""Levels of heights and colours by window, with bounds for each node; built once into a Zarr store."""

from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid

__all__ = ["Pyramid", "open_pyramid"]
