"""Ctrl-C comes when it likes: nothing that the GPU has to tell is lost by it."""

import signal
import threading

import numpy as np
import pytest

from orogen.gpu.interrupts import uninterrupted


@pytest.fixture(autouse=True)
def handler():
    """Python's own, whatever the loops of windows have left."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_it_comes_at_the_end_of_the_block():
    done = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012
        with uninterrupted():
            signal.raise_signal(signal.SIGINT)
            with uninterrupted():
                signal.raise_signal(signal.SIGINT)
            done.append(True)
        done.append(False)
    assert done == [True]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_other_threads_and_handlers_are_left_alone():
    def enter():
        with uninterrupted():
            known.append(signal.getsignal(signal.SIGINT))

    known = []
    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        enter()
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert known == [before, signal.SIG_IGN]


def test_commands_are_handed_over_whole(gpu):
    """Ctrl-C in the middle of it: what they were to read back arrives all the same."""
    numbers = np.arange(1024, dtype=np.uint32)
    buffer = gpu.buffer("numbers", numbers, "COPY_SRC", "test")
    encoder = gpu.encoder("copy")
    gpu.after(encoder, lambda: signal.raise_signal(signal.SIGINT))
    copied = gpu.read_buffer(buffer, dtype=np.uint32, encoder=encoder)
    with pytest.raises(KeyboardInterrupt):
        gpu.submit(encoder)
    np.testing.assert_array_equal(copied.result(), numbers)
    buffer.destroy()
