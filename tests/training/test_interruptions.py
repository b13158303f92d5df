"""Ctrl-C, SIGTERM and SIGHUP: noted once, effective at once the second time, ignored in workers."""

import importlib.util
import signal
import sys
import threading

import pytest

from marl_lanes.training import interruptions
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
        signal.raise_signal(number)
        assert received == [number]
        signal.raise_signal(signal.SIGINT)
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
        signal.raise_signal(number)
    assert [signal.getsignal(one) for one in SIGNALS] == [signal.SIG_IGN] * 3


@pytest.mark.parametrize("number", SIGNALS)
def test_what_the_process_ignores_it_goes_on_ignoring(number):
    """As SIGHUP under nohup."""
    signal.signal(number, signal.SIG_IGN)
    with note_interruptions() as received:
        signal.raise_signal(number)
        others = [one for one in SIGNALS if one != number]
        signal.raise_signal(others[0])
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


def test_on_windows_a_closed_terminal_sends_sigbreak(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(signal, "SIGBREAK", 21, raising=False)
    monkeypatch.delattr(signal, "SIGHUP", raising=False)
    spec = importlib.util.spec_from_file_location("there", interruptions.__file__)
    there = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(there)
    assert there.SIGNALS == (signal.SIGINT, signal.SIGTERM, 21)
