"""The pages of docs/algorithms say what the folders say."""

from __future__ import annotations

import importlib.util
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_pages_are_those_of_the_folders() -> None:
    spec = importlib.util.spec_from_file_location("algorithm_pages", ROOT / "tools" / "algorithm_pages.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    pages = module.pages()
    old = [path.name for path, text in pages.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    assert not old, f"{', '.join(old)}: run python tools/algorithm_pages.py"
    # nothing is left of algorithms that are gone
    assert {path.name for path in (ROOT / "docs" / "algorithms").glob("*.md")} == {path.name for path in pages}
