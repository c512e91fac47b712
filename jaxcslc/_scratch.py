"""Files and folders that replace their target only once they are whole, and what they may replace.

`unfinished` writes one file, `all_together` several of one folder, and `all_or_nothing` a folder.
What is not whole yet lies in a hidden folder that its process holds locked. The lock ends with the
process, however that ends, on this machine or in a container: what nobody holds is removed.

The file `.jaxcslc` of a folder lists the files in it that `all_together` and `all_or_nothing`
wrote, with hashes of their content. `check_replaceable` has the rule for what may be replaced: a
file that is listed and was not changed since. So the same command can run twice, and no other file
is lost.
"""

import contextlib
import ctypes
import glob
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any


try:
    import fcntl
except ImportError:  # Windows, where a scratch folder that a killed process left stays
    fcntl = None

_SUFFIX = ".unfinished"  # of scratch folders
MARKER = ".jaxcslc"
"""Name of the file that lists the files of a folder that jaxcslc wrote."""
_LARGEST_MARKER = 1 << 20  # bytes; a list of ten thousand files
_AT_FDCWD, _EXCHANGE = -100, 2  # of Linux's renameat2
_SWAP = 2  # of macOS's renamex_np

Digests = dict[str, list[str]]


def check_output_folder(folder: Path) -> None:
    """**Raises** `ValueError` if the results cannot go there: a file, or no right to write."""
    for path in (folder, *folder.absolute().parents):
        if path.exists():
            if not path.is_dir():
                raise ValueError(f"{path}: expected a folder for the results, this is a file")
            if not os.access(path, os.W_OK | os.X_OK):
                raise ValueError(f"{path}: expected a folder that can be written to")
            return


def check_replaceable(
    folder: Path, names: Iterable[str] = (), *, whole: bool = True, overwrite: bool = False
) -> None:
    """Check that writing into a folder replaces nothing that jaxcslc did not write there.

    **Arguments**

    - `names`: of the files that are written.
    - `whole`: whether the folder is for them alone: new, empty of visible files, or one that was
      written before. Otherwise they may go beside others.
    - `overwrite`: other files may be replaced; folders never.

    **Raises** `FileExistsError` for the first file that may not be replaced.
    """
    if not folder.is_dir():
        return
    listed = _listed(folder)
    for name in names:
        if (folder / name).is_dir():
            raise FileExistsError(f"{folder / name}: expected no folder of that name")
    if overwrite:
        return
    if whole:
        visible = sorted(path.name for path in folder.iterdir() if path.name[0] != ".")
        if visible and not listed:
            raise FileExistsError(
                f"{folder}: has files that jaxcslc did not write, as {visible[0]}; expected a new"
                " folder, an empty one, or --overwrite"
            )
    for name in names:
        path = folder / name
        if os.path.lexists(path) and not _is_unchanged(path, listed):
            what = "was changed since jaxcslc wrote it" if name in listed else "exists already"
            raise FileExistsError(f"{path}: {what}; expected another name, or --overwrite")


@contextlib.contextmanager
def all_or_nothing(folder: Path, *, earlier: Iterable[str] = ()) -> Generator[Path]:
    """Make a scratch folder that takes the place of `folder` when all its files are written.

    The folder is exchanged as a whole where the file system can. Otherwise its files are replaced
    one after the other: in a mount point, in a folder that is another user's, or that the process
    is in. Files of other names stay. If writing fails, `folder` stays as it was. What a process
    that was killed left is removed.

    **Arguments**

    - `earlier`: names of files that are removed if they are of an earlier call, were not changed
      since, and are not written again.

    **Raises** as `check_output_folder`.
    """
    check_output_folder(folder)
    folder = folder.resolve()  # the folder that a link names is replaced, not the link
    folder.parent.mkdir(parents=True, exist_ok=True)
    remove_left_behind(folder.parent, folder.name)
    remove_left_behind(folder)
    parent = folder.parent if not folder.exists() or _can_be_exchanged(folder) else folder
    with scratch_folder(parent, folder.name) as scratch:
        whole = scratch / folder.name
        whole.mkdir()
        yield whole
        listed, digests = _listed(folder), _digests(whole)
        gone = {name for name in earlier if _is_unchanged(folder / name, listed)} - {*digests}
        kept = {name: listed[name] for name in listed if name not in gone}
        if kept or digests:
            _write_marker(whole, kept | digests)
        with _uninterrupted():
            _publish(whole, folder, gone)


