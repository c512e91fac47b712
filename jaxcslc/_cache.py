"""The folder of the user's own in which compiled programs are kept, and what is checked of it.

Loading a compiled program runs it, so that a folder into which somebody else can write would let
them run theirs. The folder is `jaxcslc` in `$XDG_CACHE_HOME`, or where the platform keeps caches:
`~/.cache`, `~/Library/Caches` on macOS, `%LOCALAPPDATA%` on Windows. It is made with mode 0700. It
is used only if it is a folder, not a link, that belongs to the user and into which nobody else can
write. The name of a file in it ends with the hash of its content, which is checked before the file
is used. Without such a folder programs are compiled anew in every process.

Removing the folder does no harm.
"""

import hashlib
import os
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from ._scratch import remove_left_behind, scratch_folder


Loaded = TypeVar("Loaded")


def cache_folder() -> Path | None:
    """Return the folder, made if it is missing; None if there is none that can be trusted.

    >>> folder = cache_folder()
    >>> folder is None or folder.stat().st_mode & 0o022 == 0
    True
    """
    try:
        folder = _parent() / "jaxcslc"
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
    except (OSError, RuntimeError):  # a home that cannot be written, or none at all
        return None
    return folder if stat.S_ISDIR(status.st_mode) and _is_own(status) else None


def load_kept(key: str, suffix: str, load: Callable[[Path], Loaded | None]) -> Loaded | None:
    """Return what a kept file holds; None if there is none that is whole.

    **Arguments**

    - `key`: of what the file was made from: hexadecimal digits.
    - `suffix`: of the file's name, such as `.so`.
    - `load`: gives None for a file that it cannot load.
    """
    folder = cache_folder()
    files = () if folder is None else folder.glob(f"{key}-*{suffix}")
    for file in files:
        if file.name == f"{key}-{_digest_of_own(file)}{suffix}":
            loaded = load(file)
            if loaded is not None:
                return loaded
    return None


def make_kept(
    key: str,
    suffix: str,
    make: Callable[[Path], bool],
    load: Callable[[Path], Loaded | None],
) -> Loaded | None:
    """Return what a new file holds, and keep the file if there is a folder for it.

    **Arguments**

    - `key`, `suffix`, `load`: as of `load_kept`.
    - `make`: writes the file at a path, in a folder that nobody else can write into, and says
      whether it did.

    **Raises** `OSError` if there is no room for the file.
    """
    folder = cache_folder()
    if folder is not None:
        remove_left_behind(folder)
    with TemporaryDirectory() if folder is None else scratch_folder(folder, key) as scratch:
        fresh = Path(scratch) / f"{key}{suffix}"
        if not make(fresh):
            return None
        if folder is None:
            return load(fresh)
        kept = folder / f"{key}-{_digest_of_own(fresh)}{suffix}"
        os.replace(fresh, kept)  # whole or not at all, whoever else does the same
    return load(kept)


def _parent() -> Path:
    if configured := os.environ.get("XDG_CACHE_HOME"):
        return Path(configured)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    if sys.platform == "win32" and (local := os.environ.get("LOCALAPPDATA")):
        return Path(local)
    return Path.home() / ".cache"


def _is_own(status: os.stat_result) -> bool:
    """Return whether something belongs to the user, and nobody else can write into it."""
    if os.name != "posix":  # a profile's folders are its user's
        return True
    return status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _digest_of_own(file: Path) -> str | None:
    """Return the hash of a file of the user's own; None of a link, or what others can write."""
    try:
        descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    except OSError:
        return None
    with os.fdopen(descriptor, "rb") as opened:
        if not _is_own(os.fstat(descriptor)):
            return None
        return hashlib.file_digest(opened, "sha256").hexdigest()
