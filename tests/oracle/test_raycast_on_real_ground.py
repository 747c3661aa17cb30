"""The GPU's ray caster, the reference of every comparison, against Embree on real ground."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from oracle.crops import NAMES, crop
from orogen.compare.cameras import standard_cameras
from orogen.compare.embree import EmbreeSurface, compare
from orogen.compare.truth import TrueSurface
from orogen.gpu import Gpu
from orogen.pyramid.open import open_pyramid
from orogen.source.open import open_height
from orogen.streaming.settings import ClipmapSettings
from orogen.view.renderer import Renderer

VIEWS = ("low", "outside")
LIMIT = 0.01
"""Vertical difference relative to the relief of a cell."""


@pytest.mark.parametrize("name", NAMES)
def test_raycast_agrees_with_embree(gpu: Gpu, data_dir: Path, name: str) -> None:
    heights, crop_grid = crop(data_dir, name, 97)
    pyramid = open_pyramid(open_height(heights, spacing=crop_grid.spacing))
    settings = ClipmapSettings(view_distance=math.inf, load_distance=math.inf, memory=32 << 20)
    cameras = standard_cameras(pyramid.grid, TrueSurface(heights))
    with closing(Renderer(gpu, pyramid, name="raycast", clipmap=settings)) as renderer:
        for view in VIEWS:
            picture = renderer.render(cameras[view], (240, 150))
            agreement = compare(picture.reverse_depth, picture.frame, EmbreeSurface(picture.frame, heights), LIMIT)
            assert (picture.reverse_depth > 0).mean() > 0.15
            assert agreement.share >= 0.999, (view, agreement.share, agreement.outline)
            assert np.nanpercentile(agreement.relative, 99.9) <= LIMIT
