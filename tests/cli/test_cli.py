"""The command line as a user meets it: exit codes, what goes to which stream, one clear line on bad input."""

import importlib
import json
import logging
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import av
import numpy as np
import pytest
import rasterio
from PIL import Image

import orogen
from orogen import cli
from orogen.cli.options import CameraOptions, DataOptions, DrawingOptions, SceneOptions, StyleOptions
from orogen.errors import SettingsError
from orogen.shading.style import Style
from rasters import cone, write

PLACE = rasterio.Affine(30.0, 0.0, 500000.0, 0.0, -30.0, 4000000.0)


@pytest.fixture(scope="module")
def dem(tmp_path_factory):
    """A cone of 1000 m in the middle of 96 x 128 samples of 30 m, a hole in it."""
    path = tmp_path_factory.mktemp("dem") / "cone.tif"
    heights = cone(96, 128)
    heights[10:14, 10:14] = -9999
    return write(path, heights, transform=PLACE, nodata=-9999, tiled=True, blockxsize=64, blockysize=64)


def own_lines(err):
    """Lines of stderr, less what the graphics driver says about the environment."""
    return [line for line in err.splitlines() if line and "XDG_RUNTIME_DIR" not in line]


def process(*arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", "orogen", *map(str, arguments)], capture_output=True, text=True, check=False, **options
    )


# -- what the command is --------------------------------------------------------------------------------------------


def test_help_is_quick_and_lists_every_command():
    seconds = []
    for _ in range(3):
        before = os.times()
        done = process("--help")
        after = os.times()
        seconds.append(after.children_user + after.children_system - before.children_user - before.children_system)
    assert done.returncode == 0
    assert done.stderr == ""
    for command in [*cli.COMMANDS, "cache"]:
        assert re.search(rf"^\W*{command} ", done.stdout, re.MULTILINE)
    # of CPU time (which Windows does not tell of children): others may be at work
    assert min(seconds) < 0.6


def test_help_needs_no_heavy_library():
    code = "import sys; from orogen import cli; cli.run(['--help']); sys.stderr.write(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"numpy", "wgpu", "rasterio", "tensorstore", "av", "glfw", "PIL"}.isdisjoint(done.stderr.split())


def test_version(call):
    assert call("--version") == (0, f"{orogen.__version__}\n", "")


@pytest.mark.parametrize("command", [*cli.COMMANDS, "cache", "cache info"])
def test_every_command_has_help(call, command):
    code, out, err = call(*command.split(), "--help")
    assert (code, err) == (0, "")
    assert f"orogen {command}" in out
    if command in cli.COMMANDS:
        # its own page starts as its function's docstring does
        function = getattr(importlib.import_module(f"orogen.cli.{cli.COMMANDS[command][1]}"), command)
        first = function.__doc__.partition("\n\n")[0]
        assert " ".join(first.split()) in " ".join(out.split())


def test_help_names_every_algorithm_and_built_in_flight():
    from orogen.cli import parameters
    from orogen.lod import algorithms
    from orogen.view.flight import builtin_flights

    assert list(algorithms()) == parameters.ALGORITHMS
    assert sorted(builtin_flights()) == parameters.FLIGHTS


