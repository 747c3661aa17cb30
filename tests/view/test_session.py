import numpy as np
import pytest

import orogen
from orogen.errors import SettingsError
from orogen.view.overlay import projected
from orogen.view.session import Session
from orogen.view.split import Joiner

SIZE = (120, 80)
RED, BLUE = (226, 183, 182), (181, 195, 224)
"""Half way from white to the ends of the scale of differences, in sRGB."""


@pytest.fixture
def session(terrain):
    made = Session(terrain)
    yield made
    made.close()
    terrain.use()


class Target:
    """A texture to draw to, and to look at."""

    def __init__(self, gpu, size=SIZE):
        self.gpu, self.size = gpu, size
        self.texture = gpu.texture("target", size, "rgba8unorm", "RENDER_ATTACHMENT|COPY_SRC", "view")

    def show(self, session, camera, **options):
        for _ in range(60):
            if not session.draw(self.texture.view(), camera, self.size, **options):
                break
        return self.gpu.read_texture(self.texture).result()[..., :3].astype(int)


@pytest.fixture
def target(session):
    made = Target(session.renderer.gpu)
    yield made
    made.texture.destroy()


def test_both_sides_of_the_divider_are_what_each_algorithm_draws(session, terrain, target):
    camera = session.camera
    session.restyle(overlays=("levels",))
    left = target.show(session, camera)
    session.use("cdlod", {"pixels_per_quad": 16})
    right = target.show(session, camera)
    session.use("raycast")
    session.compare("cdlod", {"pixels_per_quad": 16})
    session.divider = 0.4
    both = target.show(session, camera)
    assert np.abs(both[:, :46] - left[:, :46]).max() <= 2
    assert np.abs(both[:, 50:] - right[:, 50:]).max() <= 2
    assert np.abs(left - right).max() > 10
    assert len(session.renderer.clipmap._views) == 2
    session.alone()
    assert len(session.renderer.clipmap._views) == 1


def test_two_epochs_and_their_difference_in_height(session, terrain, target):
    rise = 40.0
    heights = terrain.heights.source.read(slice(0, 96), slice(0, 128))
    later = heights + np.where(np.arange(128) < 64, rise, -rise).astype(np.float32)
    other = orogen.open(later, spacing=30.0, crs="EPSG:32611")
    session.compare_data(other)
    session.difference, session.difference_limit, session.divider = True, 2 * rise, 0.05
    camera = session.whole(heading=0.0, pitch=-60.0)
    # up to the last row and column, where there is a neighbour on one side only
    edges = target.show(session, session.whole(pitch=-89.0, distance=800.0))
    for edge, inner in ((edges[-1, 8:], edges[-2, 8:]), (edges[1:-1, -1], edges[1:-1, -2])):
        assert np.abs(edge - inner).max() < 30
    picture = target.show(session, camera)
    # half of the limit is half way to the end colours: red in the west, which is higher, blue in the east
    frame = session.renderer.shown[0]
    for tx, ty, color in ((8.0, 48.0, RED), (30.0, 60.0, RED), (90.0, 20.0, BLUE), (120.0, 70.0, BLUE)):
        x, y = (float(v) for v in terrain.grid.to_crs(tx, ty))
        at = projected(frame, np.array([[x, y, terrain.height_at(x, y)]]), SIZE)[0]
        assert picture[int(at[1]), int(at[0])] == pytest.approx(color, abs=14)


def test_data_of_another_crs_is_refused(session):
    with orogen.open(np.zeros((8, 9), np.float32), spacing=1.0) as other:
        with pytest.raises(SettingsError, match="expected data in EPSG:32611, got none"):
            session.compare_data(other)
        assert session.second is None


def test_a_moving_picture_is_coarser_and_fits_the_window(session, target):
    fine = target.show(session, session.camera)
    session.quality._step = 4
    session.draw(target.texture.view(), session.camera, SIZE, moving=True)
    assert session.renderer.shown[0].size == (60, 40)
    moving = session.renderer.gpu.read_texture(target.texture).result()[..., :3].astype(int)
    assert np.abs(moving - fine).mean() < 12
    # what lies under a pixel of the window is the same
    x, y, _ = session.pick(60, 40)
    again = target.show(session, session.camera)
    assert session.pick(60, 40)[:2] == pytest.approx((x, y), abs=90)
    assert np.array_equal(again, fine)


def test_frame_times_are_kept(session, target):
    target.show(session, session.camera)
    assert session.history.latest.cpu > 0
    assert len(session.history.series("triangles")) > 1
    session.use("cdlod")
    for _ in range(20):
        target.show(session, session.camera)
    assert session.history.latest.triangles > 100
    if session.renderer.gpu.features & {"timestamp-query"}:
        assert "shade" in session.history.passes()


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, 1e6])
def test_bad_exaggeration(session, factor):
    with pytest.raises(SettingsError, match=r"exaggeration: expected 0\.01 to 100"):
        session.exaggerate(factor)
    assert session.scene.exaggeration == 1.0


def test_opening_says_why_not(session):
    with pytest.raises(SettingsError, match="one data set only"):
        session.open("other.tif")
    session.opener = lambda text: 1 / 0
    with pytest.raises(SettingsError, match="got nothing"):
        session.open("  ")
    session.open("other.tif")
    while session.opening:
        session.poll()
    assert "other.tif: cannot be opened: ZeroDivisionError" in session.problem


def test_pictures_keep_their_texture_until_their_size_changes(session):
    joiner = Joiner(session.renderer.gpu)
    used = session.renderer.gpu.memory.by_category()["view"]
    for _ in range(3):
        joiner.picture(0, (64, 32), "rgba8unorm")
    assert session.renderer.gpu.memory.by_category()["view"] == used + 64 * 32 * 4
    joiner.picture(0, (32, 32), "rgba8unorm")
    assert session.renderer.gpu.memory.by_category()["view"] == used + 32 * 32 * 4
    joiner.close()
