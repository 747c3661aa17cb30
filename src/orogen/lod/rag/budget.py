"""Refinement within a time budget: a frame makes as many passes as it has time for, and the next ones go on."""

from __future__ import annotations

from collections.abc import Mapping

GROWTH = 4.0
"""A pass whose time is not known takes at most this many times as long as the one before: no triangle becomes more."""


class Pace:
    """How long each pass took when it was last made."""

    def __init__(self) -> None:
        self._milliseconds: dict[int, float] = {}

    def learn(self, times: Mapping[str, float]) -> None:
        """Take what a timer measured: milliseconds by the names that `pass_name` gives."""
        for name, milliseconds in times.items():
            word, _, number = name.partition(" ")
            if word == "refine" and number:
                self._milliseconds[int(number)] = milliseconds

    def passes(self, first: int, end: int, budget: float) -> int:
        """How many passes from `first` on, and before `end`, fit into `budget` milliseconds; one at least."""
        spent = cost = 0.0
        for number in range(first, end):
            known = self._milliseconds.get(number)
            if known is None and number > first and cost == 0.0:
                return number - first
            cost = GROWTH * cost if known is None else known
            spent += cost
            if spent > budget and number > first:
                return number - first
        return end - first


def pass_name(number: int) -> str:
    """What a timed pass is called."""
    return f"refine {number}"