def test_completion_can_be_installed(call, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("SHELL", "/bin/bash")
    code, _, _ = call("--install-completion", "--shell", "bash")
    assert code == 0
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert any("render" in path.read_text() for path in written)


# -- bad command lines ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["rendr"], 'Unknown command "rendr". Did you mean "render"?'),
        (["render", "DEM"], "--output"),
        (["render", "DEM", "-o", "OUT", "--sise", "3x4"], "Did you mean --size"),
        (["render", "DEM", "-o", "OUT", "--size", "800"], "expected two whole numbers separated by 'x', got '800'"),
        (["render", "DEM", "-o", "OUT", "--size", "0x600"], "size: expected at least 1x1 pixels, got 0x600"),
        (["render", "DEM", "-o", "OUT", "--size", "8.5x6"], "expected two whole numbers"),
        (["render", "DEM", "-o", "OUT", "--look-at", "5"], "expected two numbers separated by ',', got '5'"),
        (["render", "DEM", "-o", "OUT", "--look-at", "nan,5"], "look_at: expected finite numbers"),
        (["render", "DEM", "-o", "OUT", "--distance", "-5"], "distance: expected more than 0 metres, got -5"),
        (["render", "DEM", "-o", "OUT", "--pitch", "95"], "pitch: expected -90 to 90 degrees, got 95"),
        (["render", "DEM", "-o", "OUT", "--fov", "0"], "fov: expected more than 0"),
        (["render", "DEM", "-o", "OUT", "--bounds", "0,0,1,1"], "bounds: expected a box that meets the data"),
        (["render", "DEM", "-o", "OUT", "--exaggeration", "0"], "exaggeration"),
        (["render", "DEM", "-o", "OUT", "--sun", "0,95"], "sun: expected an elevation of 0 to 90"),
        (["render", "DEM", "-o", "OUT", "--ramp", "terain"], "terrain"),
        (["render", "DEM", "-o", "OUT", "--ramp", "grey", "--plain"], "--plain and --ramp"),
        (["render", "DEM", "-o", "OUT", "--overlay", "wirefram"], "did you mean 'wireframe'?"),
        (["render", "DEM", "-o", "OUT", "--algorithm", "udlodd"], "did you mean udlod?"),
        (["render", "DEM", "-o", "OUT", "--algorithm", "udlod", "--set", "grid_sise=8"], "did you mean grid_size?"),
        (["render", "DEM", "-o", "OUT", "--set", "grid_size"], "--set: expected KEY=VALUE, got 'grid_size'"),
        (
            ["render", "DEM", "-o", "OUT", "--algorithm", "udlod", "--set", "grid_size=x"],
            "grid_size: expected int, got 'x'",
        ),
        (["render", "DEM", "-o", "OUT", "--samples", "0"], "samples: expected 1 to 256"),
        (["fly", "DEM", "-o", "OUT.mp4", "--flight", "orbits"], "built-in flights"),
        (["fly", "DEM", "-o", "OUT.mp4", "--fps", "0"], "fps: expected more than 0"),
        (["fly", "DEM", "-o", "OUT.mp4", "--duration", "-1"], "duration: expected more than 0 seconds"),
        (["info"], "expected a raster or --gpu, got neither"),
        (["bench", "nowhere"], "nowhere: expected a folder with test data"),
        (["bench", ".", "--only", "sped"], "--only: expected one of speed"),
    ],
)
def test_bad_command_lines_are_one_line_and_exit_code_2(call, dem, tmp_path, arguments, message):
    places = {"DEM": dem, "OUT": tmp_path / "out.png", "OUT.mp4": tmp_path / "out.mp4"}
    code, out, err = call(*[places.get(a, a) for a in arguments])
    assert code == 2
    assert out == ""
    lines = own_lines(err)
    assert len(lines) == 1
    assert lines[0].startswith("orogen: error: ")
    assert message in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_bad_places_are_told_before_anything_is_drawn(call, dem, tmp_path):
    (tmp_path / "there.png").write_bytes(b"kept")
    for arguments, message in [
        (["-o", tmp_path / "there.png"], "exists already"),
        (["-o", tmp_path / "no" / "a.png"], "does not exist"),
        (["-o", tmp_path / "a.jpg"], "expected the suffix .png"),
        (["-o", tmp_path / "a.png", "--depth", tmp_path / "a.png"], "expected the suffix .npy or .tif"),
        (["-o", tmp_path / "a.png", "--position", tmp_path / "no" / "a.npy"], "does not exist"),
    ]:
        start = time.process_time()
        code, out, err = call("render", dem, *arguments)
        assert (code, out) == (1, "")
        assert message in err
        assert time.process_time() - start < 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["there.png"]
    assert (tmp_path / "there.png").read_bytes() == b"kept"


def test_data_that_cannot_be_used(call, tmp_path):
    (tmp_path / "text.tif").write_text("not a raster")
    for name in ("missing.tif", "text.tif"):
        code, out, err = call("render", tmp_path / name, "-o", tmp_path / "out.png")
        assert (code, out) == (1, "")
        assert len(own_lines(err)) == 1
        assert name in err
    assert not (tmp_path / "out.png").exists()


