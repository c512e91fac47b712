"""Processes beside this one."""

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from jaxcslc._processes import (
    ForkedFunction,
    SharedMap,
    can_fork,
    computed_beside,
    function_beside,
    prepared_beside,
    processes_beside,
)


# JAX's at-fork hook warns of its threads; functions here use none of them.
pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked"),
    pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning"),
    pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning"),
]


def _ended(_: None) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("processes", [0, 1, 3])
def test_a_shared_map_is_a_map(processes: int) -> None:
    with SharedMap[int, tuple[int, int]](lambda x: (x, x * x), processes) as run:
        assert run(range(20)) == [(x, x * x) for x in range(20)]
        assert run([]) == []
        assert run([7]) == [(7, 49)]


def test_a_shared_map_computes_in_other_processes() -> None:
    with SharedMap(lambda _: os.getpid(), 2) as run:
        assert {os.getpid()} < set(run(range(50)))


def test_long_arguments_and_results_pass() -> None:
    with ForkedFunction[bytes, bytes](lambda: lambda x: x + x) as forked:
        for length in (1, 3_000_000):
            forked.send(bytes(length))
            assert forked.receive() == bytes(2 * length)


def test_errors_are_raised_here() -> None:
    with ForkedFunction[str, int](lambda: lambda text: int(text)) as forked:
        forked.send("no number")
        with pytest.raises(ValueError, match="invalid literal"):
            forked.receive()
        forked.send("3")
        assert forked.receive() == 3


def test_an_ended_process_is_reported() -> None:
    with ForkedFunction[None, None](lambda: _ended) as forked:
        forked.send(None)
        with pytest.raises(ChildProcessError, match="has ended"):
            forked.receive()


def test_processes_end_in_any_order() -> None:
    first, second = (ForkedFunction[int, int](lambda: lambda x: -x) for _ in range(2))
    first.close()
    second.send(1)
    assert second.receive() == -1
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
    with computed_beside(os.getpid, allowed=False) as result:
        assert result() == os.getpid()


@pytest.mark.parametrize("beside", [False, True])
def test_a_result_can_be_asked_for_again(monkeypatch: pytest.MonkeyPatch, beside: bool) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)
    with function_beside(lambda x: str(x), allowed=beside) as begin:
        result = begin(1)
        assert (result(), result()) == ("1", "1")


@pytest.mark.parametrize("beside", [False, True])
def test_a_function_is_prepared_where_it_computes(
    monkeypatch: pytest.MonkeyPatch, beside: bool
) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)

    def prepare() -> Callable[[int], tuple[int, int]]:
        process = os.getpid()
        return lambda x: (x, process)

    with prepared_beside(prepare, allowed=beside) as begin:
        result, process = begin(3)()
    assert result == 3
    assert (process != os.getpid()) == beside


def test_what_preparing_raises_is_raised_with_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("jaxcslc._processes.can_fork", lambda: True)

    def prepare() -> Callable[[int], int]:
        raise ValueError("nothing to prepare")

    with prepared_beside(prepare) as begin:
        result = begin(3)
        with pytest.raises(ValueError, match="nothing to prepare"):
            result()


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
