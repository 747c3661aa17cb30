"""Which local file a name of GDAL's stands for."""

from __future__ import annotations

import os
import re

NAMED = re.compile(r'(NETCDF:|HDF5:|vrt://|file://)(?:"([^"]+)"|(.*?))([:?].*)?$', re.IGNORECASE | re.DOTALL)
"""Names of files, or of parts of files, that are checked before they are opened: prefix, file (twice), part."""


def is_local(path: str) -> bool:
    """Whether GDAL would take `path` for a file of this machine."""
    return not (path.startswith("/vsi") or "://" in path or (":" in path[2:] and not os.path.exists(path)))


def local_file(name: str, folder: str = "") -> str | None:
    """The path of the file of this machine that a name of GDAL's stands for, there or not; None: it stands for none.

    `folder`: where the path begins, if it is not absolute.
    """
    path = os.path.join(folder, name)
    if is_local(path):
        return path
    named = NAMED.match(name)
    return os.path.join(folder, named[2] or named[3]) if named and (named[2] or named[3]) else None