def test_errors_nobody_foresaw_are_one_line_too(call, monkeypatch):
    def broken():
        raise RuntimeError("surprise")

    monkeypatch.setattr("orogen.source.cache.info", broken)
    code, _, err = call("cache", "info")
    assert code == 1
    assert own_lines(err) == [
        "orogen: error: internal error: RuntimeError: surprise; run again with -vv for the traceback"
    ]
    code, _, err = call("cache", "info", "-vv")
    assert code == 1
    assert "Traceback" in err


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ")
def test_control_c_ends_with_130_and_leaves_nothing(dem, tmp_path):
    command = ["fly", dem, "-o", tmp_path / "v.mp4", "--size", "320x180", "--duration", "1000"]
    # what a shell runs in the background ignores the signal, and hands that on
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    running = subprocess.Popen(
        [sys.executable, "-m", "orogen", *map(str, command)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    signal.signal(signal.SIGINT, before)
    end = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and running.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    assert list(tmp_path.iterdir()), running.stderr.read()
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=60)
    assert running.returncode == 130
    assert own_lines(err) == ["orogen: error: interrupted"]
    assert list(tmp_path.iterdir()) == []


def test_a_closed_pipe_is_no_drama():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "orogen", "cache", "info"], stdout=write, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(write)
    assert done.returncode == 1
    assert done.stderr == ""


# -- info and cache -------------------------------------------------------------------------------------------------


def test_info_tells_what_rasterio_does(call, dem):
    code, out, err = call("info", dem, "--json")
    assert (code, err) == (0, "")
    facts = json.loads(out)
    with rasterio.open(dem) as file:
        assert (facts["width"], facts["height"]) == (file.width, file.height)
        assert facts["bounds"] == list(file.bounds)
        assert facts["transform"] == list(file.transform)[:6]
        assert facts["crs"] == file.crs.to_string()
        assert (facts["nodata"], facts["type"]) == (file.nodata, file.dtypes[0])
        values = file.read(1, masked=True)
        assert facts["height_range"] == [float(values.min()), float(values.max())]
        low, high = facts["distortion"]
        assert 0.999 < low <= 1 <= high < 1.001
    code, out, _ = call("info", dem)
    assert code == 0
    assert "EPSG:32633" in out
    assert re.search(r"^height range +0, 1000$", out, re.MULTILINE)


def test_info_of_the_gpu(call):
    code, out, _ = call("info", "--gpu", "--json")
    assert code == 0
    gpu = json.loads(out)["gpu"]
    assert gpu["name"]
    assert "timestamp-query" in gpu["features"]
    code, out, _ = call("info", "--gpu")
    assert code == 0
    assert gpu["name"] in out
    code, _, err = call("info", "--gpu", "--adapter", "no such card")
    assert code == 2
    assert gpu["name"] in err


def test_cache(call, monkeypatch, tmp_path, dem):
    monkeypatch.setenv("OROGEN_CACHE_DIR", str(tmp_path / "cache"))
    assert json.loads(call("cache", "info", "--json")[1])["entries"] == []
    assert call("render", dem, "-o", tmp_path / "a.png", "--size", "16x9", "--samples", "1")[0] == 0
    found = json.loads(call("cache", "info", "--json")[1])
    assert found["path"] == str(tmp_path / "cache")
    assert len(found["entries"]) == 1
    assert found["size"] > 0
    assert "cone" in call("cache", "info")[1]
    code, out, _ = call("cache", "clear", "--json")
    assert code == 0
    assert json.loads(out)["freed"] == found["size"]
    assert json.loads(call("cache", "info", "--json")[1])["size"] == 0


# -- pictures and videos --------------------------------------------------------------------------------------------


def test_render_writes_picture_depth_and_position(call, dem, tmp_path):
    code, out, err = call(
        "render", dem, "-o", tmp_path / "a.png", "--depth", tmp_path / "d.npy", "--position", tmp_path / "p.npy",
        "--size", "96x64", "--look-at", "501920,3998560", "--distance", "4000", "--heading", "20", "--pitch", "-40",
        "--samples", "1", "--json",
    )  # fmt: skip
    assert (code, own_lines(err)) == (0, [])
    result = json.loads(out)
    assert result["size"] == [96, 64]
    assert result["camera"]["heading"] == 20
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (96, 64)
        assert len(np.unique(np.asarray(image).reshape(-1, 4), axis=0)) > 50
    depth, position = np.load(tmp_path / "d.npy"), np.load(tmp_path / "p.npy")
    assert (depth.dtype, depth.shape) == (np.float32, (64, 96))
    assert (position.dtype, position.shape) == (np.float64, (64, 96, 3))
    # the middle of the picture is the top of the cone, 4 km away
    assert depth[32, 48] == pytest.approx(4000, rel=0.02)
    assert position[32, 48] == pytest.approx([501935, 3998545, 990], abs=90)


