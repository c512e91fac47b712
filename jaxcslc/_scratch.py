"""Files and folders that replace their target only once they are whole.

`unfinished` writes one file and `all_or_nothing` several into a folder. Both remove what killed
processes left.
"""

import contextlib
import glob
import os
import platform
import shutil
import tempfile
from collections.abc import Generator
from pathlib import Path


def check_output_folder(folder: Path) -> None:
    """**Raises** `ValueError` if the results cannot go there: a file, or no right to write."""
    for path in (folder, *folder.absolute().parents):
        if path.exists():
            if not path.is_dir():
                raise ValueError(f"{path}: expected a folder for the results, this is a file")
            if not os.access(path, os.W_OK | os.X_OK):
                raise ValueError(f"{path}: expected a folder that can be written to")
            return


@contextlib.contextmanager
def all_or_nothing(folder: Path) -> Generator[Path]:
    """Make a scratch folder whose files move into `folder` when all of them are written.

    If writing fails, the files of `folder` stay as they were. Files of other names are not touched.
    What a process that was killed left behind is removed.

    **Raises** as `check_output_folder`.
    """
    check_output_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_left_behind(folder.parent, folder.name)
    with _scratch_folder(folder.parent, folder.name) as scratch:
        yield scratch
        folder.mkdir(exist_ok=True)
        for path in sorted(scratch.iterdir()):
            os.replace(path, folder / path.name)


@contextlib.contextmanager
def unfinished(path: Path, *, clean: bool = True) -> Generator[Path]:
    """Name a file to write, which takes the place of `path` once it is whole.

    If writing fails, or the process is killed, `path` stays as it was.

    **Arguments**

    - `path`: its folder exists.
    - `clean`: whether to look for what killed processes left of it. With many files in a folder,
      `remove_left_behind` does it once for all of them.
    """
    if clean:
        remove_left_behind(path.parent, path.name)
    with _scratch_folder(path.parent, path.name) as scratch:
        yield scratch / path.name
        os.replace(scratch / path.name, path)


def remove_left_behind(parent: Path, name: str | None = None) -> None:
    """Remove scratch folders of processes of this machine that are no more.

    **Arguments**

    - `name`: what they were to become; of any name if omitted.
    """
    node = platform.node()
    stem = "*" if name is None else glob.escape(name)
    for left in parent.glob(f".{stem}-{glob.escape(node)}-*-*"):
        process = left.name.rpartition(f"-{node}-")[2].partition("-")[0]
        if process.isdecimal() and not _is_running(int(process)):
            shutil.rmtree(left, ignore_errors=True)


@contextlib.contextmanager
def _scratch_folder(parent: Path, name: str) -> Generator[Path]:
    """Make a hidden folder in `parent` for what is to become `name`; removed at the end."""
    prefix = f".{name}-{platform.node()}-{os.getpid()}-"
    try:
        scratch = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    except OSError as error:  # of a name that nobody knows
        error.filename = str(parent / name)
        raise
    try:
        yield scratch
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _is_running(process: int) -> bool:
    if os.name != "posix":  # where the call below would interrupt the process
        return True
    try:
        os.kill(process, 0)  # sends nothing
    except ProcessLookupError:
        return False
    except OSError:  # another user's, or a number that no process has
        pass
    return True
