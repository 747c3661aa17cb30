"""The server as pages meet it: what they are shown, who is let in, and what becomes of those that misbehave."""

# ruff: noqa: E402

import contextlib
import http.client
import io
import os
import socket
import struct
import sys
import time

import numpy as np
import pytest
from PIL import Image

import orogen
from orogen.errors import OutputError
from orogen.view import renderer
from orogen.view.controls import OrbitControls

websockets = pytest.importorskip("websockets")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from oracle.chromium import until
from oracle.pages import CLIENTS, SIZE, Page, at_rest, closing, hills, running
from orogen.view.serve import Server, ServerSettings, drawing
from orogen.view.serve.drawing import differs
from orogen.view.serve.gate import is_local


@pytest.fixture(scope="module")
def terrain():
    """Hills in UTM, 30 m apart."""
    with orogen.open(hills(), spacing=30.0, crs="EPSG:32611") as opened:
        yield opened


@pytest.fixture(scope="module")
def server(terrain):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(renderer, "STILL_SAMPLES", 2)
        with running(terrain) as opened:
            yield opened


@pytest.fixture
def page(server):
    until(lambda: not server._clients)
    with Page(server) as opened:
        opened.resize()
        yield opened


# -- what is shown -----------------------------------------------------------------------------------------------------


def test_the_picture_at_rest_is_the_terrain_s_own(page, server, terrain):
    picture = page.settle()
    start = OrbitControls(terrain.camera(), None, SIZE).camera
    expected = terrain.render(start, SIZE, samples=2).color[..., :3].astype(int)
    assert picture.shape == expected.shape
    assert np.abs(picture - expected).mean() < 2
    # nothing follows while nothing changes
    with pytest.raises(TimeoutError):
        page.next(1.0)


def test_events_move_one_page_and_not_the_others(page, server):
    before = page.settle()
    with Page(server) as other:
        other.resize()
        same = other.settle()
        page.wheel()
        after = page.settle()
        assert np.abs(after - before).mean() > 5
        assert np.abs(same - before).max() <= 2
        other.resize((200, 100))
        assert other.settle().shape == (100, 200, 3)


def test_pictures_are_bounded_however_large_the_page_says_it_is(page):
    page.resize((16384, 16384))
    shape = (16384, 16384)
    while shape[0] == 16384 or shape == SIZE[::-1]:
        shape = page.next().shape[:2]
    assert shape[0] * shape[1] <= 2560 * 1440 + 5000


def test_a_slow_page_gets_coarser_pictures_and_the_finest_at_rest(page, server):
    page.settle()
    (client,) = server._clients
    shapes = []
    while not shapes or shapes[-1] == SIZE[::-1]:
        page.wheel(-20.0)
        message = page.socket.recv(timeout=30)
        shapes.append(Image.open(io.BytesIO(message[8:])).size[::-1])
        time.sleep(0.6)
        page.tell("shown", index=int.from_bytes(message[:8], "big"))
        assert len(shapes) < 20
    assert client.pace.fineness.scale < 1
    assert page.settle().shape[:2] == SIZE[::-1]


def test_a_picture_that_only_gets_smoother_is_sent_once(page, server, monkeypatch):
    monkeypatch.setattr(renderer, "STILL_SAMPLES", 24)
    page.settle()
    (view,) = server._drawing._views.values()
    # on a small machine all samples take longer
    monkeypatch.setattr(drawing, "CALM", 60.0)
    page.wheel(-1.0)
    drawn, came = view.window.session._frames, []
    page.wheel(-1.0)
    while not came or not at_rest(server, view.client):
        with contextlib.suppress(TimeoutError):
            came.append(page.next(1.0))
    # most of the samples at rest are drawn for the last picture alone
    assert view.window.session._frames - drawn >= len(came) + 16
    assert np.abs(came[-1] - terrain_picture(view, 24)).mean() < 2


def terrain_picture(view, samples):
    """What a page's camera sees, drawn for itself."""
    window = view.window
    picture = window.session.renderer.render(window.controls.camera, SIZE, window.session.style, samples=samples)
    return picture.color[..., :3].astype(int)


