"""Settings of the command's process, made before anything is imported. None changes a result.

Figures are of `jaxcslc identify` with 2,740 samples of seven joints (3.5 s of wall time), as the
reference `panda` of `scripts.tools.references` runs it, with and without each setting.
"""

import atexit
import gc
import io
import os
import signal
import sys
from typing import NoReturn

from . import INTERRUPTED


# The status of a process that ends by `end_process`.
_STATUS: list[int] = []
# Objects between two collections of the command itself.
_COLLECT_AFTER = 100_000


def prepare_process() -> None:
    """Set the process up for arithmetic with small matrices and long columns.

    Garbage is not collected until `collect_garbage` is called: imports leave none. SIGTERM ends the
    process as Ctrl-C does, so that no scratch is left. What a terminal's encoding lacks is escaped.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    # Matrices are small: more threads of BLAS only wait for each other. On two cores they took 1.8
    # of the 9.9 s of processor time of an identification of 3,300 samples.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What it forbids, arrays of NumPy in JAX's functions, is what the command does everywhere.
    os.environ.pop("JAX_TRANSFER_GUARD", None)
    atexit.register(_end)  # the first to be registered is the last to be called
    gc.disable()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)


def _interrupt(*_: object) -> NoReturn:
    INTERRUPTED.set()
    raise KeyboardInterrupt


def collect_garbage() -> None:
    """Collect garbage from now on, of what is made from now on.

    To go through what imports have made again and again takes 0.43 s of 3.0 s of processor time.
    """
    gc.freeze()
    gc.set_threshold(_COLLECT_AFTER)
    gc.enable()


def end_process(status: int) -> NoReturn:
    """End the process with a status, when all is done that others have registered for its end.

    Modules and arrays are not taken apart one by one, which takes Python 0.13 s.
    """
    _STATUS.append(status)
    raise SystemExit(status)


def _end() -> None:
    if not _STATUS:
        return
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # closed by whoever started the process
                stream.flush()
    except OSError:  # nobody reads any more, of which Python itself tells
        return
    os._exit(_STATUS[0])
