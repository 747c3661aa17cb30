"""The parts of the server alone: messages, the queue of events, the choice of fineness, names of hosts."""

# ruff: noqa: E402

import contextlib
import io
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from orogen.errors import SettingsError

websockets = pytest.importorskip("websockets")

from orogen.view.serve import ServerSettings
from orogen.view.serve.client import MOST_EVENTS, Client
from orogen.view.serve.gate import Gate
from orogen.view.serve.messages import LONGEST, Shown, Size, parse
from orogen.view.serve.pace import BEST, LADDER, Pace, encode


def test_addresses_and_own_names_are_hosts_and_others_are_not():
    gate = Gate("t", "terrain.example")
    hosts = ["localhost", "LOCALHOST:9", "terrain.example:80", "[::1]:5", "127.0.0.1", "evil.example", "[", None]
    assert [gate.host_is_ours(host) for host in hosts] == [True] * 5 + [False] * 3


@pytest.mark.parametrize("wrong", [{"port": 70000}, {"clients": 0}, {"clients": 1000}, {"stall": 0}])
def test_settings_are_checked(wrong):
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        ServerSettings(**wrong)


def test_events_wait_in_a_short_queue():
    client = Client(lambda: None, None)
    for step in range(10000):
        client.hear(parse(json.dumps({"type": "wheel", "x": 1, "y": 1, "dx": 0, "dy": 1, "buttons": []})))
        client.hear(Size(100 + step, 100, 1.0))
    (event,) = client.take()
    assert event["dy"] == 10000
    key = parse('{"type": "key_down", "key": "a"}')
    for _ in range(MOST_EVENTS):
        client.hear(key)
    with pytest.raises(SettingsError, match="too many"):
        client.hear(key)
    assert len(client.take()) == MOST_EVENTS


# -- messages ----------------------------------------------------------------------------------------------------------


def test_messages_become_events():
    common = {"x": 1.5, "y": 2, "buttons": [1], "modifiers": ["Shift"]}
    moved = parse(json.dumps({"type": "pointer_move", "button": 1, "timestamp": 3, **common}))
    assert (moved["event_type"], moved["x"], moved["buttons"], moved["modifiers"]) == (
        "pointer_move", 1.5, (1,), ("Shift",),
    )  # fmt: skip
    assert parse('{"type": "resize", "pwidth": 800, "pheight": 600, "ratio": 2}') == Size(800, 600, 2.0)
    assert parse('{"type": "shown", "index": 7}') == Shown(7)
    assert parse('{"type": "char", "data": "ä"}')["data"] == "ä"
    assert parse('{"type": "char", "data": null}')["data"] == ""
    assert parse('{"type": "focus_in"}') is None


@pytest.mark.parametrize(
    "change",
    [
        {"x": None}, {"x": True}, {"x": 1e9}, {"y": "1"}, {"buttons": 1}, {"buttons": ["a"]}, {"buttons": [1] * 99},
        {"modifiers": ["Hyper"]}, {"modifiers": "Shift"}, {"button": 1.5}, {"button": -1}, {"type": "close_all"},
    ],
)  # fmt: skip
def test_odd_messages_are_refused(change):
    good = {"type": "pointer_down", "x": 1, "y": 1, "button": 1, "buttons": [], "modifiers": []}
    parse(json.dumps(good))
    with pytest.raises(SettingsError):
        parse(json.dumps({**good, **change}))


JSON = st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), lambda inner: st.lists(inner))


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(["pointer_move", "wheel", "resize", "shown", "key_down", "char", "focus_in", "?"]),
    st.dictionaries(st.sampled_from(["x", "y", "dx", "dy", "button", "buttons", "key", "index", "ratio"]), JSON),
)
def test_any_message_is_an_event_or_refused(kind, values):
    with contextlib.suppress(SettingsError):
        parse(json.dumps({"type": kind, **values}))


def test_deep_messages_are_refused():
    with pytest.raises(SettingsError):
        parse("[" * LONGEST)


# -- pace --------------------------------------------------------------------------------------------------------------


def flown(pace, rate, delay, count=200):
    """Seconds that pictures take over a link of so many bytes a second; the last quarter's."""
    times = []
    pace.distance = delay
    for _ in range(count):
        size = 300_000 * 0.7 ** LADDER.index(pace.fineness)
        times.append(delay + size / rate)
        pace.took(times[-1])
    return np.array(times[-count // 4 :])


@pytest.mark.parametrize("delay", [0.001, 0.4])
def test_pictures_get_as_coarse_as_the_link_asks_for_and_fine_again(delay):
    pace = Pace()
    flown(pace, 1e8, delay)
    assert pace.fineness == LADDER[0]
    slow = flown(pace, 1e6, delay)
    assert pace.fineness != LADDER[0]
    assert np.median(slow) - delay < 0.15
    flown(pace, 1e8, delay)
    assert pace.fineness == LADDER[0]


def test_every_step_of_the_ladder_is_smaller():
    rng = np.random.default_rng(1)
    smooth = np.cumsum(np.cumsum(rng.normal(size=(180, 320, 4)), 0), 1)
    picture = (
        (127 + 120 * smooth / np.abs(smooth).max() + rng.normal(size=smooth.shape) * 2).clip(0, 255).astype(np.uint8)
    )
    sizes = [len(encode(picture, step)) for step in (BEST, *LADDER)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < sizes[1] / 8
    decoded = np.asarray(Image.open(io.BytesIO(encode(picture, BEST)))).astype(int)
    assert np.abs(decoded - picture[..., :3]).mean() < 3
