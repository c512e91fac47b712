"""Processes beside this one."""

import contextlib
import faulthandler
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from jaxcslc._processes import (
    Forked,
    can_fork,
    computed_beside,
    computed_in_bounds,
    function_beside,
    processes_beside,
)


# JAX's at-fork hook warns of its threads; functions here use none of them.
pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked"),
    pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning"),
    pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning"),
]


def _end() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_long_results_pass() -> None:
    with contextlib.closing(Forked(lambda: bytes(6_000_000))) as forked:
        assert forked.result() == bytes(6_000_000)


def test_errors_are_raised_here() -> None:
    with (
        contextlib.closing(Forked(lambda: int("three"))) as forked,
        pytest.raises(ValueError, match="invalid literal"),
    ):
        forked.result()


def test_an_ended_process_is_reported() -> None:
    with (
        contextlib.closing(Forked(_end)) as forked,
        pytest.raises(ChildProcessError, match="ended by SIGKILL"),
    ):
        forked.result()


def _end_without_a_trace(number: signal.Signals) -> None:
    """End this process as a crash does, without the trace that pytest prints."""
    faulthandler.disable()
    os.kill(os.getpid(), number)


@pytest.mark.parametrize(
    ("compute", "error", "words"),
    [
        (lambda: _end_without_a_trace(signal.SIGSEGV), ChildProcessError, "ended by SIGSEGV"),
        (lambda: _end_without_a_trace(signal.SIGABRT), ChildProcessError, "ended by SIGABRT"),
        (lambda: time.sleep(60), ChildProcessError, "took more than 0.5 s"),
        (lambda: len(bytes(3 << 30)), MemoryError, "^$"),
        (lambda: int("three"), ValueError, "invalid literal"),
    ],
)
def test_bounds(
    compute: Callable[[], object],
    error: type[Exception],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("jaxcslc._processes._has_no_threads_of_xla", lambda: True)
    with processes_beside(), pytest.raises(error, match=words):
        computed_in_bounds(compute, seconds=0.5, memory=1 << 30)
    assert computed_in_bounds(os.getpid, seconds=0.5, memory=1) == os.getpid()  # not allowed


def test_processes_end_in_any_order_and_unfinished() -> None:
    first, second = Forked(threading.Event().wait), Forked(lambda: -1)
    first.close()
    assert second.result() == -1
    second.close()
    second.close()


def test_beside_is_at_once_unless_it_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    with computed_beside(os.getpid) as result:
        assert result() == os.getpid()
    monkeypatch.setattr("jaxcslc._processes.core_count", lambda: 2)
    monkeypatch.setattr(Path, "glob", lambda *_: [])
    with processes_beside():
        assert not can_fork()  # not Linux


def test_beside_is_another_process_where_it_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)
    with computed_beside(os.getpid) as result:
        assert result() != os.getpid()


@pytest.mark.parametrize("beside", [False, True])
def test_a_result_can_be_asked_for_again(monkeypatch: pytest.MonkeyPatch, beside: bool) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: beside)
    with function_beside(lambda x: (str(x), os.getpid())) as begin:
        result = begin(1)
        assert result() == result()
        text, process = result()
    assert text == "1"
    assert (process != os.getpid()) == beside


def test_long_arguments_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)
    with function_beside(len) as begin:
        assert begin(bytes(3_000_000))() == 3_000_000


def test_a_function_that_is_not_called_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)
    with function_beside(len):
        pass


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are those of Linux")
def test_threads_of_xla_forbid_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxcslc._processes.core_count", lambda: 2)
    done = threading.Event()

    def named() -> None:
        Path(f"/proc/self/task/{threading.get_native_id()}/comm").write_text("tf_XLAEigen")
        done.wait()

    thread = threading.Thread(target=named)
    thread.start()
    try:
        with processes_beside():
            while not any(
                "XLA" in path.read_text() for path in Path("/proc/self/task").glob("*/comm")
            ):
                pass
            assert not can_fork()
    finally:
        done.set()
        thread.join()
