"""Files and folders that replace their target only once they are whole.

`unfinished` writes one file and `all_or_nothing` several into a folder. What is not whole yet lies
in a hidden folder that its process holds locked. The lock ends with the process, however that
ends, on this machine or in a container: what nobody holds is removed.
"""

import contextlib
import glob
import os
import shutil
import tempfile
from collections.abc import Generator
from pathlib import Path


try:
    import fcntl
except ImportError:  # Windows, where a scratch folder that a killed process left stays
    fcntl = None

_SUFFIX = ".unfinished"  # of scratch folders


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
    What a process that was killed left behind is removed. A folder that is there holds its scratch
    itself: it may be another disk, and the folder around it may be write-protected.

    **Raises** as `check_output_folder`.
    """
    check_output_folder(folder)
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
    parent = folder if folder.exists() else folder.parent
    remove_left_behind(parent, folder.name)
    with _scratch_folder(parent, folder.name) as scratch:
        whole = scratch / folder.name
        whole.mkdir()
        yield whole
        if not folder.exists():
            with contextlib.suppress(OSError):  # another process was faster
                os.rename(whole, folder)
                return
        for path in sorted(whole.iterdir()):
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
    """Remove scratch folders whose processes are no more.

    **Arguments**

    - `name`: what they were to become; of any name if omitted.
    """
    stem = "*" if name is None else glob.escape(name)
    for left in parent.glob(f".{stem}-*{_SUFFIX}"):
        with _held(left) as nobody_else:
            if nobody_else:
                shutil.rmtree(left, ignore_errors=True)


@contextlib.contextmanager
def _scratch_folder(parent: Path, name: str) -> Generator[Path]:
    """Make a hidden folder in `parent` for what is to become `name`; removed at the end."""
    while True:
        try:
            scratch = Path(tempfile.mkdtemp(prefix=f".{name}-", suffix=_SUFFIX, dir=parent))
        except OSError as error:  # of a name that nobody knows
            error.filename = str(parent / name)
            raise
        with _held(scratch, wait=True):
            # Before it was locked, another process could take it for left behind.
            if not scratch.exists():
                continue
            try:
                yield scratch
            finally:
                shutil.rmtree(scratch, ignore_errors=True)
            return


@contextlib.contextmanager
def _held(folder: Path, *, wait: bool = False) -> Generator[bool]:
    """Lock a folder of the user's own; False if it is another's, a link, or cannot be locked.

    - `wait`: for another process that holds it; False otherwise.
    """
    if fcntl is None:
        yield False
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        yield False
        return
    try:
        status = os.fstat(descriptor)
        locked = status.st_uid == os.geteuid()
        if locked:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except OSError:
                locked = False
        yield locked
    finally:
        os.close(descriptor)
