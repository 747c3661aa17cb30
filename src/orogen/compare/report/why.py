"""Why a report has no value somewhere: every dash is explained."""

from __future__ import annotations

from orogen.compare.report.results import Comparison, Entry

GROUPS = {
    "mse": "psnr", "psnr": "psnr", "ssim": "ssim", "flip": "flip", "delta_e": "delta_e",
    "forward": "surface", "backward": "surface", "error": "surface", "hidden": "surface", "stray": "surface",
    "cracks": "cracks", "lost": "cracks", "skyline_mean": "cracks", "skyline_max": "cracks",
    "shapes": "shapes", "angles": "shapes",
    "instability_mean": "stability", "instability_p99": "stability", "swimming": "stability", "popping": "stability",
}  # fmt: skip
"""The name in the plan's "metrics" that a flat name belongs to, by its first part."""
EMPTY = {
    "psnr": "no frame holds it",
    "surface": "there is no terrain in view to measure",
    "skyline_mean": "no frame shows a skyline in both pictures",
    "skyline_max": "no frame shows a skyline in both pictures",
    "shapes": "the algorithm draws no triangles",
    "stability": "needs frames that follow each other closely and show the same ground",
}


def why(comparison: Comparison, entry: Entry, name: str) -> str:
    """Why `entry` has no value for a flat name."""
    first = name.split(".")[0]
    group = GROUPS.get(first)
    if not entry.frames:
        return "no frame is finished yet"
    if first == "gpu":
        if entry.value("gpu") is not None:
            return "the algorithm has no such pass"
        return "the adapter gives no timestamps, so GPU time is unknown"
    if first == "wall":
        return "every frame was timed once, while it was loaded: the wall clock needs repeats"
    if first == "memory":
        return "the entry has no memory of this kind" if name.startswith("memory.gpu.") else "not recorded"
    asked = comparison.plan.get("metrics")
    if group is not None and asked is not None and group not in asked:
        return f"not measured: the comparison did not ask for the metric “{group}”"
    return EMPTY.get(first, EMPTY.get(group or "", "not recorded"))
