"""What a window shows: a data set, how it is drawn, and what it is compared with. Every change is checked first."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Literal

from orogen.camera import Camera
from orogen.errors import DeviceLostError, OrogenError, SettingsError
from orogen.shading.style import Style
from orogen.view.controls import Ground
from orogen.view.framing import frame_camera
from orogen.view.history import History, Sample
from orogen.view.measure import Ruler
from orogen.view.opening import Data as Data
from orogen.view.opening import Opening
from orogen.view.overlay import nice_length
from orogen.view.quality import Quality, QualitySettings, geometry_share, least_detail
from orogen.view.renderer import Renderer, Scene
from orogen.view.split import Joiner
from orogen.view.sun import parse_time, sun_position

if TYPE_CHECKING:
    import wgpu

log = logging.getLogger("orogen")

STATISTICS_EVERY = 16
"""Frames between two counts of triangles: each waits for the GPU."""
MOST_COVERED = 0.6
"""Part of a window's width that a panel may hide for what it leaves to be a picture of its own."""


@dataclass
class Second:
    """What is drawn beside the first view."""

    kind: Literal["compare", "map"]
    """Whether it is seen with the same camera, up to a divider, or from above with one of its own."""
    renderer: Renderer
    """Draws it."""
    label: str
    """What it is, in a few words."""
    data: Data | None = None
    """Its data set where that is another one, to be closed with it."""


