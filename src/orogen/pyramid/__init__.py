"""Levels of heights and colours by window, with bounds for each node; built once into a Zarr store."""

from orogen.pyramid.contract import Pyramid
from orogen.pyramid.make import build_pyramid, update_pyramid
from orogen.pyramid.open import open_pyramid

__all__ = ["Pyramid", "build_pyramid", "open_pyramid", "update_pyramid"]
