"""Ramps from files: colours at heights are those that GMT, QGIS and gdaldem give."""

from pathlib import Path

import numpy as np
import pytest

from orogen.errors import SettingsError
from orogen.shading.color import srgb_decode
from orogen.shading.ramp import RAMP_SIZE, ramp_color, ramp_range, ramp_table
from orogen.shading.ramp_file import read_ramp
from orogen.shading.style import Style

CPT = """# made for land and sea
# COLOR_MODEL = RGB
-4000 0 0 128 0 128 200 255
0 0 128 0 L
2000 255/255/255 4000 white ; snow
B black
N 127.5
"""
CPT = CPT.replace("0 0 128 0 L\n", "0 0 128 0 2000 200 150 100 L\n")
QML = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis><pipe><rasterrenderer type="singlebandpseudocolor"><rastershader>
<colorrampshader colorRampType="{kind}" classificationMode="1">
<item alpha="255" value="100" label="100" color="#000000"/><item alpha="255" value="200" color="#ff0000"/>
<item alpha="255" value="{last}" label="top" color="#ffffff"/>
</colorrampshader></rastershader></rasterrenderer></pipe></qgis>"""


def at(path: Path, height: float) -> np.ndarray:
    """8-bit colour that the ramp gives a height."""
    low, high = ramp_range(str(path)) or (0.0, 1.0)
    linear = ramp_color(ramp_table(str(path)), (height - low) / (high - low))
    # the table's entries are in linear light
    return np.abs(linear)


def close(path: Path, height: float, color: tuple[int, int, int]) -> bool:
    return bool(np.allclose(at(path, height), srgb_decode(np.array(color) / 255), atol=0.02))


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_slices_of_a_cpt_and_the_steps_between_them(tmp_path: Path) -> None:
    path = write(tmp_path, "land.cpt", CPT)
    assert ramp_range(str(path)) == (-4000.0, 4000.0)
    for height, color in [(-4000, (0, 0, 128)), (-2000, (64, 100, 192)), (1000, (100, 139, 50)), (3000, (255,) * 3)]:
        assert close(path, height, color), height
    # within an entry of the step
    step = 8000 / (RAMP_SIZE - 1)
    assert close(path, -2 * step, (126, 197, 254)), "the shore's water"
    assert close(path, 2 * step, (6, 129, 3)), "the shore's land"


def test_a_cpt_in_hsv_and_with_a_range_of_its_own(tmp_path: Path) -> None:
    path = write(tmp_path, "hue.cpt", "# COLOR_MODEL = +HSV\n# RANGE = 0/500\n0 0 1 1 1 120 1 1\n")
    assert ramp_range(str(path)) == (0.0, 500.0)
    assert close(path, 0, (255, 0, 0))
    assert close(path, 500, (0, 255, 0))


def test_a_hinge_stays_at_zero(tmp_path: Path) -> None:
    path = write(tmp_path, "hinge.cpt", "# SOFT_HINGE\n# RANGE = -100/900\n-1 blue 0 white\n0 white 1 red\n")
    ramp = read_ramp(path)
    np.testing.assert_allclose(ramp.heights, [-100, 0, 0, 900])


def test_a_cpt_from_zero_to_one_spans_the_data(tmp_path: Path) -> None:
    path = write(tmp_path, "any.cpt", "0 black 1 white\n")
    assert ramp_range(str(path)) is None


def test_a_style_of_qgis_interpolated(tmp_path: Path) -> None:
    path = write(tmp_path, "style.qml", QML.format(kind="INTERPOLATED", last=300))
    assert ramp_range(str(path)) == (100.0, 300.0)
    assert close(path, 150, (128, 0, 0))
    assert close(path, 250, (255, 128, 128))


def test_a_style_of_qgis_in_classes(tmp_path: Path) -> None:
    path = write(tmp_path, "classes.qml", QML.format(kind="DISCRETE", last="inf"))
    ramp = read_ramp(path)
    # up to 100 black, up to 200 red, above white
    np.testing.assert_array_equal(ramp.heights, [100, 100, 200, 200])
    np.testing.assert_array_equal(ramp.colors[1:3], [[1, 0, 0]] * 2)


def test_the_text_of_gdaldem_in_metres_and_in_per_cent(tmp_path: Path) -> None:
    metres = write(tmp_path, "a.txt", "nv 0 0 0 0\n2000 white\n0,0,128,0  # grass\n")
    assert ramp_range(str(metres)) == (0.0, 2000.0)
    assert close(metres, 0, (0, 128, 0))
    percent = write(tmp_path, "b.txt", "0% 0 0 255\n100% 255 0 0\n")
    assert ramp_range(str(percent)) is None
    assert close(percent, 1.0, (255, 0, 0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.cpt", "0 black 1\n", "line 1: expected 'low colour high colour'"),
        ("b.cpt", "0 nocolour 1 white\n", "line 1: expected a colour, got 'nocolour'"),
        ("c.cpt", "5 black 1 white\n", "from the lowest to the highest"),
        ("d.cpt", "# empty\n", "at least two heights"),
        ("e.cpt", "0 300 0 0 1 0 0 0\n", "0 to 255"),
        ("f.qml", "<qgis><renderer/></qgis>", "colorrampshader"),
        ("g.qml", "no xml", "no style of QGIS"),
        ("h.txt", "0 0 0 0\n50% 1 1 1\n", "all in metres or all in per cent"),
        ("i.txt", "low 0 0 0\n1 1 1 1\n", "line 1: expected a number, got 'low'"),
    ],
)
def test_bad_files_are_refused_with_file_and_line(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = write(tmp_path, name, text)
    with pytest.raises(SettingsError, match=message) as caught:
        Style(ramp=str(path))
    assert name in str(caught.value)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"none\.cpt cannot be read"):
        Style(ramp=str(tmp_path / "none.cpt"))
