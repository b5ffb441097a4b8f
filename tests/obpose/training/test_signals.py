import signal
import threading

import pytest

from obpose.training.signals import stop_on_signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_is_noted_and_the_old_handler_comes_back(number: signal.Signals):
    before = signal.getsignal(number)
    with stop_on_signals() as request:
        assert request.received is None
        signal.raise_signal(number)
        assert request.received is number
    assert signal.getsignal(number) is before


def test_an_echo_is_the_same_request():
    with stop_on_signals() as request:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        assert request.received is signal.SIGINT


def test_a_later_signal_has_its_usual_effect():
    with stop_on_signals(echo_seconds=-1.0):
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_outside_the_main_thread_nothing_changes():
    before, seen = signal.getsignal(signal.SIGTERM), []

    def look() -> None:
        with stop_on_signals():
            seen.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [before]
