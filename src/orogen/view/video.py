"""Videos, frame by frame."""

from __future__ import annotations

import contextlib
import logging
import math
import os
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orogen.errors import OutputError, SettingsError
from orogen.values import expected_name
from orogen.view.output import check_output, publish

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

log = logging.getLogger("orogen")


class Encoder(NamedTuple):
    """A way to encode video."""

    codec: str
    """FFmpeg's name of the encoder."""
    pixels: str
    """Pixel format."""
    options: dict[str, str]
    """Options of the encoder, for visually lossless quality."""
    coarser: Mapping[str, float] = MappingProxyType({})
    """Those of them by which files get smaller, with what a step of QUALITIES is on their scale."""


ENCODERS: dict[str, tuple[Encoder, ...]] = {
    ".mp4": (
        Encoder("libx264", "yuv420p", {"crf": "17", "preset": "veryfast"}, {"crf": 1.0}),
        Encoder("libopenh264", "yuv420p", {"rc_mode": "quality"}),
        Encoder("libsvtav1", "yuv420p", {"crf": "24", "preset": "9"}, {"crf": 1.75}),
        Encoder("mpeg4", "yuv420p", {"qmin": "2", "qmax": "4"}, {"qmin": 1.0, "qmax": 1.0}),
    ),
    ".mkv": (Encoder("ffv1", "bgr0", {"level": "3", "slicecrc": "1"}),),
    ".webm": (
        Encoder(
            "libvpx-vp9", "yuv420p", {"crf": "22", "b": "0", "deadline": "realtime", "cpu-used": "5"}, {"crf": 1.75}
        ),
        Encoder("libsvtav1", "yuv420p", {"crf": "24", "preset": "9"}, {"crf": 1.75}),
    ),
}
"""Encoders by suffix, the first that opens is used: .mp4 plays everywhere, .mkv is lossless."""

VIDEO_SUFFIXES = tuple(ENCODERS)

QUALITIES = {"high": 0, "medium": 6, "low": 12}
"""Steps below visually lossless, of which six halve the bytes or so. .mkv has no loss."""

BT709 = 1
"""ITU-T H.273 number of the matrix and of the primaries (those of sRGB too)."""
SRGB = 13
"""ITU-T H.273 number of sRGB's transfer curve."""
RGB_MATRIX = 0
"""ITU-T H.273 number of the identity matrix."""


class VideoWriter:
    """Writes frames to a video file, which appears when the `with` block ends well, and not at all when it fails.

    with VideoWriter("out.mp4", (1920, 1080), fps=30) as video:
        video.write(color)

    `size` is (width, height) in pixels; where the encoder needs even numbers, the last column or row is repeated.
    `quality` is one of QUALITIES. Raises SettingsError for a bad size, rate or quality, OutputError where the file
    cannot be written or PyAV is missing.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        size: tuple[int, int],
        fps: float = 30.0,
        overwrite: bool = False,
        *,
        quality: str = "high",
    ) -> None:
        if min(size) < 1:
            raise SettingsError(f"size: expected at least 1x1 pixels, got {size[0]}x{size[1]}")
        if not (math.isfinite(fps) and 0 < fps <= 1000):
            raise SettingsError(f"fps: expected more than 0 and at most 1000 frames per second, got {fps:g}")
        if quality not in QUALITIES:
            raise expected_name("quality", quality, QUALITIES)
        self.path = check_output(path, VIDEO_SUFFIXES, overwrite)
        self.size = size
        self.fps = Fraction(fps).limit_denominator(1001)
        self.frames = 0
        self._overwrite, self._quality = overwrite, quality
        _load_av()

    def __enter__(self) -> VideoWriter:
        self._stack = contextlib.ExitStack()
        with self._stack:  # closes what is open already where the next step fails
            self._temporary = self._stack.enter_context(publish(self.path, VIDEO_SUFFIXES, self._overwrite))
            self._container, self._stream, self.encoder = self._open(self._temporary)
            self._stack.callback(self._container.close)
            self._stack = self._stack.pop_all()
        log.debug("%s: encoding with %s", self.path, self.encoder.codec)
        return self

    def write(self, color: NDArray[np.uint8]) -> None:
        """Append a frame: (height, width, 3 or 4) uint8 sRGB values, row 0 uppermost; a fourth channel is ignored."""
        width, height = self.size
        if color.dtype != np.uint8 or color.shape not in ((height, width, 3), (height, width, 4)):
            raise SettingsError(
                f"expected frames of uint8 ({height}, {width}, 3 or 4), got {color.dtype} {color.shape}"
            )
        av = _load_av()
        rgb = np.ascontiguousarray(color[..., :3])
        if self.encoder.pixels == "yuv420p":
            rgb = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), "edge")
        frame = av.VideoFrame.from_ndarray(rgb, format="rgb24")
        if self.encoder.pixels == "yuv420p":
            frame = frame.reformat(
                format="yuv420p",
                src_color_range="JPEG",
                dst_color_range="MPEG",
                src_colorspace="ITU709",
                dst_colorspace="ITU709",
            )
        frame.pts = self.frames
        frame.time_base = 1 / self.fps
        with _output_errors(self.path):
            self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:
            if self.frames == 0:
                raise OutputError(f"{self.path}: expected at least one frame, got none")
            with _output_errors(self.path):
                self._container.mux(self._stream.encode(None))

    def _open(self, path: Path) -> tuple[OutputContainer, VideoStream, Encoder]:
        """The first encoder that opens: that it is compiled in does not say that it works on this machine."""
        av = _load_av()
        reasons = []
        for encoder in ENCODERS[path.suffix.lower()]:
            container = None
            try:
                options = {"movflags": "faststart"} if path.suffix.lower() == ".mp4" else {}
                container = av.open(str(path), "w", options=options)
                own = options_of(encoder, self._quality)
                stream: Any = container.add_stream(encoder.codec, rate=self.fps, options=own)
                self._describe(stream, encoder)
                stream.codec_context.open()
                container.start_encoding()
                return container, stream, encoder
            except (av.FFmpegError, ValueError) as error:
                if container is not None:
                    with contextlib.suppress(av.FFmpegError):
                        container.close()
                reasons.append(f"{encoder.codec}: {error}")
        raise OutputError(f"{self.path}: no encoder for {path.suffix} opens ({'; '.join(reasons)}); try another suffix")

    def _describe(self, stream: Any, encoder: Encoder) -> None:
        width, height = self.size
        rgb = encoder.pixels != "yuv420p"
        stream.width, stream.height = (width, height) if rgb else (width + width % 2, height + height % 2)
        stream.pix_fmt = encoder.pixels
        context = stream.codec_context
        context.time_base = 1 / self.fps
        context.color_primaries, context.color_trc = BT709, SRGB
        context.colorspace = RGB_MATRIX if rgb else BT709
        context.color_range = 2 if rgb else 1  # full (JPEG) or limited (MPEG)


def options_of(encoder: Encoder, quality: str) -> dict[str, str]:
    """An encoder's options for one of QUALITIES."""
    steps = QUALITIES[quality]
    coarser = {name: str(round(int(encoder.options[name]) + each * steps)) for name, each in encoder.coarser.items()}
    return {**encoder.options, **coarser}


@contextlib.contextmanager
def _output_errors(path: Path) -> Any:
    av = _load_av()
    try:
        yield
    except av.FFmpegError as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error


def _load_av() -> Any:
    try:
        import av
    except ImportError as error:
        raise OutputError("videos need PyAV, which is not installed; run: pip install 'orogen[video]'") from error
    return av
