"""What `orogen bench --only views` measures, on little data and few events."""

import numpy as np
import pytest

from orogen.cli import measure_views


def test_latency_of_window_and_browser(monkeypatch):
    pytest.importorskip("websockets")
    monkeypatch.setattr(measure_views, "SIZE", (160, 90))
    monkeypatch.setattr(measure_views, "EVENTS", 6)
    heights = np.add.outer(np.sin(np.arange(60) / 5), np.cos(np.arange(80) / 7)) * 100
    told = []
    figures = measure_views.measure(heights.astype(np.float32), lambda part, text: told.append(part), spacing=10.0)
    assert [figure.unit for figure in figures] == ["ms", "ms", "ms", "ms", "", "kB"]
    assert all(figure.value > 0 for figure in figures)
    assert figures[0].value <= figures[1].value
    assert figures[4].value >= 1
    assert told == [0.0, 0.5, 1.0]