def test_render_overwrites_only_when_told(call, dem, tmp_path):
    arguments = ["render", dem, "-o", tmp_path / "a.png", "--size", "32x18", "--samples", "1"]
    assert call(*arguments)[:2] == (0, f"{tmp_path / 'a.png'}\n")
    assert call(*arguments)[0] == 1
    assert call(*arguments, "--overwrite", "--algorithm", "raycast", "--plain")[0] == 0


def test_fly_writes_a_video(call, dem, tmp_path):
    code, out, err = call(
        "fly", dem, "--flight", "orbit", "-o", tmp_path / "v.mp4", "--size", "64x36", "--fps", "5", "--duration", "1",
        "--samples", "1", "--json",
    )  # fmt: skip
    assert (code, own_lines(err)) == (0, [])
    assert json.loads(out)["frames"] == 5
    with av.open(str(tmp_path / "v.mp4")) as container:
        assert len(list(container.decode(video=0))) == 5
    assert [path.name for path in tmp_path.iterdir()] == ["v.mp4"]


def test_demo_writes_its_pictures_and_a_video(call, dem, tmp_path, monkeypatch):
    from orogen.cli import demo, terrain

    monkeypatch.setattr(demo, "SIZE", (64, 36))
    monkeypatch.setattr(demo, "VIDEO_SIZE", (32, 18))
    monkeypatch.setattr(demo, "VIDEO_FPS", 2.0)
    monkeypatch.setattr(demo, "SAMPLES", 1)
    opened = []
    real = terrain.open_any
    monkeypatch.setattr(terrain, "open_any", lambda data, **options: opened.append(data) or real(dem, **options))
    for _ in range(2):  # a second demo replaces the first
        code, out, err = call("demo", "-o", tmp_path / "new" / "demo", "--json")
        assert (code, own_lines(err)) == (0, [])
    assert opened == ["synthetic", "synthetic"]
    written = [Path(name) for name in json.loads(out)["files"]]
    assert sorted(written) == sorted((tmp_path / "new" / "demo").iterdir())
    pictures = [path for path in written if path.suffix == ".png"]
    assert len(pictures) >= 4
    for path in pictures:
        with Image.open(path) as image:
            assert image.size == (64, 36)
            assert len(np.unique(np.asarray(image).reshape(-1, 4), axis=0)) > 20
    assert [path.suffix for path in written if path not in pictures] == [".mp4"]


def test_a_camera_below_the_ground_is_told(call, dem, tmp_path):
    code, _, err = call(
        "render", dem, "-o", tmp_path / "a.png", "--size", "16x9", "--samples", "1",
        "--look-at", "501920,3999000", "--distance", "450", "--heading", "0", "--pitch", "0",
    )  # fmt: skip
    assert code == 0
    assert re.search(r"warning: the camera is \d+ m below the ground; raise --distance", err)


def test_view_without_a_display_says_what_to_do(dem):
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if sys.platform != "linux":
        pytest.skip("other systems always have a display")
    done = process("view", dem, env=environment)
    assert done.returncode == 1
    assert "use orogen render or orogen fly instead" in own_lines(done.stderr)[-1]


# -- options --------------------------------------------------------------------------------------------------------


def test_options_speak_the_words_of_the_library():
    """Every option of the data, the camera and the scene is an argument of the same name, with the same default."""
    import inspect
    from dataclasses import fields

    from orogen.terrain import open_terrain
    from orogen.view.framing import frame_camera
    from orogen.view.renderer import Scene

    for options, function in [
        (DataOptions, open_terrain), (CameraOptions, frame_camera), (SceneOptions, Scene),
    ]:  # fmt: skip
        parameters = inspect.signature(function).parameters
        for field in fields(options):
            assert parameters[field.name].default == field.default


def test_style_options():
    assert StyleOptions().style() == Style()
    options = StyleOptions(
        ramp="terrain", range=(0.0, 9.0), sun=(10.0, 20.0), no_shadows=True, visibility=5.0, exposure=2.0,
        background="#102030", overlay=["wireframe", "levels"], contour_interval=7.0, error_limit=3.0,
    )  # fmt: skip
    assert options.style() == Style(
        color="ramp", ramp="terrain", ramp_range=(0.0, 9.0), sun=(10.0, 20.0), shadows=False, visibility=5.0,
        exposure=2.0, background="#102030", overlays=("wireframe", "levels"), contour_interval=7.0, error_limit_px=3.0,
    )  # fmt: skip
    assert StyleOptions(plain=True).style() == Style(color="plain")