class Session:
    """One data set in a window. Not safe to use from several threads.

    All that changes what is seen is a method that raises an `OrogenError`, and changes nothing, for what cannot be.
    """

    def __init__(
        self,
        data: Data,
        style: Style | None = None,
        scene: Scene | None = None,
        *,
        camera: Camera | None = None,
        quality: QualitySettings | None = None,
        opener: Callable[[str], Data] | None = None,
        owned: bool = False,
        files: bool = True,
    ) -> None:
        """`camera`: where to begin; None shows all. `opener` opens further data sets from what a user types.

        `owned`: close the data with the session. `files`: whether who sees it may read and write files of this machine.
        """
        self.data = data
        self.style = style or Style()
        self.scene = scene or Scene()
        self.renderer = data.renderer
        chosen = self.renderer.algorithm
        self.algorithm = chosen.name
        """Name of the algorithm that draws."""
        self.values: dict[str, Any] = {
            field.name: getattr(chosen.settings, field.name)
            for field in fields(chosen.settings)
            if getattr(chosen.settings, field.name) != field.default
        }
        """Its settings that are not the defaults, by name."""
        self.opener = opener
        self.files = files
        self.ruler = Ruler(data.grid, data.height_at)
        self.quality = Quality(quality)
        self.history = History()
        self.second: Second | None = None
        self.divider = self._middle = 0.5
        """Where the second view begins, as a part of the width."""
        self.difference = False
        """Whether the height of what is compared over the first is shown in its place."""
        low, high = data.height_range
        self.difference_limit = nice_length(max(0.02 * (high - low), 0.1))
        """Metres that the strongest colour of the difference stands for."""
        self.opened: Session | None = None
        """A session of other data that was asked for and is ready to take this one's place."""
        self.problem = ""
        """Why the data asked for last could not be opened."""
        self._camera = camera
        self._framed: Camera | None = None  # where all is seen, for a window's shape
        self._owned = owned
        self._joiner: Joiner | None = None
        self._opening: Opening | None = None
        self._purpose: Literal["show", "compare"] = "show"
        self._frames = 0
        self._last = 0.0
        self._triangles = 0
        self._window: tuple[int, int] | None = None  # the latest frame's, in pixels

    # -- what a window asks --------------------------------------------------------------------------------------------

    @property
    def device(self) -> wgpu.GPUDevice:
        """The device that draws."""
        return self.renderer.device

    @property
    def camera(self) -> Camera:
        """Where to begin."""
        return self._camera or self._framed or self.whole()

    @property
    def framed(self) -> bool:
        """Whether the view begins where all data are seen, since nobody has said where."""
        return self._camera is None

    def begin(self, size: tuple[float, float], covered: float = 0.0) -> None:
        """Take the size of the window, and the part of its width that something hides on the left.

        What nobody has said is chosen accordingly: where the view begins, and where a second one does.
        """
        covered = covered if covered <= MOST_COVERED else 0.0
        self._framed = self.whole(aspect=max(size[0], 1) / max(size[1], 1), covered=covered)
        middle, before = (1 + covered) / 2, self._middle
        self._middle = middle
        if self.divider == before:  # nobody has moved it
            self.divider = middle

    @property
    def ground(self) -> Ground:
        """The terrain as the controls of the first view see it."""
        return Ground(self.data.grid, self.data.height_at, self.pick, self.scene.exaggeration)

    @property
    def map_ground(self) -> Ground:
        """The terrain as the controls of a map beside the first view see it; pixels count from its left edge."""
        return replace(self.ground, pick=self._pick_map)

    @property
    def mode(self) -> str:
        """How the two views are joined, one of `split.MODES`."""
        if self.second is None:
            return "whole"
        if self.second.kind == "map":
            return "beside"
        return "difference" if self.difference else "wipe"

    def split_at(self, width: int) -> int:
        """Column at which the second view begins in a window of so many pixels; the width itself without one."""
        return max(1, min(width - 1, round(self.divider * width))) if self.second and width > 1 else width

    def whole(self, **options: Any) -> Camera:
        """A camera that shows all data; options as in `frame_camera`."""
        options = {"exaggeration": self.scene.exaggeration, "height_at": self.data.height_at, **options}
        return frame_camera(self.data.grid, self.data.height_range, **options)

    def map_camera(self, aspect: float = 1.0) -> Camera:
        """A camera that looks straight down on all data, north up."""
        return self.whole(heading=0.0, pitch=-90.0, orthographic=True, aspect=aspect)

    def draw(
        self,
        target: wgpu.GPUTextureView,
        camera: Camera,
        size: tuple[int, int],
        moving: bool = False,
        beside: Camera | None = None,
    ) -> bool:
        """Draw into a texture of `size` pixels from what is resident; whether a further call would improve it.

        `moving`: whether the camera moves on, so that speed counts more than the finest detail. `beside`: the camera
        of the map.
        """
        start = time.perf_counter()
        self._window = size
        mode, form, samples = self.mode, target.texture.format, self.quality.samples if moving else 1
        split = self.split_at(size[0]) if mode == "beside" else size[0]
        own, scene = self.quality.size((split, size[1]), moving), self._scene_of(self.renderer, moving)
        if mode == "whole" and own == size:
            more = self.renderer.draw_to(target, camera, size, self.style, scene, samples=samples)
        else:
            self._joiner = self._joiner or Joiner(self.renderer.gpu)
            place = self._joiner.picture(0, own, form)
            more = self.renderer.draw_to(place, camera, own, self.style, scene, samples=samples)
            if self.second:
                more |= self._draw_second(self.second, camera, beside, (size[0] - split, size[1]), own, form, moving)
            both = (self.renderer.shown, self.second.renderer.shown) if self.second else (None, None)
            self._joiner.join(
                target, size, mode, divider=self.split_at(size[0]), line=max(1.0, size[1] / 720),
                shown=(both[0], both[1]) if mode == "difference" and both[0] and both[1] else None,
                limit=self.difference_limit,
            )  # fmt: skip
        self._note(start, moving)
        return more or moving or self._opening is not None

    def pick(self, column: int, row: int) -> tuple[float, float, float] | None:
        """x, y in the data's CRS and height (m) of what the latest picture shows at a window's physical pixel."""
        if self.renderer.shown is None or self._window is None:
            return None
        width, height = self.renderer.shown[0].size
        across = self.split_at(self._window[0]) if self.mode == "beside" else self._window[0]
        return self.renderer.pick(column * width // max(across, 1), row * height // self._window[1])

    def _pick_map(self, column: int, row: int) -> tuple[float, float, float] | None:
        return self.second.renderer.pick(column, row) if self.second else None

    # -- what a user changes -------------------------------------------------------------------------------------------

    def use(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Draw with another algorithm, or other settings of it."""
        self.renderer.use(name, values or {})
        self.algorithm, self.values = name, dict(values or {})

    def restyle(self, **changes: Any) -> None:
        """Change fields of the style."""
        self.style = replace(self.style, **changes)

    def exaggerate(self, factor: float) -> None:
        """Change the factor on all heights, from 0.01 to 100."""
        if not 0.01 <= factor <= 100:
            raise SettingsError(f"exaggeration: expected 0.01 to 100, got {factor:g}")
        self.scene = replace(self.scene, exaggeration=factor)

    def freeze(self, camera: Camera | None) -> None:
        """Keep the levels of detail and the culling of a camera, to look at them from outside; None: let go."""
        self.scene = replace(self.scene, lod_camera=camera)

    def limit_difference(self, metres: float) -> None:
        """Change the difference in height (m) that the strongest colour stands for, from 0.001 to 100000."""
        if not 0.001 <= metres <= 1e5:
            raise SettingsError(f"strongest colour: expected 0.001 to 100000 m, got {metres:g}")
        self.difference_limit = metres

    def sun_at(self, when: str | datetime) -> tuple[float, float]:
        """Azimuth from grid north and elevation (degrees) of the sun over the middle of the data at a time.

        Raises SettingsError for what is no time, and for data without a place on the earth.
        """
        try:
            moment = parse_time(when) if isinstance(when, str) else when
        except ValueError:
            got = repr(when) if str(when).strip() else "nothing"
            raise SettingsError(f"expected a time such as 2026-06-21 09:30 (UTC), got {got}") from None
        grid = self.data.grid
        x, y = (float(v) for v in grid.to_crs(grid.width / 2, grid.height / 2))
        longitude, latitude = self.ruler.to_degrees([x], [y])
        if longitude is None or latitude is None:
            raise SettingsError("expected data with a CRS: where this lies on the earth is unknown")
        azimuth, elevation = sun_position(float(longitude[0]), float(latitude[0]), moment)
        return (azimuth + self.ruler.north_turn(x, y)) % 360, elevation

    def set_sun_time(self, when: str) -> None:
        """Put the sun where it stands at a time; SettingsError where it is below the horizon then."""
        azimuth, elevation = self.sun_at(when)
        if elevation < 0:
            raise SettingsError(f"the sun is {-elevation:.0f}° below the horizon then; choose another time")
        self.restyle(sun=(azimuth, elevation))

    def compare(self, name: str, values: Mapping[str, Any] | None = None) -> None:
        """Show another algorithm, or other settings, right of the divider."""
        self._take(Second("compare", self.renderer.beside(name, values), _label(name, values)))

    def compare_data(self, data: Data) -> None:
        """Show another data set of the same CRS right of the divider, drawn by the same algorithm."""
        if data.grid.crs != self.data.grid.crs:
            raise SettingsError(f"expected data in {self.data.grid.crs or 'no CRS'}, got {data.grid.crs or 'none'}")
        clipmap = self.renderer.clipmap.settings
        renderer = Renderer(
            self.renderer.gpu, data.heights, data.colors, name=self.algorithm, settings=self.values, clipmap=clipmap
        )
        self._take(Second("compare", renderer, data.name, data))

    def show_map(self) -> None:
        """Show a map from above beside the view."""
        self._take(Second("map", self.renderer.beside("raycast"), "map"))

    def alone(self) -> None:
        """Show the first view only."""
        second, self.second = self.second, None
        if second:
            second.renderer.close()
            if second.data:
                second.data.close()

    def open(self, text: str, purpose: Literal["show", "compare"] = "show") -> None:
        """Begin to open what a user typed; `poll` takes it when it is there.

        Raises SettingsError where there is nothing to open or something is being opened already.
        """
        if self.opener is None:
            raise SettingsError("this window shows one data set only")
        if not text.strip():
            raise SettingsError("expected a path, an address or a GDAL name, got nothing")
        if self._opening:
            raise SettingsError("something is being opened already; wait for it")
        self.problem, self._purpose = "", purpose
        self._opening = Opening(self.opener, text.strip())

    @property
    def opening(self) -> bool:
        """Whether something is being opened."""
        return self._opening is not None

    @property
    def preparing(self) -> str:
        """What is worked on before everything is there as finely as it can be, in a few words; else ""."""
        parts = [p.progress for p in (self.data.heights, self.data.colors) if p and p.progress is not None]
        if parts:
            return f"preparing the data for fast access: {100 * min(parts):.0f} %"
        return "" if any(len(layer.atlas.resident) for layer in self.renderer.clipmap.layers) else "loading ..."

    def poll(self) -> None:
        """Take what has been opened in the meantime: into `opened`, or as the second view."""
        if self._opening is None or not self._opening.done:
            return
        found, self._opening = self._opening.result(), None
        if isinstance(found, OrogenError):
            self.problem = str(found)
        else:
            try:
                if self._purpose == "compare":
                    self.compare_data(found)
                else:
                    self.opened = self._following(found)
            except OrogenError as error:
                self.problem = str(error)
                found.close()

    def _following(self, data: Data) -> Session:
        # heights of the ramp's ends and the frozen camera belong to the data
        style, scene = replace(self.style, ramp_range=None), replace(self.scene, lod_camera=None)
        return Session(data, style, scene, quality=self.quality.settings, opener=self.opener, owned=True)

    def revive(self) -> bool:
        """Go on with another device where this one was lost; whether it was."""
        try:
            self.renderer.gpu.check()
            return False
        except DeviceLostError:
            second, self.second = self.second, None
            if second:
                second.renderer.close()
        self.data.revive()
        self.renderer = self.data.renderer
        self.renderer.use(self.algorithm, self.values)
        self._joiner = None
        if second:
            self._show_again(second)
        return True

    @property
    def retry_in(self) -> float | None:
        """Seconds until what could not be loaded is tried again; None where nothing has failed."""
        return self.renderer.retry_in

    def rest(self) -> None:
        """Give back what holds pictures, until the next one is drawn."""
        for renderer in (self.renderer, self.second.renderer if self.second else None):
            if renderer:
                renderer.release()
        if self._joiner:
            self._joiner.close()
            self._joiner = None

    def close(self) -> None:
        """Give back what the session made, and the data where it is its own."""
        if self._opening:
            found, self._opening = self._opening.result(), None
            if not isinstance(found, OrogenError):
                found.close()
        self.alone()
        if self._joiner:
            self._joiner.close()
            self._joiner = None
        if self._owned:
            self.data.close()

    # -- within --------------------------------------------------------------------------------------------------------

    def _take(self, second: Second) -> None:
        self.alone()
        self.second = second

    def _show_again(self, second: Second) -> None:
        """Make a second view that went with its device anew; where it cannot be, the first one stays alone."""
        lost = second.renderer.algorithm
        try:
            if second.data:
                self.compare_data(second.data)
            elif second.kind == "map":
                self.show_map()
            else:
                self.compare(
                    lost.name, {field.name: getattr(lost.settings, field.name) for field in fields(lost.settings)}
                )
        except OrogenError as error:
            log.warning("the second view is closed: %s", error)
            if second.data:
                second.data.close()
        if self.second:
            self.second.label = second.label

    def _draw_second(
        self,
        second: Second,
        camera: Camera,
        beside: Camera | None,
        room: tuple[int, int],
        own: tuple[int, int],
        form: str,
        moving: bool,
    ) -> bool:
        assert self._joiner
        if second.kind == "map":
            room = max(room[0], 1), room[1]
            camera = beside or self.map_camera(room[0] / room[1])
            scene = replace(self.scene, lod_camera=None)
            return second.renderer.draw_to(self._joiner.picture(1, room, form), camera, room, self.style, scene)
        scene = self._scene_of(second.renderer, moving)
        place, samples = self._joiner.picture(1, own, form), self.quality.samples if moving else 1
        return second.renderer.draw_to(place, camera, own, self.style, scene, samples=samples)

    def _scene_of(self, renderer: Renderer, moving: bool) -> Scene:
        """The scene, of fewer triangles where the frame time asks for it."""
        detail = max(self.quality.detail, least_detail(renderer.algorithm)) if moving else 1.0
        return replace(self.scene, coarseness=1 / detail)

    def _note(self, start: float, moving: bool) -> None:
        """Keep what the frame took, and let it decide on the next one's size."""
        now = time.perf_counter()
        gpu = dict(self.renderer.timer.results())
        spent = 1000 * (now - start)
        interval = 1000 * (now - self._last) if self._last else spent
        self._last = now if moving else 0.0
        detail, samples = 1.0, self.quality.samples if moving else 1
        if moving:
            # of the samples one is timed
            work, least = max(spent, samples * sum(gpu.values())), least_detail(self.renderer.algorithm)
            detail = max(self.quality.detail, least)
            self.quality.took(interval, work, geometry_share(gpu, work / samples), least)
        self._frames += 1
        if self._frames % STATISTICS_EVERY == 1:
            self._triangles = self.renderer.statistics().triangles
        layers = self.renderer.clipmap.layers
        self.history.add(
            Sample(
                frame=interval if moving else spent, cpu=spent, gpu=gpu, triangles=self._triangles,
                resident=sum(len(layer.atlas.resident) for layer in layers), queue=self.renderer.clipmap.pending,
                memory=self.renderer.gpu.memory.total, scale=self.quality.scale if moving else 1.0, detail=detail,
                samples=samples,
            )
        )  # fmt: skip


def _label(name: str, values: Mapping[str, Any] | None) -> str:
    return " ".join([name, *(f"{key}={value}" for key, value in (values or {}).items())])
