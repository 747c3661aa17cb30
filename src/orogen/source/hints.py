"""What to do with files that are no rasters, or that GDAL knows by another name."""

from __future__ import annotations

import os

ARCHIVES = {
    (".zip",): "zip://{}!dem.tif, by the name of the raster in it",
    (".tar", ".tgz", ".tar.gz"): "tar://{}!dem.tif, by the name of the raster in it",
    (".gz",): "gzip://{}",
}
"""How to open rasters in archives, by the ends of their names; the first that fits."""
BEGINNINGS = {
    b"version https://git-lfs": "it is a pointer of Git LFS; fetch the file itself (git lfs pull)",
    b"<!doctype html": "it is a web page; download the raster itself",
    b"<html": "it is a web page; download the raster itself",
    b"lasf": "it is a point cloud; make a grid of it first (pdal)",
    b"\x93numpy": "it is an array of numpy; give numpy.load(...) and spacing= to orogen.open",
}
"""What files are that begin so, in small letters."""
ENDINGS = {
    (".hgt",): "files of SRTM are known by their names, such as N46W122.hgt",
    (".shp", ".geojson", ".kml", ".gml", ".dxf"): "a vector file holds no heights; color= draws it over some",
    (".xyz", ".csv", ".txt"): "points that lie on no grid are to be gridded first (gdal_grid)",
}
"""What may help with files whose names end so."""


def hint(path: str) -> str:
    """What may help where a local file or folder is not recognised as a raster, with what joins it to the error."""
    if path.startswith("/vsi") or "://" in path:
        return ""
    if os.path.isdir(path):
        return "; expected a raster, or a folder with rasters such as .tif and .hgt in it"
    name = path.lower()
    for endings, archive in ARCHIVES.items():
        if name.endswith(endings):
            return f"; open it as {archive.format(path)}"
    try:
        with open(path, "rb") as file:
            head = file.read(64).lstrip().lower()
    except OSError:
        return ""
    for beginning, text in BEGINNINGS.items():
        if head.startswith(beginning):
            return f"; {text}"
    return next((f"; {text}" for endings, text in ENDINGS.items() if name.endswith(endings)), "")
