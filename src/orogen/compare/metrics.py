"""What is measured of one frame: pictures as pictures, the drawn surface against the true one, and its stability.

A record is a flat dictionary of plain numbers, ready for JSON: NaN (nothing to measure) becomes None, and only the PSNR
of two equal pictures is infinite. Libraries of the extra `metrics` are imported where they are used.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from orogen.compare.cracks import find_cracks
from orogen.compare.surface_error import Spread, surface_error
from orogen.compare.temporal import History, Stability
from orogen.compare.truth import TrueSurface
from orogen.errors import SettingsError

if TYPE_CHECKING:
    from orogen.view.renderer import Picture

METRICS = ("psnr", "ssim", "flip", "delta_e", "shapes", "surface", "cracks", "stability")
"""Names of what can be measured, the cheap ones first; "shapes" of triangles, not of pictures: see triangle_quality."""
LARGEST_VALUE = 255
"""MAX_I of equation 4.1a (Houska 2019) for 8 bits per channel."""
SSIM_WINDOW = 11
"""Pixels of the Gaussian window of SSIM (Wang et al. 2004); smaller pictures have none."""
NEEDS = {"ssim": "skimage", "flip": "flip_evaluator", "delta_e": "skimage"}
"""Modules that a metric needs, of the extra `metrics`."""


def available() -> frozenset[str]:
    """The metrics that are worth measuring with what is installed.

    That is all of them, but of the two perceptual ones only FLIP, or the mean colour difference where FLIP's library
    has no build for the platform.
    """
    installed = {name for name in METRICS if name not in NEEDS or importlib.util.find_spec(NEEDS[name])}
    return frozenset(installed - {"delta_e"} if "flip" in installed else installed)


def measure_frame(
    drawn: Picture,
    reference: Picture,
    surface: TrueSurface | None,
    history: History,
    which: Collection[str] | None = None,
) -> dict[str, Any]:
    """Everything that `which` (names out of METRICS; None: `available()`) asks for, of one frame of a flight.

    `drawn` and `reference` show the same frame, the second with the true surface. `surface`: the true surface over the
    frame's grid; needed for "surface" and "stability". `history`: of the flight so far; the frame is added to it.
    Raises SettingsError for an unknown name, a missing surface, and pictures that do not fit each other.
    """
    which = available() if which is None else frozenset(which)
    if unknown := sorted(which - set(METRICS)):
        raise SettingsError(f"metrics: expected names out of {', '.join(METRICS)}, got {', '.join(unknown)}")
    if surface is None and (lacking := sorted(which & {"surface", "stability"})):
        raise SettingsError(f"surface: expected the true surface for {' and '.join(lacking)}, got None")
    record: dict[str, Any] = {}
    if "psnr" in which:
        record["mse"] = mean_square_error(drawn.color, reference.color)
        record["psnr"] = psnr_of(record["mse"])
    perceptual: dict[str, Callable[[NDArray[np.uint8], NDArray[np.uint8]], float]] = {
        "ssim": ssim, "flip": flip, "delta_e": delta_e,
    }  # fmt: skip
    record |= {name: measured(drawn.color, reference.color) for name, measured in perceptual.items() if name in which}
    if "surface" in which:
        assert surface is not None
        error = surface_error(drawn.reverse_depth, reference.reverse_depth, drawn.frame, surface)
        record |= {"forward": _spread(error.forward), "backward": _spread(error.backward)}
        record |= {"hidden": error.hidden, "stray": error.stray}
    if "cracks" in which:
        cracks = find_cracks(drawn.reverse_depth, reference.reverse_depth, drawn.frame)
        record |= {"cracks": cracks.count, "lost": cracks.lost}
        record |= {"skyline_mean": cracks.skyline_mean, "skyline_max": cracks.skyline_max}
    if "stability" in which:
        assert surface is not None
        record |= _stability(history.add(drawn, surface))
    return {name: _plain(value) for name, value in record.items()}


def mean_square_error(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """MSE of equation 4.1b (Houska 2019): over all pixels and the channels red, green and blue, in squared steps.

    `drawn`, `reference`: (height, width, 3 or more) uint8; channels after the third are ignored. Raises SettingsError
    for pictures that do not fit.
    """
    first, second = _rgb(drawn, reference)
    difference = first.astype(np.int32) - second
    return float((difference * difference).sum(dtype=np.int64)) / difference.size


def psnr_of(error: float) -> float:
    """PSNR of equation 4.1c (Houska 2019) in dB from a mean square error; infinite for 0."""
    return math.inf if error == 0 else 10 * math.log10(LARGEST_VALUE**2 / error)


def psnr(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio in dB (Houska 2019, equations 4.1a to 4.1c); infinite for equal pictures.

    Arguments and errors as `mean_square_error`.
    """
    return psnr_of(mean_square_error(drawn, reference))


def ssim(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Mean structural similarity, up to 1 (Wang et al. 2004: Gaussian window, sigma 1.5); NaN for tiny pictures.

    Arguments and errors as `mean_square_error`.
    """
    from skimage.metrics import structural_similarity

    first, second = _rgb(drawn, reference)
    if min(first.shape[:2]) < SSIM_WINDOW:
        return math.nan
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return float(structural_similarity(first, second, channel_axis=2, data_range=LARGEST_VALUE, **options))


def flip(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Mean FLIP, 0 to 1 (Andersson et al. 2020, at 67 pixels per degree): what an eye sees that flips between the two.

    Arguments and errors as `mean_square_error`.
    """
    import flip_evaluator

    first, second = (picture.astype(np.float32) / LARGEST_VALUE for picture in _rgb(drawn, reference))
    _, mean, _ = flip_evaluator.evaluate(second, first, "LDR", applyMagma=False)
    return float(mean)


def delta_e(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Mean colour difference CIEDE2000: 1 is about the least that an eye notices on large areas.

    Arguments and errors as `mean_square_error`.
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    first, second = _rgb(drawn, reference)
    return float(deltaE_ciede2000(rgb2lab(second), rgb2lab(first)).mean())


def _rgb(drawn: NDArray[np.uint8], reference: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    for name, picture in (("drawn", drawn), ("reference", reference)):
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] < 3 or 0 in picture.shape:
            raise SettingsError(f"{name}: expected uint8 (height, width, 3 or 4), got {picture.dtype} {picture.shape}")
    if drawn.shape[:2] != reference.shape[:2]:
        raise SettingsError(f"drawn: expected the reference's size {reference.shape[:2]}, got {drawn.shape[:2]}")
    return drawn[..., :3], reference[..., :3]


def _spread(spread: Spread) -> dict[str, float | None]:
    values = {"mean": spread.mean, "p95": spread.p95, "p99": spread.p99, "max": spread.max, "over_1px": spread.over_one}
    return {name: _plain(value) for name, value in values.items()}


def _stability(step: Stability | None) -> dict[str, float]:
    nothing = Stability(0, *(math.nan,) * 4)
    step = step or nothing
    return {
        "instability_mean": step.mean,
        "instability_p99": step.p99,
        "swimming": step.swimming,
        "popping": step.popping,
    }


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and math.isnan(value) else value
