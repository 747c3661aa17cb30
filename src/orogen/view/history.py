"""What the latest frames took, for graphs."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

LENGTH = 240
"""Frames that are kept."""


@dataclass(frozen=True)
class Sample:
    """One frame."""

    frame: float
    """Milliseconds from frame to frame while the camera moves, else of the frame alone."""
    cpu: float
    """Milliseconds that the frame took on the CPU, waits included."""
    gpu: Mapping[str, float] = field(default_factory=dict)
    """Milliseconds per pass of the latest frame that was timed; empty where the adapter has no timestamps."""
    triangles: int = 0
    """Triangles drawn."""
    resident: int = 0
    """Nodes on the GPU."""
    queue: int = 0
    """Nodes that are wanted and still to come."""
    memory: int = 0
    """Bytes of GPU memory."""
    scale: float = 1.0
    """Part of the window's width and height that the picture had."""
    detail: float = 1.0
    """Part of the algorithm's detail that its geometry had."""
    samples: int = 1
    """Samples per pixel that were added."""


class History:
    """The latest frames, the oldest first."""

    def __init__(self, length: int = LENGTH) -> None:
        self._samples: deque[Sample] = deque(maxlen=length)

    def add(self, sample: Sample) -> None:
        """Keep one more frame."""
        self._samples.append(sample)

    @property
    def latest(self) -> Sample | None:
        """The latest frame; None before the first."""
        return self._samples[-1] if self._samples else None

    def series(self, name: str) -> NDArray[np.float64]:
        """A field of all frames."""
        return np.array([getattr(sample, name) for sample in self._samples], np.float64)

    def passes(self) -> dict[str, NDArray[np.float64]]:
        """GPU milliseconds of all frames by pass, the longest first; 0 where a frame had no such pass."""
        names = {name: None for sample in self._samples for name in sample.gpu}
        found = {name: np.array([s.gpu.get(name, 0.0) for s in self._samples], np.float64) for name in names}
        return dict(sorted(found.items(), key=lambda item: -float(item[1].mean())))
