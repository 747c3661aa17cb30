"""Algorithms are folders: found without being named anywhere, and asked for by name."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

import orogen.lod
from orogen.errors import SettingsError
from orogen.lod import DEFAULT, algorithm, algorithms, make_settings

LOD = Path(orogen.lod.__file__).parent
ADDED = '''
from dataclasses import dataclass
from orogen.lod.contract import Algorithm

@dataclass(frozen=True)
class Settings:
    """Of the algorithm."""
    steps: int = 3
    """How many."""
    share: float | None = 0.5
    """How much."""
    fast: bool = False
    """Whether to hurry."""
    label: str = "x"
    """What it is called."""

class Plain(Algorithm):
    """Does nothing."""
    name = "plain"
    Settings = Settings
    def view(self):
        raise NotImplementedError
'''


@pytest.fixture
def plain(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One more folder with an algorithm."""
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "__init__.py").write_text(ADDED)
    monkeypatch.setattr(orogen.lod, "__path__", [*orogen.lod.__path__, str(tmp_path)])
    algorithms.cache_clear()
    yield
    algorithms.cache_clear()


def test_every_folder_is_found() -> None:
    folders = sorted(path.parent.name for path in LOD.glob("*/__init__.py"))
    assert list(algorithms()) == folders
    assert {"udlod", "raycast"} <= set(folders)
    assert DEFAULT in folders


def test_every_folder_holds_shaders_and_a_description() -> None:
    for name in algorithms():
        assert list((LOD / name).glob("*.wgsl")), name
        text = (LOD / name / "README.md").read_text()
        assert text.startswith("# "), name
        # the settings table names every field
        for field in dataclasses.fields(algorithm(name).Settings):
            assert f"`{field.name}`" in text, (name, field.name)


def test_every_setting_has_a_docstring() -> None:
    for name, kind in algorithms().items():
        source = inspect.getsource(kind.Settings)
        for field in dataclasses.fields(kind.Settings):
            after = source.split(f"    {field.name}: ", 1)[1].split("\n", 1)[1].lstrip()
            assert after.startswith('"""'), (name, field.name)
        assert kind.Settings.__dataclass_params__.frozen


def test_a_new_folder_needs_nothing_else(plain: None) -> None:
    assert "plain" in algorithms()
    assert list(algorithms()) == sorted(algorithms())
    settings = make_settings("plain", {"steps": "5", "share": "none", "fast": "true", "label": "7"})
    assert dataclasses.astuple(settings) == (5, None, True, "7")
    assert make_settings("plain", {"share": "0.25", "fast": False}).share == 0.25


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"steps": "2.5"}, "plain steps: expected int, got '2.5'"),
        ({"share": "much"}, r"plain share: expected float \| None, got 'much'"),
        ({"fast": "maybe"}, "plain fast: expected bool, got 'maybe'"),
        ({"steps": "none"}, "plain steps: expected int, got 'none'"),
        ({"step": "2"}, "did you mean steps"),
        ({"zzz": "2"}, "expected one of steps, share, fast, label, got 'zzz'$"),
    ],
)
def test_values_that_cannot_be_read_are_named(plain: None, values: dict[str, str], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        make_settings("plain", values)


def test_an_unknown_algorithm_names_those_there_are() -> None:
    with pytest.raises(SettingsError, match=r"expected one of .*raycast, .*udlod, got 'udlodd'; did you mean udlod"):
        algorithm("udlodd")
    with pytest.raises(SettingsError, match=r"got 'voxels'$"):
        make_settings("voxels", {})


def test_an_algorithm_without_settings_takes_none() -> None:
    with pytest.raises(SettingsError, match="expected one of none, got 'speed'"):
        make_settings("raycast", {"speed": "1"})
