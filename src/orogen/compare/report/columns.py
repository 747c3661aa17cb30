"""The columns of a report's tables."""

from __future__ import annotations

from orogen.compare.report.svg import number
from orogen.compare.report.tables import Column, count, decibels, degrees, milliseconds, percent, pixels, three

TRIANGLES = Column("Triangles", "triangles", show=count)
GPU = Column("GPU (ms)", "gpu", show=milliseconds, best="low")
WALL = Column("Wall clock (ms)", "wall", show=milliseconds, best="low")
PICTURE = (
    Column("PSNR (dB)", "psnr", "pooled", decibels, "high"),
    Column("SSIM", "ssim", show=three, best="high"),
)
SURFACE = (
    Column("99 % error (px)", "error.p99", show=pixels, best="low"),
    Column("Cracks", "cracks", "sum", count, "low"),
    Column("Instability (px)", "instability_mean", show=pixels, best="low"),
    Column("Popping", "popping", show=percent, best="low"),
)
PSNR = (
    Column("Minimum (dB)", "psnr", "min", decibels, "high"),
    Column("Average (dB)", "psnr", "mean", decibels),
    Column("Maximum (dB)", "psnr", "max", decibels, "high"),
    Column("All frames as one (dB)", "psnr", "pooled", decibels, "high"),
    Column("Equal frames", "psnr", "equal", count),
    Column("SSIM, average", "ssim", show=three, best="high"),
    Column("SSIM, minimum", "ssim", "min", three, "high"),
)
FLIP = (
    Column("FLIP, average", "flip", show=three, best="low"),
    Column("FLIP, maximum", "flip", "max", three, "low"),
)
DELTA_E = (
    Column("ΔE 2000, average", "delta_e", show=three, best="low"),
    Column("ΔE 2000, maximum", "delta_e", "max", three, "low"),
)
DURATIONS = (
    Column("Minimum", "gpu", "min", milliseconds, "low", "GPU (ms)"),
    Column("Average", "gpu", "mean", milliseconds, "low", "GPU (ms)"),
    Column("Maximum", "gpu", "max", milliseconds, "low", "GPU (ms)"),
    Column("50 %", "gpu", "p50", milliseconds, "low", "GPU (ms)"),
    Column("99 %", "gpu", "p99", milliseconds, "low", "GPU (ms)"),
    Column("Average", "cpu", "mean", milliseconds, "low", "CPU (ms)"),
    Column("Maximum", "cpu", "max", milliseconds, "low", "CPU (ms)"),
    Column("Average", "wall", "mean", milliseconds, "low", "Wall clock (ms)"),
    Column("Maximum", "wall", "max", milliseconds, "low", "Wall clock (ms)"),
)
WORK = (
    Column("Minimum", "triangles", "min", count, group="Triangles"),
    Column("Average", "triangles", "mean", count, group="Triangles"),
    Column("Maximum", "triangles", "max", count, group="Triangles"),
    Column("Patches, average", "patches", show=count),
    Column("Draws, average", "draws", show=number),
    Column("Rays, average", "rays", show=count),
)
ACCURACY = tuple(
    Column(title, f"{way}.{part}", statistic, show, "low", group)
    for way, group in (("forward", "Drawn points (px)"), ("backward", "True points (px)"))
    for title, part, statistic, show in (
        ("mean", "mean", "mean", pixels),
        ("95 %", "p95", "mean", pixels),
        ("99 %", "p99", "mean", pixels),
        ("99 %, worst frame", "p99", "max", pixels),
        ("largest", "max", "max", pixels),
        ("over 1 px", "over_1px", "mean", percent),
    )
)
SHAPES = (
    TRIANGLES,
    Column("Degenerate", "shapes.degenerate", show=count, group="Per frame"),
    Column("Slivers", "shapes.slivers", show=count, group="Per frame"),
    Column("Degenerate", "shapes.degenerate_share", show=percent, best="low", group="Share"),
    Column("Slivers", "shapes.sliver_share", show=percent, best="low", group="Share"),
    Column("Slivers, worst frame", "shapes.sliver_share", "max", percent, "low", "Share"),
    Column("Smallest angle, mean (°)", "shapes.smallest_angle", show=degrees, best="high"),
)
OUTLINES = (
    Column("Cracks, all frames", "cracks", "sum", count, "low"),
    Column("Cracks, worst frame", "cracks", "max", count, "low"),
    Column("Lost pixels, average", "lost", show=number, best="low"),
    Column("Hidden, average", "hidden", show=percent, best="low"),
    Column("Stray, average", "stray", show=percent, best="low"),
    Column("Skyline apart, mean (px)", "skyline_mean", show=pixels, best="low"),
    Column("Skyline apart, largest (px)", "skyline_max", "max", pixels, "low"),
)
STABILITY = (
    Column("Mean change (px)", "instability_mean", show=pixels, best="low"),
    Column("worst frame (px)", "instability_mean", "max", pixels, "low"),
    Column("99 % of change (px)", "instability_p99", show=pixels, best="low"),
    Column("Swimming (px per frame)", "swimming", show=pixels, best="low"),
    Column("Popping, average", "popping", show=percent, best="low"),
    Column("Popping, worst frame", "popping", "max", percent, "low"),
)
