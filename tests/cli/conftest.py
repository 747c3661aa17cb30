"""Calling the command in this process."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator

import pytest

from orogen import cli

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture(autouse=True)
def _own_log() -> Iterator[None]:
    """The command sets logging up for a process of its own."""
    loggers = [logging.getLogger(), logging.getLogger("orogen")]
    before = [(log.handlers[:], log.level, log.propagate) for log in loggers]
    yield
    logging.captureWarnings(False)
    for log, (handlers, level, propagate) in zip(loggers, before, strict=True):
        log.handlers[:], log.propagate = handlers, propagate
        log.setLevel(level)


@pytest.fixture
def call(capfd: pytest.CaptureFixture[str]) -> Call:
    """Run a command line in this process: exit code, stdout, stderr without what the graphics driver says."""

    def run(*arguments: object) -> tuple[int, str, str]:
        code = cli.run([str(a) for a in arguments])
        out, err = capfd.readouterr()
        return code, out, "".join(line for line in err.splitlines(keepends=True) if "XDG_RUNTIME_DIR" not in line)

    return run
