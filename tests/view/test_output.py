import builtins
import os

import av
import numpy as np
import pytest
import rasterio
from PIL import Image

from orogen.errors import OutputError, SettingsError
from orogen.view import video as video_module
from orogen.view.image import write_color, write_depth, write_position
from orogen.view.output import check_output, publish
from orogen.view.video import QUALITIES, Encoder, VideoWriter


def picture(height=37, width=53, channels=3, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), np.uint8)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("height", [1, 37])
def test_png_holds_the_pixels(tmp_path, channels, height):
    color = picture(height, channels=channels)
    write_color(tmp_path / "a.png", color)
    with Image.open(tmp_path / "a.png") as image:
        assert image.info["srgb"] == 0
        assert np.array_equal(np.asarray(image), color)


def test_a_view_of_an_array_is_written_too(tmp_path):
    color = picture()[::-2, ::-1]
    write_color(tmp_path / "a.png", color)
    with Image.open(tmp_path / "a.png") as image:
        assert np.array_equal(np.asarray(image), color)


@pytest.mark.parametrize("name", ["d.npy", "d.tif"])
def test_depth_round_trip(tmp_path, name):
    depth = np.random.default_rng(1).uniform(1, 1e6, (30, 41)).astype(np.float32)
    depth[:5] = np.nan
    write_depth(tmp_path / name, depth)
    if name.endswith("npy"):
        read = np.load(tmp_path / name)
    else:
        with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
            file = rasterio.open(tmp_path / name)
        with file:
            assert np.isnan(file.nodata)
            read = file.read(1)
    assert read.dtype == np.float32
    assert np.array_equal(read, depth, equal_nan=True)


def test_position_round_trip(tmp_path):
    position = np.random.default_rng(2).uniform(-1e7, 1e7, (5, 6, 3))
    write_position(tmp_path / "p.npy", position)
    assert np.array_equal(np.load(tmp_path / "p.npy"), position)


@pytest.mark.parametrize(
    ("write", "name", "array"),
    [
        (write_color, "a.png", np.zeros((4, 4, 3))),
        (write_color, "a.png", np.zeros((4, 4), np.uint8)),
        (write_color, "a.png", np.zeros((0, 4, 3), np.uint8)),
        (write_depth, "a.npy", np.zeros((4, 4, 1))),
        (write_position, "a.npy", np.zeros((4, 4))),
    ],
)
def test_wrong_shapes_are_refused(tmp_path, write, name, array):
    with pytest.raises(SettingsError, match="expected"):
        write(tmp_path / name, array)
    assert list(tmp_path.iterdir()) == []


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "there.png").write_bytes(b"kept")
    (tmp_path / "folder.png").mkdir()
    for name, message in [
        ("a.jpg", "suffix"),
        ("a", "suffix"),
        ("no/a.png", "does not exist"),
        ("there.png", "exists already"),
        ("folder.png", "folder"),
        ("there.png/a.png", "does not exist"),
    ]:
        with pytest.raises(OutputError, match=message):
            write_color(tmp_path / name, picture())
        with pytest.raises(OutputError, match=message):
            check_output(tmp_path / name, (".png",))
    assert (tmp_path / "there.png").read_bytes() == b"kept"
    write_color(tmp_path / "there.png", picture(), overwrite=True)
    with Image.open(tmp_path / "there.png") as image:
        assert image.size == (53, 37)


