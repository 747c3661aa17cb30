"""The account of GPU memory: what is allocated, for what, and how much there may be."""

from __future__ import annotations

import threading
from collections import Counter

from orogen.errors import BudgetError, SettingsError


class MemoryAccount:
    """Counts bytes by category and refuses what would exceed the budget. Safe to use from several threads."""

    def __init__(self, budget: int | None = None) -> None:
        """`budget`: bytes that may be allocated at any time; None: no limit."""
        if budget is not None and budget < 1:
            raise SettingsError(f"GPU memory budget: expected at least 1 byte, got {budget}")
        self._budget = budget
        self._bytes: Counter[str] = Counter()
        self._total = 0
        self._peak = 0
        # re-entrant: an object released by the garbage collector may come back here from inside a call
        self._lock = threading.RLock()

    @property
    def budget(self) -> int | None:
        """Bytes that may be allocated at any time; None: no limit."""
        return self._budget

    @property
    def total(self) -> int:
        """Bytes allocated now."""
        return self._total

    @property
    def peak(self) -> int:
        """Most bytes that were allocated at any time."""
        return self._peak

    @property
    def free(self) -> int | None:
        """Bytes left in the budget; None: no limit."""
        return None if self._budget is None else self._budget - self._total

    def by_category(self) -> dict[str, int]:
        """Bytes allocated now per category, the largest first."""
        with self._lock:
            return {name: size for name, size in self._bytes.most_common() if size}

    def allocate(self, size: int, category: str, label: str = "") -> None:
        """Count `size` bytes before they are allocated; raises `BudgetError`, and counts nothing, where too many."""
        with self._lock:
            if self._budget is not None and self._total + size > self._budget:
                used = ", ".join(f"{name} {_mib(held)}" for name, held in self.by_category().items()) or "nothing"
                raise BudgetError(
                    f"GPU memory for {label or category!r}: expected at most {_mib(self._budget - self._total)}, "
                    f"what is left of the budget of {_mib(self._budget)}, got {_mib(size)}; in use: {used}; "
                    f"raise the budget or ask for less"
                )
            self._bytes[category] += size
            self._total += size
            self._peak = max(self._peak, self._total)

    def release(self, size: int, category: str) -> None:
        """Give back what `allocate` counted."""
        with self._lock:
            self._bytes[category] -= size
            self._total -= size


def _mib(size: int) -> str:
    return f"{size / 2**20:.1f} MiB"