def test_how_much_is_seen_at_once():
    rng = np.random.default_rng(0)
    one = rng.integers(0, 255, (90, 160, 4), np.uint8)
    assert not differs(one, one)
    smooth = np.clip(one.astype(int) + rng.integers(-9, 9, one.shape), 0, 255).astype(np.uint8)
    assert not differs(one, smooth)
    changed = one.copy()
    changed[20:50, 30:60, :3] ^= 128
    assert differs(one, changed)
    assert differs(one, one[:80])


# -- who is let in -----------------------------------------------------------------------------------------------------


def ask(server, path, **headers):
    """Status and body of a GET."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    try:
        connection.request("GET", path, headers={"Host": f"127.0.0.1:{server.port}", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read(), answer.headers
    finally:
        connection.close()


def test_the_page_and_its_parts_are_there_and_nothing_else(server):
    for name in ("", "page.js", "page.css", "renderview.js"):
        status, body, headers = ask(server, f"/{server.token}/{name}")
        assert (status, len(body) > 200) == (200, True), name
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert b"http://" not in body or name == "renderview.js"
    for name in ("../server.py", "..%2fserver.py", "page", "index.html", "/etc/passwd", "%2e%2e/", "socket/x", "\\x"):
        assert ask(server, f"/{server.token}/{name}")[:2] == (404, b""), name


@pytest.mark.parametrize(
    "path", ["/", "/{wrong}/", "/{wrong}/socket", "/page.js", "/{token}", "/{token}x/", "//", "/%c3%a9/"]
)
def test_a_wrong_token_is_refused_without_a_word(server, path):
    path = path.format(token=server.token, wrong="A" * len(server.token))
    assert ask(server, path)[:2] == (403, b"")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8000", "", "127.0.0.1.evil.example"])
def test_a_name_that_was_made_to_point_here_is_refused(server, host):
    assert ask(server, f"/{server.token}/", Host=host)[0] in (400, 403)


@pytest.mark.parametrize("origin", [None, "http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_a_socket_is_for_our_own_page_only(server, origin):
    with (
        pytest.raises(InvalidStatus) as caught,
        connect(f"{server.address.replace('http', 'ws')}socket", origin=origin),
    ):
        pass
    assert caught.value.response.status_code == 403


def test_tokens_are_long_and_never_the_same(terrain):
    with Server(terrain, ServerSettings(port=0)) as one, Server(terrain, ServerSettings(port=0)) as two:
        assert one.token != two.token
        assert len(one.token) >= 32
        assert one.address.startswith("http://127.0.0.1:")
        with pytest.raises(OutputError, match="another port"):
            Server(terrain, ServerSettings(port=one.port))


def test_other_interfaces_only_with_a_warning(terrain, caplog):
    with Server(terrain, ServerSettings(port=0)):
        assert not caplog.records
    with Server(terrain, ServerSettings(host="0.0.0.0", port=0)):
        assert "not encrypted" in caplog.text
    assert [is_local(host) for host in ("127.0.0.1", "::1", "localhost", "0.0.0.0", "::", "example")] == [True] * 3 + [
        False
    ] * 3


# -- crowds, and pages that misbehave ----------------------------------------------------------------------------------


def answer(page):
    """What becomes of a page, which breaks off then without a word."""
    try:
        page.resize()
        page.next()
        return "shown"
    except ConnectionClosed as error:
        return error.rcvd.reason
    finally:
        with contextlib.suppress(OSError):  # it is closed where there was no place
            page.socket.socket.shutdown(socket.SHUT_RDWR)


def test_twenty_pages_of_which_some_find_no_place_and_all_break_off(server):
    until(lambda: not server._clients)
    for _ in range(2):
        pages = [Page(server) for _ in range(20)]
        answers = [answer(page) for page in pages]
        assert answers[:CLIENTS] == ["shown"] * CLIENTS
        assert sum("places are taken" in text for text in answers) >= 20 - 2 * CLIENTS
        until(lambda: not server._clients and not server._drawing._views)
    with Page(server) as last:
        last.resize()
        last.next()


@pytest.mark.parametrize(
    "message", ["x", "[]", b"\x00", '{"type": "shown", "index": 99}', '{"type": "wheel"}', "x" * 5000]
)
def test_a_page_that_says_what_cannot_be_is_sent_away(server, message):
    until(lambda: len(server._clients) < CLIENTS)
    with Page(server) as page:
        page.socket.send(message)
        assert closing(lambda: page.socket.recv(timeout=20)).code in (4002, 1009)


def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads the memory that is held from /proc")
def test_a_page_that_never_reads_stalls_nobody_and_is_given_up(page, server):
    page.settle()
    alone = 0.0
    for _ in range(3):
        start = time.monotonic()
        page.wheel(-30.0)
        page.next()
        alone = max(alone, time.monotonic() - start)
    page.settle()
    deaf = Page(server, max_queue=1)
    deaf.resize((1200, 800))
    found = until(lambda: next((c for c in server._clients if c.size and c.size.width == 1200 and c._sent), None))
    before, longest = resident(), 0.0

    def pretend():
        # it even says that it has shown what it never took
        for index in list(found._sent):
            deaf.tell("shown", index=index)
        for _ in range(20):
            deaf.wheel(30.0)

    def look():
        nonlocal longest
        start = time.monotonic()
        page.wheel(-30.0)
        page.next()
        longest = max(longest, time.monotonic() - start)

    closing(pretend, look)
    # the deaf page's own frames, of 27 times the pixels, stand between
    assert longest < 3 + 5 * alone
    assert resident() - before < 100 << 20
    until(lambda: len(server._clients) == 1)
    page.wheel()
    page.settle()


def test_pages_that_vanish_in_the_middle_of_a_picture(page, server):
    page.settle()
    for _ in range(3):
        # one that takes little of a large picture, and whose machine is switched off then
        torn = Page(server, max_queue=1)
        torn.resize((1600, 1000))
        until(lambda: any(c.size and c.size.width == 1600 and c._sent for c in server._clients))
        torn.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        torn.socket.socket.close()
        page.wheel(-30.0)
        page.next()
        until(lambda: len(server._clients) == 1 and len(server._drawing._views) == 1)
    page.settle()


def test_one_view_that_fails_leaves_the_others(page, server, caplog):
    page.settle()
    with Page(server) as other:
        other.resize()
        other.next()
        (view,) = [v for v in server._drawing._views.values() if v.client is not next(iter(server._drawing._views))]
        view.window.session.draw = None
        end = closing(other.wheel, other.next)
        assert end.code == 4003
        assert "NoneType" not in end.reason
    page.wheel()
    page.settle()


def test_a_lost_device_is_replaced_for_all_pages(page, server, terrain):
    before = page.settle()
    with Page(server) as other:
        other.resize()
        other.settle()
        terrain.device.destroy()
        for one in (page, other):
            # the event that met the loss is lost with it, the view is not
            one.wheel()
            one.settle()
            one.wheel()
            assert np.abs(one.settle() - before).mean() > 5
        assert len({view.window.session.device for view in server._drawing._views.values()}) == 1


def test_a_server_ends_while_pages_look_on(terrain):
    with running(terrain) as server, Page(server) as page:
        page.resize()
        page.next()
        page.wheel()
        server.stop()
        server.close()
        assert closing(lambda: page.socket.recv(timeout=20)).code == 1001
    server.close()


# -- files -------------------------------------------------------------------------------------------------------------


def test_pages_can_name_no_file(terrain, tmp_path, monkeypatch):
    """Whatever the panel offers in a browser, no field takes a path, and bookmarks stay in memory."""
    pytest.importorskip("imgui_bundle")
    config = tmp_path / "config"
    monkeypatch.setenv("OROGEN_CONFIG_DIR", str(config))
    monkeypatch.setattr(renderer, "STILL_SAMPLES", 1)
    with running(terrain, panel=True) as server, Page(server) as page:
        page.resize((900, 900))
        page.settle()
        (view,) = server._drawing._views.values()
        assert view.window.session.files is False
        monkeypatch.setattr(view.window.panel.widgets, "section", lambda name, open: True)
        page.tell("key_down", key="b", modifiers=[])
        page.settle()
        widgets = view.window.panel.widgets
        assert {"sun azimuth (°)", "play", "goto"} & set(widgets.places)
        assert not {"Open", "other data", "save as", "load", "video", "write to"} & set(widgets.places)
        assert len(view.window.panel.bookmarks.cameras) == 1
    assert not config.exists()
