"""Threads over consecutive chunks of rows, for functions that release the interpreter's lock.

Read with `_processes`, which is for work that holds the lock.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ._environment import core_count


Result = TypeVar("Result")


def over_chunks(
    function: Callable[[int, int], Result], rows: int, most: int, align: int = 1
) -> list[Result]:
    """Return the results of a function for consecutive chunks of rows, with one thread per core.

    The function leaves the interpreter's lock alone most of the time, as C code, BLAS and NumPy's
    functions of large arrays do. Chunks are the same on any number of cores, so that sums of their
    results are, too.

    **Arguments**

    - `function`: of the first row of a chunk and of the one after its last.
    - `rows`: how many; `most`: in a chunk.
    - `align`: chunks begin at multiples of it.

    **Returns** the results in order.

    >>> over_chunks(lambda first, last: (first, last), rows=10, most=4, align=2)
    [(0, 4), (4, 8), (8, 10)]
    """
    size = max(most // align, 1) * align
    firsts = range(0, rows, size)
    lasts = [min(first + size, rows) for first in firsts]
    threads = min(core_count(), len(firsts))
    if threads < 2:
        return [function(first, last) for first, last in zip(firsts, lasts, strict=True)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(function, firsts, lasts))
