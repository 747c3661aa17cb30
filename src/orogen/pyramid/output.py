"""Pyramids that are built for good, into a folder of the user's: heights and colours, published when complete."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from orogen.errors import OrogenError, OutputError
from orogen.pyramid import places
from orogen.pyramid.build import Builder, Estimate
from orogen.pyramid.journal import Journal
from orogen.pyramid.store import PART, Store, spatial, write_group, write_whole
from orogen.pyramid.task import Recipe
from orogen.pyramid.workers import Workers
from orogen.source.cache import lock
from orogen.source.contract import Source
from orogen.source.rounding import Overflow, Rounding
from orogen.source.stored import ATTRIBUTE, FORMAT, attributes

log = logging.getLogger("orogen")

Report = Callable[[float, str], None]
NOTES = ".build"
"""Folder in a draft with what only the build itself needs."""


@dataclass(frozen=True)
class Layer:
    """Heights or colours that go into the output."""

    name: str
    """Name of the folder."""
    source: Source
    """The data."""
    recipe: Recipe | None = None
    """How workers in other processes open it."""


@dataclass
class Output:
    """A pyramid folder that is built, or updated, beside its place, and then takes it at once."""

    target: Path
    """The folder to make."""
    layers: Sequence[Layer]
    """What goes into it; the first one gives the georeference."""
    max_error: float | None = None
    """Metres by which stored heights may be off; None: nothing is lost."""
    report: Report = lambda fraction, text: None
    """Called with the part done (0 to 1) and what is done, from any thread."""
    estimated: Callable[[Estimate], None] = lambda estimate: None
    """Called once, before most of the work."""
    stop: threading.Event = field(default_factory=threading.Event)
    """Set it to end the build with `Cancelled`; the next one goes on there."""

    @property
    def draft(self) -> Path:
        """Where it is built."""
        return self.target.with_name(f"{self.target.name}.building")

    def build(self, workers: Workers, *, replace: bool = False) -> dict[str, Any]:
        """Build what is not built yet, and publish it. Returns the facts of each layer by name.

        replace: put it in place of a pyramid folder that is there. Raises OutputError where something is there.
        """
        check_place(self.target, replace)
        with writing(self.target), drafted(self.draft) as notes:
            self._resume(notes)
            facts = self._fill(notes, workers)
            self._publish(notes, facts)
        return facts

    def _resume(self, notes: Path) -> None:
        """Go on with a draft of the same data and settings; remove one of others."""
        plan = {
            "format": FORMAT,
            "max_error": self.max_error,
            "layers": [[layer.name, layer.source.kind, layer.source.fingerprint] for layer in self.layers],
        }
        whole = all(layer.source.fingerprint for layer in self.layers)
        text = json.dumps(plan).encode()
        try:
            same = whole and (notes / "plan.json").read_bytes() == text
        except OSError:
            same = False
        if same:
            log.info("%s: goes on with a build that was interrupted", self.target)
            return
        for path in [path for path in self.draft.iterdir() if path != notes] + [notes / "journal", notes / "rounding"]:
            places.remove(path)
        write_whole(notes / "plan.json", text)

    def _fill(self, notes: Path, workers: Workers) -> dict[str, dict[str, Any]]:
        builders = {layer.name: self._builder(layer, notes) for layer in self.layers}
        try:
            estimates = [builder.sample(workers) for builder in builders.values()]
            self.estimated(Estimate(sum(e.seconds for e in estimates), sum(e.size for e in estimates)))
            facts = {name: builder.run(workers) for name, builder in builders.items()}
        except Overflow:
            # the heights reach further than the decimated read that the numbers were chosen from
            write_whole(notes / "rounding", b"int32")
            for layer in self.layers:
                places.remove(self.draft / layer.name)
            places.remove(notes / "journal")
            return self._fill(notes, workers)
        for layer in self.layers:
            builder = builders[layer.name]
            facts[layer.name] = layer_facts(layer, facts[layer.name], self.max_error, builder.rounding)
            builder.store.finish(layer.source.grid, facts[layer.name])
        return facts

    def _builder(self, layer: Layer, notes: Path) -> Builder:
        rounding = None
        if self.max_error is not None and layer.source.kind == "height":
            rounding = chosen_rounding(layer.source, self.max_error)
            if (notes / "rounding").exists():
                rounding = Rounding(rounding.step, (notes / "rounding").read_text())
        (self.draft / layer.name).mkdir(exist_ok=True)
        text = f"building {layer.name} of {self.target.name}"
        return Builder(
            layer.source,
            Store(self.draft / layer.name),
            lambda fraction: self.report(fraction, text),
            self.stop,
            keep=True,
            rounding=rounding,
            recipe=layer.recipe,
            journal=Journal(notes / "journal" / layer.name),
        )

    def _publish(self, notes: Path, facts: dict[str, dict[str, Any]]) -> None:
        finish_folder(self.draft, self.layers, facts)
        for unfinished in ("*.__lock", f"*{PART}"):  # writes that a kill has cut off
            for path in self.draft.rglob(unfinished):
                path.unlink()
        places.remove(notes)
        publish(self.draft, self.target)


def check_place(target: Path, replace: bool) -> None:
    """Raise OutputError where something stands at the place of an output that must not be replaced."""
    places.recover(target)
    if not target.exists():
        return
    if not replace:
        raise OutputError(f"{target}: exists; give --force to replace it, --update to bring it up to date")
    if attributes(target) is None:
        raise OutputError(f"{target}: is no pyramid that orogen has built; remove it yourself, or give another name")


def layer_facts(
    layer: Layer, built: dict[str, Any], max_error: float | None, rounding: Rounding | None
) -> dict[str, Any]:
    """What the metadata of a layer says."""
    source = layer.source
    grid = source.grid
    facts = {
        **built,
        "name": source.name,
        "fingerprint": source.fingerprint,
        "coverage": source.kind == "height" and not source.covered,
        "vertical_crs": source.vertical_crs,
        "grid": {
            "width": grid.width,
            "height": grid.height,
            "transform": list(grid.transform),
            "crs": grid.crs,
            "ground_scale": list(grid.ground_scale),
        },
    }
    if rounding is not None:
        facts |= {"max_error": max_error, "step": rounding.step, "largest_error": facts.pop("rounded_by")}
    return facts


def finish_folder(folder: Path, layers: Sequence[Layer], facts: dict[str, dict[str, Any]]) -> None:
    """Write the metadata of the folder of all layers, which marks it as complete."""
    listed = [[layer.name, facts[layer.name]["kind"]] for layer in layers]
    write_group(folder, {**spatial(layers[0].source.grid, 0), ATTRIBUTE: {"format": FORMAT, "layers": listed}})


def publish(draft: Path, target: Path) -> None:
    """Put a complete draft at its place; what is there goes."""
    if target.exists():
        places.exchange(draft, target)
        places.remove(draft)
    else:
        draft.rename(target)


def chosen_rounding(source: Source, max_error: float) -> Rounding:
    """A rounding for heights of about the range that a decimated read shows."""
    import numpy as np

    overview = source.overview((512, 512))
    low, high = (0.0, 0.0) if np.isnan(overview).all() else (float(np.nanmin(overview)), float(np.nanmax(overview)))
    return Rounding.within(max_error, low, high)


@contextlib.contextmanager
def drafted(draft: Path) -> Iterator[Path]:
    """The folder of notes in a draft, which nobody else works on meanwhile."""
    notes = draft / NOTES
    notes.mkdir(parents=True, exist_ok=True)
    with open(draft.with_name(f"{draft.name}.lock"), "ab") as file:
        if not lock(file, shared=False):
            raise OutputError(f"{draft}: another process builds there; wait for it, or give another name")
        try:
            yield notes
        finally:
            with contextlib.suppress(OSError):
                os.unlink(file.name)


@contextlib.contextmanager
def writing(target: Path) -> Iterator[None]:
    """Failures of the file system as one OutputError."""
    try:
        yield
    except OrogenError:
        raise
    except (OSError, ValueError) as error:  # ValueError: how tensorstore says that it cannot write
        raise OutputError(f"{target}: cannot be written ({error}); free some space or give another place") from error
