"""Terrain from arrays with any georeference, and WGSL functions of the clipmap asked at any points."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from orogen.errors import SourceError
from orogen.frame import Frame
from orogen.gpu import Gpu, Text
from orogen.grid import Grid
from orogen.pyramid.contract import Pyramid
from orogen.pyramid.open import open_pyramid
from orogen.streaming.clipmap import SEARCH, Clipmap
from orogen.streaming.clipmap_view import ClipmapView


@dataclass
class ArraySource:
    """A source of an array: heights (rows, columns), NaN = nodata, or colours (rows, columns, 4)."""

    data: NDArray[Any]
    grid: Grid
    bad: Callable[[slice, slice], bool] = lambda rows, cols: False
    """Which windows cannot be read."""
    gate: threading.Event = field(default_factory=threading.Event)
    """Reading goes on while it is set."""
    name: str = "array"
    nodata: float | None = None
    units: str = "metre"
    vertical_crs: str | None = None
    block: tuple[int, int] = (256, 256)
    direct: bool = True
    fingerprint: str | None = None

    def __post_init__(self) -> None:
        self.gate.set()
        self.reads = 0

    @property
    def kind(self) -> str:
        return "height" if self.data.ndim == 2 else "colour"

    @property
    def dtype(self) -> str:
        return str(self.data.dtype)

    @property
    def covered(self) -> bool:
        return self.data.ndim == 2 and not np.isnan(self.data).any()

    def read(self, rows: slice, cols: slice) -> NDArray[Any]:
        self.gate.wait(20)
        self.reads += 1
        if self.bad(rows, cols):
            raise SourceError("expected a block that can be read, got a bad one")
        return self.data[rows, cols].copy()

    def overview(self, shape: tuple[int, int]) -> NDArray[Any]:
        index = [np.arange(n) * size // n for n, size in zip(shape, self.data.shape, strict=False)]
        return self.data[np.ix_(*index)]

    def close(self) -> None:
        pass


def _grid(shape: tuple[int, int], spacing: float = 1.0, **changes: Any) -> Grid:
    return Grid(shape[1], shape[0], **{"transform": (spacing, 0.0, 0.0, 0.0, -spacing, shape[0] * spacing), **changes})


@pytest.fixture(scope="session")
def array_source() -> type[ArraySource]:
    return ArraySource


@pytest.fixture(scope="session")
def north_up() -> Callable[..., Grid]:
    """A grid of (rows, columns) with its lower left corner at the origin; `spacing` in metres, or fields of Grid."""
    return _grid


MakePyramid = Callable[..., Pyramid]


@pytest.fixture(scope="module")
def pyramid_of() -> Iterator[MakePyramid]:
    """Built pyramids (build=: as open_pyramid) of arrays over a grid."""
    opened: list[Pyramid] = []

    def make(data: NDArray[Any], grid: Grid | None = None, build: str = "wait", **source: Any) -> Pyramid:
        pyramid = open_pyramid(ArraySource(data, grid or _grid(data.shape[:2]), **source), build=build)
        opened.append(pyramid)
        return pyramid

    yield make
    for pyramid in opened:
        pyramid.close()


@pytest.fixture
def clipmap_of(gpu: Gpu) -> Iterator[Callable[..., Clipmap]]:
    """Clipmaps that are closed after the test."""
    opened: list[Clipmap] = []

    def make(*arguments: Any) -> Clipmap:
        opened.append(Clipmap(gpu, *arguments))
        return opened[-1]

    yield make
    for clipmap in opened:
        clipmap.close()


def settled(clipmap: Clipmap, frame: Frame, view: ClipmapView | None = None) -> tuple[ClipmapView, Frame]:
    """A view that is complete for a frame, and the frame as the clipmap completes it."""
    view = view or clipmap.view()
    view.want(view.frame_for(frame))
    clipmap.settle()
    frame = view.frame_for(frame)
    view.update(frame)
    return view, frame


@pytest.fixture(scope="session")
def settle() -> Callable[..., tuple[ClipmapView, Frame]]:
    return settled


PROBE = """#include trace.wgsl
struct Query { cell: vec2<i32>, frac: vec2<f32>, high: vec2<i32>, value: f32, level: u32 }
@group(1) @binding(0) var<storage, read> queries: array<Query>;
@group(1) @binding(1) var<storage, read_write> answers: array<vec4<f32>>;

@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= arrayLength(&answers)) { return; }
    let q = queries[id.x];
    let p = Point(q.cell, q.frac);
    answers[id.x] = EXPRESSION;
}
"""
QUERY = np.dtype(
    [("cell", "i4", 2), ("frac", "f4", 2), ("high", "i4", 2), ("value", "f4"), ("level", "u4")]
)  # fmt: skip


class Prober:
    """Evaluates WGSL expressions of `p` (a Point) and `q` (a Query) at points of a view."""

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self._layout = gpu.layout("probe", {0: ("COMPUTE", "read"), 1: ("COMPUTE", "storage")})
        self._pipelines: dict[tuple[str, Any], Any] = {}

    def __call__(
        self,
        view: ClipmapView,
        frame: Frame,
        expression: str,
        tx: ArrayLike,
        ty: ArrayLike,
        *,
        high: ArrayLike = 0,
        value: ArrayLike = 0.0,
        level: ArrayLike = 0,
    ) -> NDArray[np.float32]:
        """(n, 4) of a vec4 expression at texel coordinates (float64) of the heights."""
        clipmap, gpu = view.clipmap, self._gpu
        key = expression, tuple(clipmap.constants.items())
        if key not in self._pipelines:
            shader = gpu.shader(
                "probe",
                Text("probe", PROBE.replace("EXPRESSION", expression)),
                search=SEARCH,
                constants=clipmap.constants,
            )
            self._pipelines[key] = gpu.compute("probe", shader, "probe", [clipmap.layout, self._layout])
        at = np.stack(np.broadcast_arrays(tx, ty), axis=-1).astype(np.float64) * (1 << frame.subtexel_bits)
        queries = np.zeros(len(at), QUERY)
        queries["cell"] = np.floor(at)
        queries["frac"] = at - np.floor(at)
        queries["high"], queries["value"], queries["level"] = high, value, level
        source = gpu.buffer("queries", queries, "STORAGE", "test")
        target = gpu.buffer("answers", 16 * len(at), "STORAGE|COPY_SRC", "test")
        encoder = gpu.encoder("probe")
        run = encoder.begin_compute_pass(label="probe")
        run.set_pipeline(self._pipelines[key])
        run.set_bind_group(0, view.bind_group)
        run.set_bind_group(1, gpu.bind("probe", self._layout, {0: source, 1: target}))
        run.dispatch_workgroups(-(-len(at) // 64))
        run.end()
        gpu.submit(encoder)
        answers = gpu.read_buffer(target, dtype=np.float32).result().reshape(-1, 4)
        source.destroy()
        target.destroy()
        return answers


@pytest.fixture(scope="session")
def probe(gpu: Gpu) -> Prober:
    return Prober(gpu)
