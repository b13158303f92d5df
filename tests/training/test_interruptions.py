"""Ctrl-C and SIGTERM: noted once, effective at once the second time, ignored in workers."""

import os
import signal

import pytest

from marl_lanes.training.interruptions import ignore_interruptions, note_interruptions

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def handlers():
    """Puts the handlers of pytest back."""
    before = [signal.getsignal(number) for number in SIGNALS]
    yield before
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)


def interrupt_twice(number):
    with note_interruptions() as received:
        assert received == []
        os.kill(os.getpid(), number)
        assert received == [number]
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second one is ignored")


@pytest.mark.parametrize("number", SIGNALS)
def test_the_first_is_noted_and_the_second_stops(handlers, number):
    with pytest.raises(KeyboardInterrupt):
        interrupt_twice(number)
    assert [signal.getsignal(one) for one in SIGNALS] == handlers


def test_without_one_nothing_is_noted(handlers):
    with note_interruptions() as received:
        pass
    assert received == []
    assert [signal.getsignal(one) for one in SIGNALS] == handlers


def test_a_worker_ignores_both():
    ignore_interruptions()
    for number in SIGNALS:
        os.kill(os.getpid(), number)
    assert [signal.getsignal(one) for one in SIGNALS] == [signal.SIG_IGN] * 2
