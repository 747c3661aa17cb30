"""What can be set; see README.md in this folder."""

from __future__ import annotations

from dataclasses import dataclass

from orogen.errors import SettingsError
from orogen.values import expected_name

VARIANTS = ("oblique", "right_angled", "conforming")
METRICS = ("height_difference", "object_error", "screen_error", "samples", "area")
SAMPLED = ("samples", "area")
"""Metrics that look at several samples of an edge; the others look at its middle, or at its ends."""


@dataclass(frozen=True)
class Settings:
    """How edges are judged, and what becomes of triangles whose edges are split."""

    variant: str = "oblique"
    """What a triangle becomes whose legs are split and whose longest edge is not: oblique (triangles of any shape),
    right_angled (that edge gets an invisible vertex), conforming (it is split, in the neighbour, too)."""
    metric: str | None = None
    """What is measured on an edge: height_difference of its ends, object_error or screen_error at its middle, the worst
    of several samples, or the area over the edge; none: height_difference where the variant is right_angled, which
    takes no other, else samples."""
    threshold: float = 0.5
    """What an edge is split from, above 0: pixels for screen_error and samples, the side of a square in pixels for
    area, metres for height_difference and object_error."""
    samples: int = 3
    """Samples on an edge, 1 to 15, for samples and area."""
    move_to_worst: bool = False
    """Whether a new vertex stands on the worst of the samples instead of the middle of its edge; for oblique triangles
    and several samples."""
    depth_detail: float = 1.0
    """What metres at the far end of the data weigh against those before the eye, 0 to 1."""
    coarse: int = 40
    """Cells along the longer side of the mesh that refinement starts from, 1 to 512; each is a power of two of samples
    wide, so that their number comes near to this."""
    depth: int | None = None
    """Passes of refinement, at least 0; none: until edges are as short as the data have a use for, which is also the
    most."""
    time_budget: float | None = None
    """Milliseconds of refinement in a frame, above 0; the next frames go on where it stopped. None: all in one."""
    triangle_capacity: int = 1 << 16
    """Triangles that there is room for at first, at least 64; grows when a frame needs more."""

    def __post_init__(self) -> None:
        if self.variant not in VARIANTS:
            raise expected_name("variant", self.variant, VARIANTS)
        if self.metric is not None and self.metric not in METRICS:
            raise expected_name("metric", self.metric, METRICS)
        if self.variant == "right_angled" and self.measured != "height_difference":
            raise SettingsError(
                "metric: expected height_difference for right_angled, whose decisions must be monotonic, got "
                f"{self.metric}"
            )
        if not 0 < self.threshold < float("inf"):
            raise SettingsError(f"threshold: expected a number above 0, got {self.threshold}")
        if not 1 <= self.samples <= 15:
            raise SettingsError(f"samples: expected 1 to 15 on an edge, got {self.samples}")
        if self.move_to_worst and (self.variant != "oblique" or self.measured not in SAMPLED):
            raise SettingsError(
                f"move_to_worst: expected oblique triangles and samples or area, got {self.variant} and {self.measured}"
            )
        if not 0 <= self.depth_detail <= 1:
            raise SettingsError(f"depth_detail: expected 0 to 1, got {self.depth_detail}")
        if not 1 <= self.coarse <= 512:
            raise SettingsError(f"coarse: expected 1 to 512 cells, got {self.coarse}")
        if self.depth is not None and self.depth < 0:
            raise SettingsError(f"depth: expected at least 0 passes, got {self.depth}")
        if self.time_budget is not None and not self.time_budget > 0:
            raise SettingsError(f"time_budget: expected milliseconds above 0, got {self.time_budget}")
        if self.triangle_capacity < 64:
            raise SettingsError(f"triangle_capacity: expected at least 64 triangles, got {self.triangle_capacity}")

    @property
    def measured(self) -> str:
        """The metric, or what stands for none."""
        return self.metric or ("height_difference" if self.variant == "right_angled" else "samples")

    @property
    def edge_samples(self) -> int:
        """Samples that the metric takes on an edge; one stands in its middle."""
        return self.samples if self.measured in SAMPLED else 1