@contextlib.contextmanager
def all_together(paths: Sequence[Path]) -> Generator[list[Path]]:
    """Name files to write, which take the places of `paths` once all of them are whole.

    If writing fails, all stay as they were. They are replaced one after the other: if the process
    is killed in between, each is still whole.

    **Arguments**

    - `paths`: of one folder, which exists.
    """
    folder, names = paths[0].parent, [path.name for path in paths]
    remove_left_behind(folder, names[0])
    with scratch_folder(folder, names[0]) as scratch:
        yield [scratch / name for name in names]
        digests = _digests(scratch)
        _write_marker(scratch, _listed(folder) | digests)
        with _uninterrupted():
            _replace(scratch, folder, digests, ())


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
    with scratch_folder(path.parent, path.name) as scratch:
        yield scratch / path.name
        os.replace(scratch / path.name, path)


@contextlib.contextmanager
def hidden_beside(path: Path) -> Generator[Path]:
    """Make a hidden file in the folder of `path`, with its suffix; removed at the end.

    For a trial of content that names other files by paths relative to its own.
    """
    remove_left_behind(path.parent, path.stem, path.suffix)
    descriptor, name = tempfile.mkstemp(f"{_SUFFIX}{path.suffix}", f".{path.stem}-", path.parent)
    os.close(descriptor)
    with _held(Path(name), wait=True):
        try:
            yield Path(name)
        finally:
            Path(name).unlink(missing_ok=True)


@contextlib.contextmanager
def scratch_folder(parent: Path, name: str) -> Generator[Path]:
    """Make a hidden folder in `parent` for what is to become `name`; removed at the end."""
    while True:
        with contextlib.ExitStack() as stack:
            with _uninterrupted():
                try:
                    scratch = Path(tempfile.mkdtemp(_SUFFIX, f".{name}-", parent))
                except OSError as error:  # of a name that nobody knows
                    error.filename = str(parent / name)
                    raise
                stack.callback(_remove, scratch)
            stack.enter_context(_held(scratch, wait=True))
            # Before it was locked, another process could take it for left behind.
            if scratch.exists():
                yield scratch
                return


def _remove(scratch: Path) -> None:
    with _uninterrupted():
        shutil.rmtree(scratch, ignore_errors=True)


def remove_left_behind(parent: Path, name: str | None = None, suffix: str = "") -> None:
    """Remove scratch whose processes are no more.

    **Arguments**

    - `name`: what it was to become; of any name if omitted.
    - `suffix`: of files of `hidden_beside`; none for folders.
    """
    stem = "*" if name is None else glob.escape(name)
    for left in parent.glob(f".{stem}-*{_SUFFIX}{glob.escape(suffix)}"):
        with _held(left) as nobody_else:
            if nobody_else and suffix:
                left.unlink(missing_ok=True)
            elif nobody_else:
                shutil.rmtree(left, ignore_errors=True)


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digests(folder: Path) -> Digests:
    return {path.name: [_digest(path)] for path in folder.iterdir() if path.is_file()}


def _is_unchanged(path: Path, listed: Mapping[str, Sequence[str]]) -> bool:
    if path.name not in listed or path.is_symlink() or not path.is_file():
        return False
    return _digest(path) in listed[path.name]


def _listed(folder: Path) -> Digests:
    """Return the hashes of the files that jaxcslc wrote into a folder, by name.

    A name has two while its file is replaced.
    """
    path = folder / MARKER
    try:
        if path.stat().st_size > _LARGEST_MARKER:
            return {}
        entries = json.loads(path.read_text(encoding="utf-8"))["files"].items()
        return {name: [str(digest) for digest in digests] for name, digests in entries}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}  # of no file: all that is there is kept


def _write_marker(folder: Path, digests: Digests) -> None:
    about = "Files that jaxcslc wrote here, and their SHA-256. It replaces no others."
    text = json.dumps({"about": about, "files": dict(sorted(digests.items()))}, indent=1)
    (folder / MARKER).write_text(f"{text}\n", encoding="utf-8")


def _publish(whole: Path, folder: Path, gone: Collection[str]) -> None:
    """Put a new folder in the place of the one that is there, if any, without files of that."""
    if not folder.exists():
        with contextlib.suppress(OSError):  # another process was faster
            os.rename(whole, folder)
            return
    written = [path.name for path in whole.iterdir()]
    if whole.parents[1] == folder:
        _replace(whole, folder, written, gone)
    elif not _exchanged(whole, folder, gone):
        _copy(whole, folder, written, gone)


