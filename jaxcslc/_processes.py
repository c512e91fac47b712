"""Forked processes that compute next to this one, where a program allows them.

`processes_beside` allows them within a `with`, and `can_fork` says whether forking is possible.
`ForkedFunction` is the mechanism. `function_beside`, `prepared_beside` and `computed_beside` run
one computation, at once in this process where forking is not possible. `SharedMap` divides many
arguments among processes. For work that releases the interpreter's lock, see `_chunks`.
"""

import contextlib
import os
import pickle
import select
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from ._environment import core_count


Argument = TypeVar("Argument")
Result = TypeVar("Result")

_MOST_PROCESSES = 3  # beside this one; each holds what it computes with
# Ends of pipes to processes that have not been closed.
_DESCRIPTORS: set[int] = set()
_ALLOWED: ContextVar[bool] = ContextVar("processes beside this one", default=False)


@contextlib.contextmanager
def processes_beside() -> Generator[None]:
    """Allow processes beside this one, forked from it, inside of the `with`.

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
    if not _ALLOWED.get() or core_count() < 2:
        return False
    names: list[str] = []
    for path in Path("/proc/self/task").glob("*/comm"):
        with contextlib.suppress(OSError):  # of a thread that has just ended
            names.append(path.read_text())
    return bool(names) and not any("XLA" in name for name in names)  # none: not Linux


class ForkedFunction(Generic[Argument, Result]):
    """A function in a process of its own, which has what this one had when it was made.

    Arguments and results are pickled; of what the function changes, nothing comes back. The
    process ends with this one at the latest.

    - `prepare`: makes the function, of one argument; called in the process before there is one.

    To be made only where `can_fork` says so, as `function_beside` does. Not of `multiprocessing`:
    processes that it forks outlive one that is killed, whose end of a pipe they hold open.
    """

    def __init__(self, prepare: Callable[[], Callable[[Argument], Result]]) -> None:
        from_parent, to_child = os.pipe()
        from_child, to_parent = os.pipe()
        self._process = os.fork()
        if not self._process:
            # What others hold open, their processes do not see the end of.
            for descriptor in (to_child, from_child, *_DESCRIPTORS):
                os.close(descriptor)
            _serve(prepare, from_parent, to_parent)
        os.close(from_parent)
        os.close(to_parent)
        self._arguments, self._results = open(to_child, "wb"), open(from_child, "rb")  # noqa: SIM115
        _DESCRIPTORS.update((to_child, from_child))

    def send(self, argument: Argument) -> None:
        """Compute for an argument; only after the result for the one before was received."""
        with contextlib.suppress(BrokenPipeError):  # receiving says so
            pickle.dump(argument, self._arguments, pickle.HIGHEST_PROTOCOL)
            self._arguments.flush()

    def receive(self) -> Result:
        """The result for the argument that was sent last.

        **Raises**

        - what the function raised, or what makes it.
        - `ChildProcessError`: the process has ended.
        """
        try:
            result, error = pickle.load(self._results)
        except (EOFError, pickle.UnpicklingError):
            raise ChildProcessError("a process that computed beside this one has ended") from None
        if error is not None:
            raise error
        return result

    def fileno(self) -> int:
        """Return the file descriptor that becomes readable when there is a result."""
        return self._results.fileno()

    def close(self) -> None:
        """End the process."""
        if not self._process:
            return
        _DESCRIPTORS.difference_update((self._arguments.fileno(), self._results.fileno()))
        with contextlib.suppress(BrokenPipeError):
            self._arguments.close()
        self._results.close()
        os.waitpid(self._process, 0)
        self._process = 0

    def __enter__(self) -> "ForkedFunction[Argument, Result]":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _serve(prepare: Callable[[], Callable[[Any], Any]], arguments: int, results: int) -> None:
    """Run the loop of a forked process until nobody sends arguments. It does not return."""
    _ALLOWED.set(False)
    try:
        function = _prepared(prepare)
        with open(arguments, "rb") as reader, open(results, "wb") as writer:
            while True:
                argument = pickle.load(reader)
                try:
                    result = pickle.dumps((function(argument), None), pickle.HIGHEST_PROTOCOL)
                except Exception as error:
                    result = pickle.dumps((None, error), pickle.HIGHEST_PROTOCOL)
                writer.write(result)
                writer.flush()
    except BaseException:  # the end of the arguments, an interruption, or a result nobody reads
        pass
    finally:
        # Without what the parent does at its end, such as writing what it has buffered.
        os._exit(0)


def _prepared(prepare: Callable[[], Callable[[Any], Any]]) -> Callable[[Any], Any]:
    """The function, or one that raises what making it did."""
    try:
        return prepare()
    except Exception as error:
        reason = error

    def fail(_: object) -> Any:
        raise reason

    return fail


@contextlib.contextmanager
def function_beside(
    function: Callable[[Argument], Result], *, allowed: bool = True
) -> Generator[Callable[[Argument], Callable[[], Result]]]:
    """A function that begins to compute for its argument, in a process beside this one, and returns
    another one that waits for the result.

    Computed at once where `can_fork` says no. The process has what this one has now.

    - `function`: of one argument; called once at most.
    - `allowed`: False computes at once.

    >>> with function_beside(lambda x: 2 * x) as begin:
    ...     result = begin(21)
    ...     result()
    42
    """
    with prepared_beside(lambda: function, allowed=allowed) as begin:
        yield begin


@contextlib.contextmanager
def prepared_beside(
    prepare: Callable[[], Callable[[Argument], Result]], *, allowed: bool = True
) -> Generator[Callable[[Argument], Callable[[], Result]]]:
    """`function_beside` for a function that is made first: in the process, before its argument is
    known.

    - `prepare`: makes the function, of one argument.

    >>> with prepared_beside(lambda: (3).__mul__) as begin:
    ...     begin(14)()
    42
    """
    if not (allowed and can_fork()):

        def computed(argument: Argument) -> Callable[[], Result]:
            result = prepare()(argument)
            return lambda: result

        yield computed
        return
    with ForkedFunction(prepare) as forked:

        def begun(argument: Argument) -> Callable[[], Result]:
            forked.send(argument)
            return lru_cache(maxsize=1)(forked.receive)

        yield begun


@contextlib.contextmanager
def computed_beside(
    compute: Callable[[], Result], *, allowed: bool = True
) -> Generator[Callable[[], Result]]:
    """`function_beside` for a function of no argument, which begins now.

    >>> with computed_beside(lambda: 42) as answer:
    ...     answer()
    42
    """

    def without_argument(_: None) -> Result:
        return compute()

    with function_beside(without_argument, allowed=allowed) as begin:
        yield begin(None)


class SharedMap(Generic[Argument, Result]):
    """A map whose arguments this process and those beside it share.

    - `function`: of one argument.
    - `processes`: beside this one; by default one for each further core.
    """

    def __init__(
        self, function: Callable[[Argument], Result], processes: int | None = None
    ) -> None:
        if processes is None:
            processes = min(core_count() - 1, _MOST_PROCESSES)
        self._function = function
        self._forked = [ForkedFunction(lambda: function) for _ in range(processes)]

    def __call__(self, arguments: Iterable[Argument]) -> list[Result]:
        """The results, in the order of the arguments."""
        listed = list(arguments)
        todo, results = deque(range(len(listed))), dict[int, Result]()
        idle, busy = deque(self._forked), dict[ForkedFunction[Argument, Result], int]()
        while todo or busy:
            while idle and len(todo) > 1:
                index, forked = todo.pop(), idle.popleft()
                busy[forked] = index
                forked.send(listed[index])
            if todo:
                index = todo.popleft()
                results[index] = self._function(listed[index])
            for forked in _ready(list(busy), wait=not todo):
                results[busy.pop(forked)] = forked.receive()
                idle.append(forked)
        return [results[index] for index in range(len(listed))]

    def close(self) -> None:
        """End the processes."""
        for forked in self._forked:
            forked.close()

    def __enter__(self) -> "SharedMap[Argument, Result]":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _ready(
    forked: Sequence[ForkedFunction[Any, Any]], *, wait: bool
) -> list[ForkedFunction[Any, Any]]:
    """Return the processes that have a result. Wait for one if there is nothing else to do."""
    if not forked:
        return []
    return select.select(forked, [], [], None if wait else 0.0)[0]