def test_a_folder_without_permission(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # tests may run as root, whom permissions do not stop
    with pytest.raises(OutputError, match="not writable"):
        check_output(tmp_path / "a.png", (".png",))


def write_then(path, step):
    with publish(path, (".png",)) as temporary:
        temporary.write_bytes(b"mine")
        step()


def test_publish_leaves_nothing_after_a_failure(tmp_path):
    def fail(error):
        raise error

    with pytest.raises(OutputError, match="No space left"):
        write_then(tmp_path / "a.png", lambda: fail(OSError(28, "No space left on device")))
    with pytest.raises(KeyboardInterrupt):
        write_then(tmp_path / "a.png", lambda: fail(KeyboardInterrupt()))
    assert list(tmp_path.iterdir()) == []


def test_publish_does_not_replace_what_appeared_meanwhile(tmp_path):
    path = tmp_path / "a.png"
    with pytest.raises(OutputError, match="exists already"):
        write_then(path, lambda: path.write_bytes(b"theirs"))
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"theirs"


def gradient(i, width, height):
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([255 * x / width, 255 * y / height, np.full(x.shape, 40.0 + 10 * i)], axis=-1).astype(np.uint8)


@pytest.mark.parametrize("suffix", [".mp4", ".webm", ".mkv"])
def test_video_round_trip(tmp_path, suffix):
    path = tmp_path / f"v{suffix}"
    frames = [gradient(i, 161, 121) for i in range(7)]
    with VideoWriter(path, (161, 121), fps=24) as video:
        for i, frame in enumerate(frames):
            video.write(np.dstack([frame, np.full(frame.shape[:2], i, np.uint8)]))
        assert not path.exists()
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        context = stream.codec_context
        assert stream.average_rate == 24
        lossless = suffix == ".mkv"
        assert (context.width, context.height) == ((161, 121) if lossless else (162, 122))
        assert (context.color_primaries, context.color_trc) == (1, 13)
        if not lossless:
            assert (context.pix_fmt, context.colorspace, context.color_range) == ("yuv420p", 1, 1)
        decoded = [frame for packet in container.demux(stream) for frame in packet.decode()]
    assert len(decoded) == len(frames)
    for got, expected in zip(decoded, frames, strict=True):
        if lossless:
            assert np.array_equal(got.to_ndarray(format="rgb24"), expected)
        else:
            assert np.abs(from_bt709(got)[:120, :160] - expected[:120, :160]).mean() < 2.5


def from_bt709(frame):
    """RGB of a yuv420p frame by the equations of ITU-R BT.709, limited range, chroma repeated."""
    height, width = frame.height, frame.width
    planes = frame.to_ndarray().astype(float)
    luma = planes[:height]
    u, v = planes[height:].reshape(2, height // 2, width // 2).repeat(2, axis=1).repeat(2, axis=2)
    luma, u, v = (luma - 16) / 219, (u - 128) / 224, (v - 128) / 224
    rgb = np.stack([luma + 1.5748 * v, luma - 0.1873 * u - 0.4681 * v, luma + 1.8556 * u], axis=-1)
    return np.clip(rgb, 0, 1) * 255


def write_video(path, frames, size=(64, 48)):
    with VideoWriter(path, size) as video:
        for frame in frames:
            video.write(frame)
    return video


def test_a_failed_video_leaves_nothing(tmp_path):
    def interrupted():
        yield picture(48, 64)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_video(tmp_path / "v.mp4", interrupted())
    with pytest.raises(OutputError, match="at least one frame"):
        write_video(tmp_path / "v.mp4", [])
    with pytest.raises(SettingsError, match="frames of uint8"):
        write_video(tmp_path / "v.mp4", [picture(48, 64), picture(64, 48)])
    assert list(tmp_path.iterdir()) == []


def test_the_next_encoder_is_tried(tmp_path, monkeypatch):
    broken = Encoder("libx264", "nv12_no_such_format", {})
    absent = Encoder("no_such_codec", "yuv420p", {})
    monkeypatch.setitem(video_module.ENCODERS, ".mp4", (absent, broken, *video_module.ENCODERS[".mp4"]))
    video = write_video(tmp_path / "v.mp4", [picture(48, 64)])
    assert video.encoder not in (absent, broken)
    monkeypatch.setitem(video_module.ENCODERS, ".mp4", (absent,))
    with pytest.raises(OutputError, match="no_such_codec"):
        write_video(tmp_path / "w.mp4", [picture(48, 64)])
    assert [p.name for p in tmp_path.iterdir()] == ["v.mp4"]


@pytest.mark.parametrize("codec", [e.codec for e in video_module.ENCODERS[".mp4"]])
def test_every_mp4_encoder_that_exists_here_works(tmp_path, monkeypatch, codec):
    encoder = next(e for e in video_module.ENCODERS[".mp4"] if e.codec == codec)
    if codec not in av.codec.codecs_available:
        pytest.skip(f"{codec} is not part of this FFmpeg")
    monkeypatch.setitem(video_module.ENCODERS, ".mp4", (encoder,))
    write_video(tmp_path / "v.mp4", [gradient(i, 128, 96) for i in range(3)], (128, 96))
    with av.open(str(tmp_path / "v.mp4")) as container:
        decoded = list(container.decode(video=0))
    assert len(decoded) == 3
    assert np.abs(from_bt709(decoded[0]) - gradient(0, 128, 96)).mean() < 4


def test_without_pyav_the_extra_is_named(tmp_path, monkeypatch):
    real_import = builtins.__import__

    def no_av(name, *args, **kwargs):
        if name == "av":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", no_av)
    with pytest.raises(OutputError, match=r"pip install 'orogen\[video\]'"):
        VideoWriter(tmp_path / "v.mp4", (64, 48))


@pytest.mark.parametrize(("size", "fps"), [((0, 4), 30), ((4, 4), 0), ((4, 4), float("nan"))])
def test_bad_video_settings(tmp_path, size, fps):
    with pytest.raises(SettingsError, match="expected"):
        VideoWriter(tmp_path / "v.mp4", size, fps)


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_lower_quality_makes_smaller_files(tmp_path, suffix):
    rng = np.random.default_rng(2)
    ground = np.cumsum(np.cumsum(rng.normal(size=(96, 160, 3)), 0), 1)
    frame = (127 + 90 * ground / np.abs(ground).max() + rng.normal(size=ground.shape) * 6).clip(0, 255)
    sizes = []
    for quality in QUALITIES:
        path = tmp_path / f"{quality}{suffix}"
        with VideoWriter(path, (160, 96), 25, quality=quality) as video:
            for step in range(6):
                video.write(np.roll(frame, 3 * step, axis=1).astype(np.uint8))
        sizes.append(path.stat().st_size)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[2] < 0.6 * sizes[0]
    with pytest.raises(SettingsError, match="quality: expected one of high, medium, low, got 'best'"):
        VideoWriter(tmp_path / "x.mp4", (160, 96), quality="best")