def _copy(whole: Path, folder: Path, written: Iterable[str], gone: Iterable[str]) -> None:
    """Replace files of a folder, which may be on another disk, by copies."""
    with scratch_folder(folder, folder.name) as scratch:  # perhaps another disk
        for name in written:
            copy = shutil.copytree if (whole / name).is_dir() else shutil.copyfile
            copy(whole / name, scratch / name)
        _replace(scratch, folder, written, gone)


def _can_be_exchanged(folder: Path) -> bool:
    """Return whether a folder may be exchanged for another one of the same name."""
    try:
        at_work_in_it = Path.cwd().is_relative_to(folder)  # a shell would be left in the old one
        status, parent = folder.stat(), folder.parent.stat()
    except OSError:
        return False
    return (
        os.name == "posix"
        and not at_work_in_it
        and status.st_uid == os.geteuid()
        and status.st_dev == parent.st_dev
        and os.access(folder.parent, os.W_OK | os.X_OK)
        and not any(folder.glob(f".*{_SUFFIX}"))  # another process writes into it
    )


def _exchanged(whole: Path, folder: Path, gone: Collection[str]) -> bool:
    """Exchange a new folder for the one that is there, whose other files are carried over.

    **Returns** False, with `folder` as it was, if that is not possible.
    """
    written = {path.name for path in whole.iterdir()}
    if any((place / name).is_dir() for place in (whole, folder) for name in written):
        return False
    try:
        _carry_over(folder, whole, written.union(gone))
        shutil.copystat(folder, whole)
        if whole.stat().st_gid != folder.stat().st_gid or not _swap(whole, folder):
            return False
    except OSError:  # no hard links, or a mount point within
        return False
    with contextlib.suppress(OSError):
        _carry_over(whole, folder, written.union(gone))  # what was made meanwhile
    return True


def _carry_over(source: Path, target: Path, others: Collection[str]) -> None:
    """Link the content of a folder into another one, without some names."""
    for path in source.iterdir():
        name = path.name
        if name in others or os.path.lexists(target / name):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.copytree(path, target / name, symlinks=True, copy_function=os.link)
        else:
            os.link(path, target / name, follow_symlinks=False)


def _swap(first: Path, second: Path) -> bool:
    """Exchange two folders in one step; False where the system cannot."""
    library, names = ctypes.CDLL(None), (os.fsencode(first), os.fsencode(second))
    if sys.platform == "darwin":
        return library.renamex_np(*names, _SWAP) == 0
    if not hasattr(library, "renameat2"):
        return False
    return library.renameat2(_AT_FDCWD, names[0], _AT_FDCWD, names[1], _EXCHANGE) == 0


def _replace(whole: Path, folder: Path, names: Iterable[str], gone: Iterable[str]) -> None:
    """Move whole files into a folder one after the other, and remove others.

    Until all of them are there, the folder's marker lists the old and the new ones.
    """
    old, new = _listed(folder), _listed(whole)
    both = {name: [*old.get(name, ()), *new.get(name, ())] for name in old | new}
    with unfinished(folder / MARKER) as file:
        _write_marker(file.parent, both)
    for name in sorted({*names} - {MARKER}):
        _move(whole / name, folder / name)
    for name in gone:
        (folder / name).unlink(missing_ok=True)
    os.replace(whole / MARKER, folder / MARKER)


def _move(path: Path, place: Path) -> None:
    """Move a file or a folder; of a folder that is there, other files stay."""
    if path.is_dir() and place.is_dir():
        for inside in path.iterdir():
            _move(inside, place / inside.name)
    else:
        os.replace(path, place)


@contextlib.contextmanager
def _uninterrupted() -> Generator[None]:
    """Hold back Ctrl-C, and SIGTERM where it has a handler, until the end of the `with`."""
    held: list[tuple[int, Any]] = []
    before: dict[int, Any] = {}
    if current_thread() is main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(number)):
                before[number] = handler
                signal.signal(number, lambda *arguments: held.append(arguments))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number, frame in held:
            before[number](number, frame)


@contextlib.contextmanager
def _held(scratch: Path, *, wait: bool = False) -> Generator[bool]:
    """Lock scratch of the user's own; False if it is another's, a link, or cannot be locked.

    - `wait`: for another process that holds it; False otherwise.
    """
    if fcntl is None:
        yield False
        return
    try:
        descriptor = os.open(scratch, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW)
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
