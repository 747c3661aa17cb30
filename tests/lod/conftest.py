"""Ground that the tests of several algorithms draw."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest

from lod.around import COLUMNS, METRES, ROWS, slope
from lod.scene import Scene
from oracle.landscapes import hills
from orogen.gpu import Gpu


@pytest.fixture(scope="module")
def plane(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, slope())) as scene:
        yield scene


@pytest.fixture(scope="module")
def sheared_plane(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, slope(), metres=METRES)) as scene:
        yield scene


@pytest.fixture(scope="module")
def hilly(gpu: Gpu) -> Iterator[Scene]:
    with closing(Scene(gpu, hills(COLUMNS, 500.0).astype(np.float32)[:ROWS])) as scene:
        yield scene
