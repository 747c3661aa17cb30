import numpy as np
import pytest

import orogen

xarray = pytest.importorskip("xarray")

import orogen.xarray  # noqa: E402


@pytest.fixture
def heights():
    """A ramp that rises to the east, in UTM, by coordinates of the samples' centres."""
    x, y = 500000.0 + 20.0 * np.arange(40), 4000000.0 - 20.0 * np.arange(30)
    values = np.broadcast_to(100 + 2.0 * np.arange(40), (30, 40)).astype(np.float32)
    return xarray.DataArray(values, dims=("y", "x"), coords={"y": y, "x": x}, name="ramp")


def test_open_places_the_terrain_by_its_coordinates(heights):
    with heights.orogen.open(crs="EPSG:32611") as terrain:
        assert terrain.shape == (30, 40)
        assert terrain.bounds == (499990.0, 3999410.0, 500790.0, 4000010.0)
        for row, column in ((0, 0), (12, 30), (29, 39)):
            x, y = float(heights.x[column]), float(heights.y[row])
            assert terrain.height_at(x, y) == pytest.approx(float(heights[row, column]))


def test_render_is_what_the_terrain_renders(heights):
    picture = heights.orogen.render((64, 48), crs="EPSG:32611")
    with orogen.open(heights, crs="EPSG:32611") as terrain:
        assert np.array_equal(picture.color, terrain.render(size=(64, 48)).color)


def test_view_gives_the_terrain_back_where_no_window_can_be_opened(heights, monkeypatch):
    closed = []
    monkeypatch.setattr(orogen.Terrain, "close", lambda self: closed.append(self.name))

    def nothing(self, **options):
        raise orogen.OrogenError("no window")

    monkeypatch.setattr(orogen.Terrain, "view", nothing)
    with pytest.raises(orogen.OrogenError, match="no window"):
        heights.orogen.view(crs="EPSG:32611")
    assert len(closed) == 1


def test_view_takes_what_two_dimensions_need_only(heights):
    with pytest.raises(orogen.OrogenError, match="dimensions"):
        heights.expand_dims(time=3).orogen.open()
