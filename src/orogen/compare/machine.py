"""The machine that a comparison ran on, and the memory of this process."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path
from typing import Any

import orogen


def machine() -> dict[str, Any]:
    """Processor, cores, memory in bytes, system, Python and Orogen, for the report; None for what is not known."""
    return {
        "cpu": _processor(),
        "cores": os.cpu_count(),
        "memory": _total_memory(),
        "os": platform.platform(),
        "python": platform.python_version(),
        "orogen": orogen.__version__,
    }


def host_memory() -> int | None:
    """Resident memory of this process now in bytes; None where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _total_memory() -> int | None:
    if sys.platform == "win32":
        return None
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError):
        return None
