"""Trees of map tiles, {z}/{x}/{y}: where a tile is, which there are, and its bytes."""

from __future__ import annotations

import logging
import os
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orogen.errors import SourceError
from orogen.source.blocks import DiskBlocks
from orogen.source.objects import failure, is_remote, open_store, shown

log = logging.getLogger("orogen")

SUFFIXES = (".png", ".webp", ".jpg", ".jpeg")
"""Of images in a folder of tiles, in the order in which they are looked for."""
DEEPEST = 30
"""The finest zoom that is understood."""
KEPT = 7 * 24 * 3600
"""Seconds for which tiles of a server are kept on disk: it is not asked whether they changed."""
FIELD = re.compile(r"\{(z|x|-?y)\}")
_WMTS_FIELDS = {"tilematrix": "z", "tilecol": "x", "tilerow": "y"}
WMTS = re.compile(rf"\{{({'|'.join(_WMTS_FIELDS)})\}}", re.IGNORECASE)
"""What templates of WMTS servers call zoom, column and row."""

Tile = tuple[int, int, int]
"""Zoom, column from the west and row from the north."""


@dataclass(frozen=True)
class Template:
    """The path or URL of tiles with {z}, {x} and {y}, or {-y} where rows are counted from the south."""

    text: str

    def __post_init__(self) -> None:
        fields = sorted(found.lstrip("-") for found in FIELD.findall(self.text))
        if fields != ["x", "y", "z"]:
            raise SourceError(
                f"{self.name}: expected {{z}}, {{x}} and {{y}} (or {{-y}}) once each in a template of tiles"
            )

    @property
    def name(self) -> str:
        """For messages."""
        return shown(self.text) if is_remote(self.text) else self.text

    def path(self, tile: Tile) -> str:
        """Where a tile is."""
        z, x, y = tile
        values = {"z": z, "x": x, "y": y, "-y": 2**z - 1 - y}
        return FIELD.sub(lambda found: str(values[found[1]]), self.text)

    def tiles(self, zoom: int | None) -> Iterator[tuple[Tile, os.DirEntry[str]]]:
        """The tiles in the folder, of one zoom or of all, with their files."""
        before = self.text[: FIELD.search(self.text).start()]  # type: ignore[union-attr]
        root = os.path.dirname(before)
        rest = self.text[len(root) + 1 :] if root else self.text
        yield from self._walk(root or ".", rest.replace(os.sep, "/").split("/"), {} if zoom is None else {"z": zoom})

    def _walk(self, folder: str, parts: list[str], known: dict[str, int]) -> Iterator[tuple[Tile, os.DirEntry[str]]]:
        pattern = re.compile("".join(_regex(piece) for piece in re.split(r"(\{(?:z|x|-?y)\})", parts[0])))
        try:
            entries = list(os.scandir(folder))
        except NotADirectoryError:
            return
        except OSError as error:
            raise SourceError(f"{folder}: cannot be listed ({error}); check the folder") from error
        for entry in entries:
            match = pattern.fullmatch(entry.name)
            if not match:
                continue
            found = {key: int(value) for key, value in match.groupdict().items()}
            if found.get("z", 0) > DEEPEST or any(known.get(key, value) != value for key, value in found.items()):
                continue
            found = known | found
            if len(parts) > 1:
                yield from self._walk(entry.path, parts[1:], found)
            elif max(found["x"], found["y"]) < 2 ** found["z"]:
                y = found["y"] if "{y}" in self.text else 2 ** found["z"] - 1 - found["y"]
                yield (found["z"], found["x"], y), entry


def _regex(piece: str) -> str:
    return rf"(?P<{piece.strip('{}-')}>\d+)" if FIELD.fullmatch(piece) else re.escape(piece)


def template_of(data: str | os.PathLike[str]) -> Template | None:
    """The template of a folder of tiles or of a template's text; None where it is neither."""
    text = WMTS.sub(lambda found: "{" + _WMTS_FIELDS[found[1].lower()] + "}", os.fspath(data))
    if "{z}" in text and not os.path.isfile(text):
        text = text.replace("{s}", "a")
        return Template(text if is_remote(text) else os.path.abspath(text))
    if is_remote(text) or not os.path.isdir(text):
        return None
    # what gdal2tiles writes counts rows from the south, and says so in a file
    row = "{-y}" if os.path.isfile(os.path.join(text, "tilemapresource.xml")) else "{y}"
    for suffix in SUFFIXES:
        for zoom in _numbered(text):
            for column in _numbered(zoom):
                if any(re.fullmatch(rf"\d+{suffix}", name) for name in os.listdir(column)):
                    return Template(os.path.join(os.path.abspath(text), "{z}", "{x}", row + suffix))
    return None


def _numbered(folder: str) -> list[str]:
    """The first folders in a folder whose name is a number."""
    names = sorted((n for n in os.listdir(folder) if n.isdecimal() and os.path.isdir(os.path.join(folder, n))), key=int)
    return [os.path.join(folder, name) for name in names[:8]]


class LocalTiles:
    """Tiles in a folder."""

    remote = False

    def __init__(self, template: Template) -> None:
        self.template = template

    def get(self, tile: Tile) -> bytes | None:
        """The bytes of a tile, or None where there is none."""
        path = self.template.path(tile)
        try:
            return Path(path).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise SourceError(f"{path}: cannot be read ({error})") from error

    def close(self) -> None:
        """Nothing is open."""


class RemoteTiles:
    """Tiles of a server, kept on disk for a week. Safe to use from several threads at once."""

    remote = True

    def __init__(self, template: Template) -> None:
        self.template = template
        self._lock = threading.Lock()
        self._disk: DiskBlocks | None = None
        head, found, query = template.text.partition("?")
        start = FIELD.search(head)
        # one connection for all, unless the place of a tile is in the query
        self._shared = start is not None and not FIELD.search(query)
        if self._shared:
            base = head[: head.rindex("/", 0, start.start())]  # type: ignore[union-attr]
            self._tail = head[len(base) + 1 :]
            self._store, self._prefix = open_store(base + found + query)

    def get(self, tile: Tile) -> bytes | None:
        """The bytes of a tile, or None where the server has none. Raises SourceError after the last attempt."""
        import obstore

        z, x, y = tile
        number = (4**z - 1) // 3 + y * 2**z + x
        kept = self._kept().read([number]).get(number)
        if kept is not None:
            return kept or None
        store, path = self._place(tile)
        try:
            data = bytes(obstore.get(store, path).bytes())
        except FileNotFoundError:
            data = b""
        except (obstore.exceptions.BaseError, OSError, TimeoutError, ValueError) as error:
            raise failure(shown(self.template.path(tile)), error) from error
        self._kept().write({number: data})
        return data or None

    def close(self) -> None:
        """Release the entry on disk."""
        with self._lock:
            if self._disk is not None:
                self._disk.close()
                self._disk = None

    def _place(self, tile: Tile) -> tuple[Any, str]:
        if not self._shared:
            return open_store(self.template.path(tile))
        tail = replace(self.template, text=self._tail).path(tile)
        return self._store, f"{self._prefix}/{tail}" if self._prefix else tail

    def _kept(self) -> DiskBlocks:
        with self._lock:
            if self._disk is None:
                self._disk = DiskBlocks(self.template.text, f"tiles of week {time.time() // KEPT:.0f}")
            return self._disk


def open_tiles(template: Template) -> LocalTiles | RemoteTiles:
    """Where the bytes of the tiles of a template come from."""
    return RemoteTiles(template) if is_remote(template.text) else LocalTiles(template)
