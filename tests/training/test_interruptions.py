"""Ctrl-C, SIGTERM and SIGHUP: noted once, effective at once the second time, ignored in workers."""

import os
import signal
import threading

import pytest

from marl_lanes.training.interruptions import SIGNALS, ignore_interruptions, note_interruptions


@pytest.fixture(autouse=True)
def handlers():
    """Those of a terminal; puts those of pytest back."""
    before = [signal.getsignal(number) for number in SIGNALS]
    for number in SIGNALS:
        # Under nohup pytest ignores some.
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)
    yield [signal.getsignal(number) for number in SIGNALS]
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
    assert [signal.getsignal(one) for one in SIGNALS] == [signal.SIG_IGN] * 3


@pytest.mark.parametrize("number", SIGNALS)
def test_what_the_process_ignores_it_goes_on_ignoring(number):
    """As SIGHUP under nohup."""
    signal.signal(number, signal.SIG_IGN)
    with note_interruptions() as received:
        os.kill(os.getpid(), number)
        others = [one for one in SIGNALS if one != number]
        os.kill(os.getpid(), others[0])
    assert received == others[:1]
    assert signal.getsignal(number) == signal.SIG_IGN


def test_a_handler_that_is_not_pythons_stays(monkeypatch):
    before = [signal.getsignal(one) for one in SIGNALS]
    monkeypatch.setattr(signal, "getsignal", lambda _: None)
    with note_interruptions() as received:
        pass
    monkeypatch.undo()
    assert received == []
    assert [signal.getsignal(one) for one in SIGNALS] == before


def test_in_another_thread_nothing_is_noted(handlers):
    found = []

    def note():
        with note_interruptions() as received:
            found.append(received)

    thread = threading.Thread(target=note)
    thread.start()
    thread.join()
    assert found == [[]]
    assert [signal.getsignal(one) for one in SIGNALS] == handlers