def test_settings_by_name():
    assert DrawingOptions(set=["a=1", "b=x=y", "c="]).settings() == {"a": "1", "b": "x=y", "c": ""}
    with pytest.raises(SettingsError, match="KEY=VALUE"):
        DrawingOptions(set=["=1"]).settings()


def test_negative_numbers_are_values(call, dem, tmp_path):
    code, _, err = call("render", dem, "-o", tmp_path / "a.png", "--look-at", "-5,-6", "--range", "-10,-20")
    assert code == 2
    assert "ramp_range: expected the lowest height first" in err


# -- the log and the bench ------------------------------------------------------------------------------------------


def test_the_log_goes_to_stderr_as_loud_as_asked(capfd):
    from orogen.cli import console

    log = logging.getLogger("orogen")
    for verbose, quiet, expected in [
        (0, False, ["orogen: warning: w", "orogen: error: e"]),
        (1, False, ["orogen: i", "orogen: warning: w", "orogen: error: e"]),
        (2, False, ["orogen: debug: d", "orogen: i", "orogen: warning: w", "orogen: error: e"]),
        (0, True, ["orogen: error: e"]),
    ]:
        console.start(verbose, quiet)
        log.debug("d")
        log.info("i")
        log.warning("w")
        log.error("e")
        out, err = capfd.readouterr()
        assert (out, err.splitlines()) == ("", expected)


def test_progress_is_silent_without_a_terminal(capfd):
    from orogen.cli import console

    console.start(0, False)
    with console.progress() as report:
        report(0.5, "half")
    assert capfd.readouterr() == ("", "")


def test_json_has_no_nan(capfd):
    from orogen.cli import console

    console.show({"a": float("nan"), "b": np.float32(1.5), "c": (Path("x"), None, np.int64(3)), "d": True}, True)
    assert json.loads(capfd.readouterr().out) == {"a": None, "b": 1.5, "c": ["x", None, 3], "d": True}


def test_figures_against_their_targets():
    from orogen.cli.bench import table
    from orogen.cli.measure import Figure

    figures = [
        Figure("g", "low", 1.25, "s", 5),
        Figure("g", "high", 7.0, "s", 5),
        Figure("g", "none", None, "s", 5, "no data"),
        Figure("g", "plain", 3.0),
    ]
    assert [figure.met for figure in figures] == [True, False, None, None]
    assert table(figures)[1:] == [
        "g: low    1.25 s  <= 5 s  met",
        "g: high   7 s     <= 5 s  MISSED",
        "g: none   -       <= 5 s  no data",
        "g: plain  3",
    ]


def test_the_data_side_is_measured_alone(call, tmp_path, monkeypatch):
    from orogen.cli import measure

    asked = []
    for name in measure.MEASUREMENTS:
        monkeypatch.setitem(measure.MEASUREMENTS, name, lambda folder, report, name=name: asked.append(name) or [])
    assert call("bench", tmp_path, "--data")[0] == 0
    assert asked == ["pyramid", "large", "endless", "queries"]
    asked.clear()
    assert call("bench", tmp_path, "--data", "--only", "speed", "--only", "large")[0] == 0
    assert asked == ["speed", "large", "pyramid", "endless", "queries"]


def test_measured_processes_have_a_cache_of_their_own(tmp_path):
    from orogen.cli.measure import run_python
    from orogen.errors import OrogenError

    code = "import json, os; print(json.dumps([os.environ['OROGEN_CACHE_DIR']]))"
    assert run_python(["-c", code], tmp_path) == [str(tmp_path)]
    with pytest.raises(OrogenError, match="ended with 3: gone"):
        run_python(["-c", "import sys; sys.stderr.write('gone'); sys.exit(3)"], tmp_path)


def test_peak_memory_is_that_of_the_process_alone():
    code = (
        "import subprocess, sys; "
        "from orogen.cli.memory import peak_memory; "
        "block = bytearray(300_000_000); "
        "child = [sys.executable, '-c', 'from orogen.cli.memory import peak_memory; print(peak_memory())']; "
        "print(peak_memory(), subprocess.run(child, capture_output=True, text=True).stdout)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    own, child = done.stdout.split()
    if own == "None":
        pytest.skip("this system does not tell")
    assert 300e6 < int(own) < 400e6
    assert 5e6 < int(child) < 200e6
