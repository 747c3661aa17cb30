"""The pages of docs/algorithms say what the folders say."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def load() -> ModuleType:
    spec = importlib.util.spec_from_file_location("algorithm_pages", ROOT / "tools" / "algorithm_pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_pages_are_those_of_the_folders() -> None:
    module = load()
    pages = module.pages()
    old = [path.name for path, text in pages.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    assert not old, f"{', '.join(old)}: run python tools/algorithm_pages.py"
    # nothing is left of algorithms that are gone
    assert {path.name for path in (ROOT / "docs" / "algorithms").glob("*.md")} == {path.name for path in pages}


def test_tables_at_equal_triangles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A comparison at several numbers of triangles adds its tables, and leaves the other numbers as they are."""
    module = load()
    known = {name: module.algorithms()[name] for name in ("brute", "udlod")}
    monkeypatch.setattr(module, "algorithms", lambda: known)
    row = {"algorithm": "udlod", "error_mean": 0.125, "error_max": 9.5, "psnr": 40.0, "gpu": 1.0, "cpu": 0.5, "wall": 3}
    rows = [
        {**row, "target": 3000, "label": "udlod", "met": True, "triangles": 2990.4},
        {**row, "target": 3000, "label": "frostbite", "met": False, "triangles": 15238.0, "gpu": None},
        {**row, "target": 500_000, "label": "udlod", "met": False, "triangles": 300_100.0},
        {**row, "target": None, "label": "raycast", "met": None, "triangles": 0.0, "psnr": "inf"},
    ]
    plan = {
        "data": "/some/place/hills.png", "flight": {"name": "descent", "frames": 6}, "size": [1024, 768],
        "equal_triangles": [3000, 500_000], "prelit": True, "adapter": {"name": "a card"},
    }  # fmt: skip
    (tmp_path / "results.json").write_text(json.dumps({"plan": plan, "targets": rows, "entries": []}))
    numbers, folder = tmp_path / "numbers.json", tmp_path / "pages"
    numbers.write_text(json.dumps({"caption": "As before.", "entries": {"udlod": {"triangles": 7.0}}}))
    monkeypatch.setattr(module, "NUMBERS", numbers)
    monkeypatch.setattr(module, "PAGES", folder)
    monkeypatch.setattr(module.sys, "argv", ["algorithm_pages.py", str(tmp_path)])
    module.main()
    index = (folder / "index.md").read_text(encoding="utf-8")
    head = "triangles | error, mean (px) | error, largest (px) | PSNR (dB) | GPU (ms) | CPU (ms) |"
    for line in (
        "As before.", "| udlod | 7 | - | - | - | - | - |", "### 3,000 triangles", f"| algorithm | {head}",
        "| udlod | 2,990 | 0.125 | 9.5 | 40.0 | 1.000 | 0.500 |", "### 500,000 triangles", "### As they are",
        "| frostbite * | 15,238 | 0.125 | 9.5 | 40.0 | - | 0.500 |",
        "| raycast | 0 | 0.125 | 9.5 | ∞ | 1.000 | 0.500 |",
    ):  # fmt: skip
        assert line in index.splitlines()
    assert "over hills.png, 6 frames at 1024 x 768, drawn by a card" in index
    assert "--equal-triangles 3000,500000 --prelit" in index
    own = (folder / "udlod.md").read_text(encoding="utf-8").splitlines()
    assert f"| asked for | {head}" in own
    assert "| 500,000 * | 300,100 | 0.125 | 9.5 | 40.0 | 1.000 | 0.500 |" in own
    assert "At equal triangles" not in (folder / "brute.md").read_text(encoding="utf-8")
