"""Progress of long computations: a line in notebooks and at prompts, nothing in programs."""

import contextlib
import sys
import warnings
from collections.abc import Callable, Generator


Progress = Callable[[str], None] | bool | None


@contextlib.contextmanager
def steps(progress: Progress, title: str) -> Generator[Callable[[str], None]]:
    """Yield a function to be called with a few words at the start of each step.

    - `progress`: such a function itself; True shows steps in a line of `tqdm`, which disappears at
      the end; False shows none; None shows them in notebooks and at Python's prompt, and none in
      programs. The environment variable `TQDM_DISABLE=1` turns all such lines off.
    - `title`: what is computed.

    >>> with steps(print, "identify") as step:
    ...     step("fitting coefficients")
    fitting coefficients
    """
    if callable(progress):
        yield progress
    elif progress or (progress is None and hasattr(sys, "ps1")):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="IProgress")  # tqdm then writes text
            from tqdm.auto import tqdm

            bar = tqdm(desc=title, bar_format="{desc} ({elapsed})", leave=False)
        with bar:
            yield lambda words: bar.set_description_str(f"{title}: {words}")
    else:
        yield lambda words: None
