"""Forked processes that compute next to this one, where a program allows them.

`processes_beside` allows them within a `with`, and `can_fork` says whether forking is possible.
A process serves one computation: `computed_beside` starts it at once, `function_beside` before its
argument is known. Where forking is not possible, they compute in this process. For work that
releases the interpreter's lock, `over_chunks` has threads.

Figures are of `jaxcslc identify` with 3,300 samples of a PUMA 560 (`scripts.benchmarks.run --groups
"first answer"`): the check and the lag in processes take 0.24 of 3.2 s of processor time off the
command's own process. Sharing the trials of settings as well took 0.2 s more in all.
"""

import contextlib
import math
import os
import pickle
import select
import signal
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Generic, NoReturn, TypeVar

from ._environment import core_count


Argument = TypeVar("Argument")
Result = TypeVar("Result")

_ALLOWED: ContextVar[bool] = ContextVar("processes next to this one", default=False)


@contextlib.contextmanager
def processes_beside() -> Generator[None]:
    """Allow processes next to this one, forked from it, inside of the `with`.

    What takes less than some 50 ms at a time gains nothing by threads, which wait for the
    interpreter. A program allows it that knows what else goes on in its process: a library does
    not.
    """
    token = _ALLOWED.set(True)
    try:
        yield
    finally:
        _ALLOWED.reset(token)


def allows_processes() -> bool:
    """Return whether `processes_beside` allows processes; False within such a process."""
    return _ALLOWED.get()


def can_fork() -> bool:
    """Return whether further processes are allowed, possible and worth starting.

    A forked process would have the locks of XLA's threads and not the threads. Those of BLAS, of
    Arrow and of memory allocators are made for it.
    """
    return _ALLOWED.get() and core_count() >= 2 and _has_no_threads_of_xla()


def _has_no_threads_of_xla() -> bool:
    names: list[str] = []
    for path in Path("/proc/self/task").glob("*/comm"):
        with contextlib.suppress(OSError):  # of a thread that has just ended
            names.append(path.read_text())
    return bool(names) and not any("XLA" in name for name in names)  # none: not Linux


def computed_in_bounds(compute: Callable[[], Result], *, seconds: float, memory: int) -> Result:
    """Compute in a forked process that may neither take long nor need much memory, nor harm this.

    For what native code makes of files of strangers. Computed in this process, without bounds,
    where `processes_beside` does not allow a process, or forking is not possible.

    **Arguments**

    - `seconds`: that it may take, of a clock and of a processor.
    - `memory`: that it may need in addition to what this process has [bytes].

    **Raises**

    - what the computation raised.
    - `ChildProcessError`: it took longer, or needed more, or crashed; one line says which.

    >>> computed_in_bounds(lambda: 42, seconds=1.0, memory=1 << 30)
    42
    """
    if not (_ALLOWED.get() and _has_no_threads_of_xla()):
        return compute()

    def bounded() -> Result:
        import resource  # not on Windows, where nothing forks

        pages = int(Path("/proc/self/statm").read_text().split()[0])
        bounds = {
            resource.RLIMIT_AS: pages * resource.getpagesize() + memory,
            resource.RLIMIT_CPU: math.ceil(seconds),  # a forked process begins with none
            resource.RLIMIT_CORE: 0,
        }
        for kind, bound in bounds.items():
            hard = resource.getrlimit(kind)[1]
            least = bound if hard == resource.RLIM_INFINITY else min(bound, hard)
            resource.setrlimit(kind, (least, hard))
        return compute()

    with contextlib.closing(Forked(bounded)) as forked:
        return forked.result(seconds)


