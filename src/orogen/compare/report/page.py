"""The report's page: complete without scripts and other files."""

from __future__ import annotations

from html import escape
from pathlib import Path

from orogen.compare.report.results import Comparison
from orogen.compare.report.sections import SECTIONS
from orogen.compare.report.words import NOTHING, data_name, definitions, picture_size, words

FOLDER = Path(__file__).parent


def page(comparison: Comparison) -> str:
    """The whole page as HTML."""
    made = [(title, make(comparison)) for title, make in SECTIONS]
    links, body = "", ""
    for title, content in made:
        if content:
            anchor = title.lower().replace(" ", "-")
            links += f'<li><a href="#{anchor}">{escape(title)}</a></li>'
            body += f'<section id="{anchor}"><h2>{escape(title)}</h2>{content}</section>\n'
    flight = comparison.plan.get("flight", {}).get("name", NOTHING)
    title = escape(f"{data_name(comparison)}, flight “{flight}”")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>Terrain algorithms compared: {title}</title>
<style>{_file("report.css")}</style>
</head>
<body>
<header>
<p class="kind">Terrain algorithms compared</p>
<h1>{title}</h1>
{_facts(comparison)}{_progress(comparison)}
</header>
<nav><ul>{links}</ul></nav>
<main>
{body}</main>
<script>{_file("report.js")}</script>
</body>
</html>
"""


def _facts(comparison: Comparison) -> str:
    plan = comparison.plan
    flight, machine, adapter = (plan.get(name) or {} for name in ("flight", "machine", "adapter"))
    data = data_name(comparison)
    if crop := plan.get("crop"):
        data += f", {crop[2]} × {crop[3]} samples from ({crop[0]}, {crop[1]})"
    lit = (plan.get("style") or {}).get("lit")
    facts = {
        "Data": data,
        "Flight": f"{words(flight.get('name'))}, {comparison.frame_count} frames, {words(flight.get('duration'))} s",
        "Pictures": picture_size(comparison) + ("" if lit is None else ", lit" if lit else ", unlit"),
        "Adapter": ", ".join(
            words(adapter[part]) for part in ("name", "kind", "backend", "driver") if adapter.get(part)
        ),
        "Machine": ", ".join(words(machine[part]) for part in ("cpu", "os") if machine.get(part)),
        "Software": f"orogen {words(machine.get('orogen'))}, Python {words(machine.get('python'))}",
    }
    return definitions({name: text or None for name, text in facts.items()}, "facts")


def _progress(comparison: Comparison) -> str:
    if comparison.finished:
        return ""
    total = comparison.frame_count
    lacking = [f"{entry.label} {len(entry.frames)}" for entry in comparison.entries if len(entry.frames) < total]
    return (
        f'<p class="warning"><b>Not finished.</b> Frames measured of {total}: {escape(", ".join(lacking))}. '
        "Averages are over the frames that are there.</p>"
    )


def _file(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")
