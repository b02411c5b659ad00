"""Interrupts at moments that must not be cut in two are late, not lost."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from marl_mm import interrupts
from marl_mm.interrupts import deaf_to_interrupts, end_on_signals


@pytest.fixture(autouse=True)
def handlers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Those of a command, in the foreground.

    Signals are raised in this thread: another one, that a test before has left, might
    take what is sent to the process, and later.
    """
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(interrupts, "_heard", float("-inf"))
    end_on_signals()
    yield
    signal.signal(signal.SIGINT, before[0])
    signal.signal(signal.SIGTERM, before[1])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_comes_after_the_outermost_block(number: signal.Signals) -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):
        with deaf_to_interrupts():
            with deaf_to_interrupts():
                signal.raise_signal(number)
                done.append("inner")
            done.append("outer")
        done.append("too far")
    assert done == ["inner", "outer"]
    with deaf_to_interrupts():  # it came once
        pass


def test_an_interrupt_comes_while_another_error_is_handled() -> None:
    with pytest.raises(KeyboardInterrupt):
        try:
            raise ValueError
        except ValueError:
            with deaf_to_interrupts():
                signal.raise_signal(signal.SIGINT)
            raise AssertionError("it was lost") from None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_interrupt_changes_nothing(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interrupts, "_ECHO", 0.0)  # as if each came much later
    with pytest.raises(KeyboardInterrupt, match="the first"):
        try:
            raise KeyboardInterrupt("the first")
        finally:
            with deaf_to_interrupts():
                signal.raise_signal(number)
    with deaf_to_interrupts(forget=True):
        signal.raise_signal(number)


def test_an_interrupt_sent_twice_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(KeyboardInterrupt, match="the message"):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            raise KeyboardInterrupt("the message") from None
    monkeypatch.setattr(interrupts, "_ECHO", 0.0)  # as if it came much later
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_what_is_ignored_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_on_signals()
    with deaf_to_interrupts():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


def test_a_block_in_another_thread_changes_no_handler() -> None:
    before, within = signal.getsignal(signal.SIGINT), []

    def work() -> None:
        with deaf_to_interrupts():
            within.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert within == [before]


def test_processes_started_in_the_block_do_not_hear_it() -> None:
    code = "import os, signal; signal.raise_signal(signal.SIGINT); print('alive')"
    with deaf_to_interrupts():
        child = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert child.stdout == b"alive\n"
