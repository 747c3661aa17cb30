"""`orogen serve` as a user meets it: the command, and a real browser."""

# ruff: noqa: E402

import contextlib
import http.client
import io
import itertools
import os
import re
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rasterio
from PIL import Image

import orogen
from orogen.view import renderer

websockets = pytest.importorskip("websockets")

from oracle import chromium
from oracle.chromium import until
from oracle.pages import CLIENTS, Page, at_rest, hills, running


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


# -- the command -------------------------------------------------------------------------------------------------------


def test_the_command_prints_an_address_that_works_and_ends_on_ctrl_c(tmp_path):
    path = tmp_path / "flat.tif"
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=64,
        height=64,
        count=1,
        dtype="float32",
        transform=rasterio.Affine(10, 0, 0, 0, -10, 0),
    ) as file:
        file.write(np.zeros((64, 64), np.float32), 1)
    command = [sys.executable, "-m", "orogen", "serve", str(path), "--port", "0"]
    # as users have it: Python keeps what goes into a pipe until it is told otherwise
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    environment["PYTHONFAULTHANDLER"] = "1"
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # one that stays silent says where all of its threads are
    guard = threading.Timer(
        90, process.kill if sys.platform == "win32" else lambda: process.send_signal(signal.SIGABRT)
    )
    guard.start()
    try:
        address = process.stdout.readline().strip()
        assert address, process.stderr.read()
        port, token = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/([\w-]{32})/", address).groups()
        connection = http.client.HTTPConnection("127.0.0.1", int(port), timeout=20)
        connection.request("GET", f"/{token}/")
        assert b"<canvas" in connection.getresponse().read()
        if sys.platform != "win32":
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
            assert "orogen: error" not in process.stderr.read()
    finally:
        guard.cancel()
        process.kill()
        process.communicate()


def test_without_the_extra_the_command_says_how_to_get_it():
    code = "import sys; sys.modules['websockets'] = None; from orogen import cli; sys.exit(cli.run(['serve', 'x']))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert "pip install 'orogen[serve]'" in done.stderr


# -- a real browser ----------------------------------------------------------------------------------------------------


@pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")
def test_a_browser_shows_the_terrain_and_flies(server, tmp_path):
    until(lambda: not server._clients)
    with chromium.Browser(tmp_path / "browser", (480, 320)) as browser:

        def shown():
            return int(browser.run("document.documentElement?.dataset.shown || 0"))

        def settled(count):
            until(lambda: shown() > count and all(at_rest(server, client) for client in server._clients))
            time.sleep(0.2)
            return np.asarray(Image.open(io.BytesIO(browser.picture())).convert("RGB")).astype(int), shown()

        browser.open(server.address)
        until(shown, 60)
        first, count = settled(0)
        assert first.std() > 5
        assert browser.run("document.getElementById('notice').hidden")
        browser.drag((240, 130), (210, 170))
        dragged, count = settled(count)
        browser.mouse("mouseWheel", 220, 160, deltaX=0, deltaY=-300)
        zoomed, count = settled(count)
        # Tab changes the controls and keeps the keyboard, so W flies
        browser.press("Tab")
        view = next(iter(server._drawing._views.values()))
        until(lambda: type(view.window.controls).__name__ == "FlyControls")
        browser.ask("Input.dispatchKeyEvent", type="keyDown", key="w", windowsVirtualKeyCode=87)
        camera = view.window.controls.camera
        until(lambda: abs(view.window.controls.camera.y - camera.y) > 300)
        # a page that loses the keyboard lets go of what is held
        browser.run("window.dispatchEvent(new Event('blur'))")
        until(lambda: not view.window.controls.moving)
        flown, count = settled(count)
        for before, after in itertools.pairwise((first, dragged, zoomed, flown)):
            assert (np.abs(after - before).max(axis=-1) > 4).mean() > 0.05
        assert not browser.faults
        browser.open(server.address.replace(server.token, "x" * 32))
        until(lambda: browser.run("document.readyState") == "complete" and not server._clients)
        assert browser.run("document.querySelector('canvas') === null")


@pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")
def test_a_tab_that_was_suspended_is_connected_again(server, tmp_path):
    until(lambda: not server._clients)
    with chromium.Browser(tmp_path / "browser", (320, 240)) as browser, Page(server) as other:
        other.resize()
        other.settle()

        def ours():
            return next((c for c in server._clients if c.size and c.size.width == 320 and not c.gone), None)

        browser.open(server.address)
        before = until(ours, 60)
        until(lambda: at_rest(server, before))
        # browsers break the connections of tabs that they suspend; others go on
        browser.ask("Page.setWebLifecycleState", state="frozen")
        other.wheel(-30.0)
        other.settle()
        browser.ask("Page.setWebLifecycleState", state="active")
        after = until(lambda: ours() is not before and ours())
        until(lambda: at_rest(server, after) and browser.run("document.getElementById('notice').hidden"))
        # one that is sent away is told so, and stays away
        after.fail("this view has failed")
        until(lambda: not browser.run("document.getElementById('again').hidden"))


@pytest.mark.skipif(chromium.find() is None, reason="no Chromium here")
def test_a_browser_that_finds_no_place_says_so(server, tmp_path):
    until(lambda: not server._clients)
    with contextlib.ExitStack() as stack:
        for _ in range(CLIENTS):
            stack.enter_context(Page(server))
        browser = stack.enter_context(chromium.Browser(tmp_path / "browser", (480, 320)))
        browser.open(server.address)
        until(lambda: "places are taken" in (browser.run("document.getElementById('text')?.textContent") or ""))
        assert not browser.run("document.getElementById('again').hidden")
