"""Fixtures of the tests of sources."""

from __future__ import annotations

import pytest

from orogen.source import survey


@pytest.fixture(params=[True, False], ids=["in memory", "by window"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read files whole, as small ones are, and by window, as large ones are."""
    if not request.param:
        monkeypatch.setattr(survey, "IN_MEMORY", 0)
