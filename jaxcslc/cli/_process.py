"""What a process of the command sets before anything is imported: none of it changes a result."""

import atexit
import ctypes
import gc
import os
import sys
from typing import NoReturn


# The status of a process that ends by `end_process`.
_STATUS: list[int] = []
# Objects between two collections of the command itself.
_COLLECT_AFTER = 100_000
# Of mallopt(3).
_TRIM_THRESHOLD, _TOP_PAD, _MMAP_MAX, _ARENA_MAX = -1, -2, -4, -8
_NEVER, _PAD = 2**31 - 1, 64 * 2**20


def prepare_process() -> None:
    """Sets the process up for arithmetic with small matrices and long columns.

    Garbage is not collected until `collect_garbage` is called: imports leave none.
    """
    # Matrices are small: more threads of BLAS only wait for each other. On two cores they took 1.8
    # of the 9.9 s of processor time of an identification of 3,300 samples.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    atexit.register(_end)  # the first to be registered is the last to be called
    gc.disable()
    if sys.platform == "linux":
        _keep_memory()


def collect_garbage() -> None:
    """Collects garbage from now on, of what is made from now on.

    What imports have made stays. To go through it again and again took a tenth of their time.
    """
    gc.freeze()
    gc.set_threshold(_COLLECT_AFTER)
    gc.enable()


def end_process(end: SystemExit) -> NoReturn:
    """Ends the process with a status, when all is done that was registered for its end since
    `prepare_process`.

    Without taking every module and array apart, which the system does at once: that takes Python
    0.1 to 0.2 s after an identification.
    """
    if end.code is None or isinstance(end.code, int):
        _STATUS.append(end.code or 0)
    raise end


def _end() -> None:
    if not _STATUS:
        return
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except OSError:  # nobody reads any more, of which Python itself tells
        return
    os._exit(_STATUS[0])


def _keep_memory() -> None:
    """Lets the C library keep what arrays leave: the next ones are of the same lengths.

    Otherwise each array's pages go back to the system, which clears them again for the next one:
    1.5 s of processor time for 20,000 samples of seven joints. One arena, since those of further
    threads cannot hold long arrays; it takes less memory, too.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:  # a C library other than GNU's
        return
    for parameter, value in (
        (_ARENA_MAX, 1),
        (_MMAP_MAX, 0),
        (_TRIM_THRESHOLD, _NEVER),
        (_TOP_PAD, _PAD),
    ):
        mallopt(parameter, value)
