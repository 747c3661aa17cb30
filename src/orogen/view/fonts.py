"""Fonts of this machine for letters that the panel's own font lacks, such as those of Chinese or Arabic names."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

log = logging.getLogger("orogen")

FOLDERS = {
    "darwin": ("/System/Library/Fonts/Supplemental", "/System/Library/Fonts", "/Library/Fonts"),
    "win32": (os.path.join(os.environ.get("WINDIR", r"C:\Windows"), "Fonts"),),
}
"""Where fonts lie, by system; elsewhere fontconfig knows."""
FILES = {
    "darwin": (
        "Arial Unicode.ttf", "Hiragino Sans GB.ttc", "AppleSDGothicNeo.ttc", "Kohinoor.ttc", "Apple Symbols.ttf",
    ),
    "win32": (
        "segoeui.ttf", "msyh.ttc", "YuGothM.ttc", "malgun.ttf", "Nirmala.ttf", "Nirmala.ttc", "LeelawUI.ttf",
        "seguisym.ttf",
    ),
}  # fmt: skip
"""Fonts that come with a system and hold many letters, by system."""
PATIENCE = 5.0
"""Seconds that fontconfig is waited for: it may have to look at all fonts first."""
REGULAR, NORMAL = 80, 100
"""Weight and width of plain letters in fontconfig's numbers."""
SUFFIXES = (".ttf", ".otf", ".ttc", ".otc")
"""Of fonts that imgui reads."""
BLOCK = 128
"""Letters side by side, of which none is looked for again where one was not found: it takes a while."""


def font_with(letter: str) -> tuple[str, int] | None:
    """A font file of this machine that has a letter, and the number of the face in it; None where there is none."""
    block = ord(letter) // BLOCK
    if block in _lacking:
        return None
    for path, face in _known() if sys.platform in FILES else _listed(letter):
        if path.lower().endswith(SUFFIXES) and _has(path, face, letter):
            return path, face
    log.info("no font here has the letter %r", letter)
    _lacking.add(block)
    return None


_lacking: set[int] = set()


def _known() -> Iterator[tuple[str, int]]:
    for name in FILES[sys.platform]:
        for folder in FOLDERS[sys.platform]:
            if (path := Path(folder) / name).is_file():
                yield str(path), 0


def _listed(letter: str) -> Iterator[tuple[str, int]]:
    """What fontconfig lists, upright fonts of medium weight first."""
    command = shutil.which("fc-list")
    if command is None:
        return
    query = [f":charset={ord(letter):x}:scalable=true", "-f", "%{slant}|%{weight}|%{width}|%{index}|%{file}\n"]
    try:
        told = subprocess.run([command, *query], capture_output=True, timeout=PATIENCE, check=True).stdout
    except (OSError, subprocess.SubprocessError) as error:
        log.info("fontconfig: %s", error)
        return
    found = []
    for line in told.decode("utf-8", "replace").splitlines():
        *numbers, path = line.split("|", 4)
        # a font of variable weight has a range in place of a number
        slant, weight, width, index = (int(n) if n.isdigit() else None for n in numbers)
        rank = slant or 0, abs((weight or REGULAR) - REGULAR), abs((width or NORMAL) - NORMAL)
        found.append((rank, path, (index or 0) & 0xFFFF))
    yield from (entry[1:] for entry in sorted(found))


def _has(path: str, face: int, letter: str) -> bool:
    """Whether a font draws a letter otherwise than what it lacks."""
    from PIL import ImageFont

    try:
        font = ImageFont.truetype(path, 24, index=face)
        drawn, lacking = (bytes(font.getmask(text)) for text in (letter, "\U0010fffe"))
    except (OSError, ValueError, ImportError):
        return False
    return drawn != lacking