class Forked(Generic[Result]):
    """A computation in a process of its own, which has what this one had when it was made.

    The result is pickled; of what the computation changes, nothing comes back.

    To be made only where `can_fork` says so. `multiprocessing` would not do: its processes outlive
    one that is killed, and need what they compute pickled.
    """

    def __init__(self, compute: Callable[[], Result]) -> None:
        results, written = os.pipe()
        self._process = os.fork()
        if not self._process:
            _answer(compute, written)
        os.close(written)
        self._results = open(results, "rb")  # noqa: SIM115

    def result(self, seconds: float | None = None) -> Result:
        """Wait for the result; once only.

        **Arguments**

        - `seconds`: to wait for it at most.

        **Raises**

        - what the computation raised.
        - `ChildProcessError`: the process has ended without a result, or has none in time.
        """
        if not select.select([self._results], [], [], seconds)[0]:
            raise ChildProcessError(f"took more than {seconds:g} s")
        try:
            result, error = pickle.load(self._results)
        except (EOFError, pickle.UnpicklingError):
            _, status = os.waitpid(self._process, 0)
            self._process = 0
            raise ChildProcessError(_end_of(status)) from None
        if error is not None:
            raise error
        return result

    def close(self) -> None:
        """End the process, whether it has a result or not."""
        self._results.close()
        if self._process:
            os.kill(self._process, signal.SIGKILL)
            os.waitpid(self._process, 0)
            self._process = 0


def _end_of(status: int) -> str:
    """Return how a process ended that has no result."""
    if not os.WIFSIGNALED(status):
        return "a process that computed beside this one has ended"
    number = os.WTERMSIG(status)
    why = " (too long)" if number == signal.SIGXCPU else ""
    return f"its process ended by {signal.Signals(number).name}{why}"


def _answer(compute: Callable[[], object], written: int) -> NoReturn:
    """Write the result, or the error, of a computation, and end the process."""
    _ALLOWED.set(False)
    try:
        try:
            result = pickle.dumps((compute(), None), pickle.HIGHEST_PROTOCOL)
        except Exception as error:
            result = pickle.dumps((None, error), pickle.HIGHEST_PROTOCOL)
        with open(written, "wb") as file:
            file.write(result)
    except BaseException:  # an interruption, or a result that nobody reads
        pass
    finally:
        # Without what the parent does at its end, such as writing what it has buffered.
        os._exit(0)


@contextlib.contextmanager
def computed_beside(compute: Callable[[], Result]) -> Generator[Callable[[], Result]]:
    """Begin to compute in a process next to this one. Give a function that waits for the result.

    Computed at once where `can_fork` says no. The process has what this one has now.

    >>> with computed_beside(lambda: 42) as answer:
    ...     answer()
    42
    """
    if not can_fork():
        result = compute()
        yield lambda: result
        return
    with contextlib.closing(Forked(compute)) as forked:
        yield lru_cache(maxsize=1)(forked.result)


@contextlib.contextmanager
def function_beside(
    function: Callable[[Argument], Result],
) -> Generator[Callable[[Argument], Callable[[], Result]]]:
    """Give a function that begins to compute for its argument in a process next to this one.

    It gives another function, which waits for the result. Computed at once where `can_fork` says
    no. The process has what this one has now, not when its argument is known.

    - `function`: of one argument; called once at most.

    >>> with function_beside(lambda x: 2 * x) as begin:
    ...     begin(21)()
    42
    """
    if not can_fork():

        def computed(argument: Argument) -> Callable[[], Result]:
            result = function(argument)
            return lambda: result

        yield computed
        return
    read, written = os.pipe()

    def compute() -> Result:
        os.close(written)
        with open(read, "rb") as arguments:
            return function(pickle.load(arguments))

    with open(written, "wb") as arguments, computed_beside(compute) as result:
        os.close(read)

        def begun(argument: Argument) -> Callable[[], Result]:
            with contextlib.suppress(BrokenPipeError):  # the result says so
                pickle.dump(argument, arguments, pickle.HIGHEST_PROTOCOL)
                arguments.flush()
            return result

        yield begun


def over_chunks(function: Callable[[int, int], Result], rows: int, most: int) -> list[Result]:
    """Return the results of a function for consecutive chunks of rows, with one thread per core.

    The function leaves the interpreter's lock alone most of the time, as C code, BLAS and NumPy's
    functions of large arrays do. Chunks are the same on any number of cores, so that sums of their
    results are, too.

    **Arguments**

    - `function`: of the first row of a chunk and of the one after its last.
    - `rows`: how many; `most`: in a chunk.

    **Returns** the results in order.

    >>> over_chunks(lambda first, last: (first, last), rows=10, most=4)
    [(0, 4), (4, 8), (8, 10)]
    """
    firsts = range(0, rows, most)
    lasts = [min(first + most, rows) for first in firsts]
    threads = min(core_count(), len(firsts))
    if threads < 2:
        return [function(first, last) for first, last in zip(firsts, lasts, strict=True)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, firsts, lasts))
