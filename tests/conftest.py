"""Fixtures that every room's tests share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

if TYPE_CHECKING:
    from orogen.gpu import Gpu

ROOT = Path(__file__).resolve().parents[1]
GOLDENS = ROOT / "tests" / "goldens"
FAILURES = ROOT / "tests" / "failures"
GOLDEN_ATOL = 2
"""Steps of 8-bit colour by which a pixel may differ from its golden: rounding, not content."""
GOLDEN_STRAYS = 0.002
"""Share of the pixels that may differ by more: those on edges fall either way between versions of the driver."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--regenerate", action="store_true", help="write the goldens from what is drawn now, then look at them"
    )
    parser.addoption(
        "--rasterizer", default="auto", help="what draws triangles in the algorithms' contract: hardware or compute"
    )
    parser.addoption(
        "--every",
        type=int,
        help="draw every so many frames of a flight in the nightly tests; by default all on a GPU, else each tenth",
    )


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the user's cache out of the tests, and the tests out of it; child processes inherit that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OROGEN_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("OROGEN_CACHE_MAX", raising=False)
        yield


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real data; its README says what is in it."""
    folder = Path(os.environ.get("OROGEN_TEST_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"no real data: {folder} is not a folder; set OROGEN_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def gpu() -> Iterator[Gpu]:
    """The device that all tests of the session share; software rendering counts, none at all is a failure."""
    from orogen.gpu import open_gpu

    with open_gpu() as device:
        yield device


@pytest.fixture(scope="session")
def rasterizer(request: pytest.FixtureRequest) -> str:
    """What draws triangles where a test holds for both ways; see --rasterizer."""
    return request.config.getoption("--rasterizer")


Golden = Callable[[str, NDArray[np.uint8]], None]


@pytest.fixture
def golden(request: pytest.FixtureRequest, gpu: Gpu) -> Golden:
    """Compare a picture (rows, columns, 3) of uint8 with tests/goldens/NAME.png; see CONTRIBUTING.md."""

    def compare(name: str, picture: NDArray[np.uint8]) -> None:
        assert picture.dtype == np.uint8
        assert picture.shape[2:] == (3,)
        if gpu.info.kind != "cpu":
            pytest.skip(f"goldens are drawn with the software driver, this is {gpu.info}")
        path = GOLDENS / f"{name}.png"
        if request.config.getoption("--regenerate"):
            GOLDENS.mkdir(exist_ok=True)
            Image.fromarray(picture).save(path, optimize=True)
            return
        assert path.exists(), f"no golden {path.name}: draw it with --regenerate, look at it, then commit it"
        with Image.open(path) as image:
            expected = np.asarray(image.convert("RGB"))
        assert picture.shape == expected.shape
        difference = np.abs(picture.astype(np.int16) - expected)
        share = (difference > GOLDEN_ATOL).any(axis=2).mean()
        if share > GOLDEN_STRAYS:
            FAILURES.mkdir(exist_ok=True)
            Image.fromarray(picture).save(FAILURES / f"{name}.png")
            amplified = np.minimum(difference * 20, 255).astype(np.uint8)
            Image.fromarray(amplified).save(FAILURES / f"{name}.difference.png")
            pytest.fail(
                f"{share:.2%} of the pixels differ from golden {name} by more than {GOLDEN_ATOL} steps, at most by "
                f"{difference.max()}; see tests/failures/{name}.png and {name}.difference.png (20 times amplified)"
            )

    return compare
