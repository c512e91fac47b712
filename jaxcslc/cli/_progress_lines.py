"""Lines of progress on standard error."""

import contextlib
import time
from collections.abc import Callable, Generator, Mapping
from threading import Event, Thread


# Seconds before the first line, and between lines while a step goes on.
FIRST, BETWEEN = 30.0, 30.0

# Of steps of a long identification, the part of the time that has passed when they begin, as
# measured on 600,000 samples of 7 joints with settings chosen: for an estimate of what is left.
PASSED = {
    "choosing settings": 0.08,
    "preparing patterns": 0.40,
    "fitting coefficients": 0.50,
    "computing systematic errors": 0.66,
    "fitting possible bodies": 0.74,
    "computing errors": 0.76,
    "writing": 0.87,
}


@contextlib.contextmanager
def progress_lines(
    first: str,
    write: Callable[[str], None],
    *,
    after: float = FIRST,
    every: float = BETWEEN,
    passed: Mapping[str, float] = PASSED,
    clock: Callable[[], float] = time.monotonic,
) -> Generator[Callable[[str], None]]:
    """Writes a line when a step begins, and now and then while it goes on.

    Nothing at all if everything takes less than `after` seconds. A line says how long it has taken
    and, where the step is known, about how long it still takes.

    **Arguments**

    - `first`: the step that it begins with.
    - `write`: is called with each line, from another thread too.
    - `after`, `every`: seconds before the first line, and between lines of one step.
    - `passed`: the part of the time that has passed when a step begins; without it, no line says
      what is left.
    - `clock`: the time [s].

    **Returns** a function to be called with the step that begins.
    """
    start, done = clock(), Event()
    current = [(first, 0.0)]  # the step, and when it began

    def line() -> str:
        name, begun = current[0]
        seconds = clock() - start
        text = f"jaxcslc: {name}, {seconds:.0f} s so far"
        if name in passed and begun > 0.0:
            # As fast as before, until the next step should have begun.
            share = passed[name]
            following = min((other for other in passed.values() if other > share), default=0.99)
            share = min(share * seconds / begun, following)
            text += f", about {_rounded(seconds * (1.0 - share) / share)} s left"
        return text

    def watch() -> None:
        if done.wait(after):
            return
        write(line())
        while not done.wait(every):
            write(line())

    def step(text: str) -> None:
        current[0] = text, clock() - start
        if clock() - start > after:
            write(line())

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield step
    finally:
        done.set()
        thread.join()


def _rounded(seconds: float) -> str:
    """Round seconds to two digits at most."""
    return f"{float(f'{seconds:.1g}' if seconds < 10 else f'{seconds:.2g}'):.0f}"
