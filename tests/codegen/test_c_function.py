"""Functions of C code: what is passed, what is refused, and which kept code is loaded."""

import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from jaxcslc._cache import cache_folder
from jaxcslc.codegen import INTEGERS, LONG, CArray, CFunction, CRows, _c_function


needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
needs_owners = pytest.mark.skipif(os.name != "posix", reason="files have no owners")

ADDED = """void added(const double* x, const double* y, const long* order, double* sum, long n)
{ for (long i = 0; i < n; ++i) sum[i] = x[i] + (y ? y[order[i]] : 0.0); }"""
KINDS = (
    *(CArray("numbers"), CArray("others", optional=True), CArray("numbers", INTEGERS)),
    *(CArray("numbers", written=True), LONG),
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of kept programs, empty; nothing is loaded yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    _c_function._library.cache_clear()
    yield tmp_path / "caches" / "jaxcslc"
    _c_function._library.cache_clear()


def number(value: int = 42) -> int | None:
    """What a compiled function writes, in a process that has not loaded it; None if it cannot."""
    source = f"void number(long* x) {{ *x = {value}; }}"
    _c_function._library.cache_clear()
    function = CFunction(source, "number", (CArray("one", INTEGERS, written=True),))
    if not function.is_available:
        return None
    result = np.zeros(1, INTEGERS)
    function(result)
    return int(result[0])


@needs_compiler
def test_arrays_are_handed_over_as_c_reads_them() -> None:
    """Other numbers and strides become those that the function declares; None is no array."""
    added, total = CFunction(ADDED, "added", KINDS), np.empty(3)
    every_second = np.arange(6.0)[::2]
    added(every_second, np.arange(4), [3, 0, 1], total, 3)
    assert total.tolist() == [3.0, 2.0, 5.0]
    added.bound(every_second.astype(np.float32), None, [0, 0, 0])(total, 2)
    assert total.tolist() == [0.0, 2.0, 5.0]


@needs_compiler
def test_rows_are_handed_over_by_their_addresses() -> None:
    source = "void copy(const double* const* x, double* const* y) { y[1][0] = x[2][1]; }"
    copy = CFunction(source, "copy", (CRows("numbers"), CRows("numbers", written=True)))
    result = np.zeros((2, 3))
    copy(list(np.arange(12.0).reshape(4, 3).T[:, 1:]), list(result))
    assert result.tolist() == [[0.0] * 3, [8.0, 0.0, 0.0]]


@needs_compiler
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            (np.ones(3), None, [0, 0], np.ones(3), 3),
            r"^added: .* \(numbers 3\), got .* \(2,\)$",
        ),
        ((np.ones((3, 1)), None, [0] * 3, np.ones(3), 3), r"of \(3, 1\)"),
        ((np.ones(3), None, [0] * 3, np.ones(6)[::2], 3), "contiguous"),
        ((np.ones(3), None, [0] * 3, np.ones(3, np.float32), 3), "float32"),
        ((np.ones(3), None, [0] * 3, np.broadcast_to(1.0, 3), 3), "contiguous"),
    ],
)
def test_other_arrays_are_refused(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CFunction(ADDED, "added", KINDS)(*arguments)
    with pytest.raises(TypeError, match="added: expected 5 arguments, got 4"):
        CFunction(ADDED, "added", KINDS)(*arguments[:-1])


@pytest.mark.parametrize("compiler", ["", "no-such-compiler", "false"])
def test_what_cannot_be_compiled(
    folder: Path, monkeypatch: pytest.MonkeyPatch, compiler: str
) -> None:
    """A compiler that is missing, one that fails, and a program that is wrong."""
    assert not CFunction("void wrong(void) {", "wrong", ()).is_available
    monkeypatch.setenv("CC", compiler)
    one = CFunction("void one(void) { }", "one", ())
    assert not one.is_available
    with pytest.raises(OSError, match="no C compiler; expected cc"):
        one()
    assert not list(folder.glob("*.so"))


@needs_compiler
def test_code_is_kept_and_used_while_it_is_whole(folder: Path) -> None:
    assert number() == 42
    (kept,) = folder.iterdir()
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    written = kept.stat().st_mtime_ns
    assert number() == 42 and kept.stat().st_mtime_ns == written
    damaged = kept.with_name("damaged")
    damaged.write_bytes(b"half a library")
    damaged.replace(kept)
    assert number() == 42 and kept.stat().st_mtime_ns != written


def planted(folder: Path) -> Path:
    """A library in the place of another one: its name says what the other one's does."""
    assert (number(1), number(2)) == (1, 2)
    one, other = sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)
    key = one.name.partition("-")[0]
    return other.replace(one.with_name(f"{key}-{other.name.partition('-')[2]}"))


@needs_compiler
@needs_owners
def test_code_that_others_can_write_is_not_loaded(folder: Path) -> None:
    """What stands in the place of a library is loaded if the user alone can have put it there."""
    library = planted(folder)
    for path in folder.iterdir():
        if path != library:
            path.unlink()
    assert number(1) == 2, "the user's own"
    library.chmod(0o722)
    assert number(1) == 1
    link = folder.parent / "elsewhere"
    library.chmod(0o700)
    library.rename(link)
    library.symlink_to(link)
    assert number(1) == 1


@needs_compiler
@needs_owners
@pytest.mark.parametrize("way", ["others write", "group writes", "a link", "a file", "no home"])
def test_a_folder_that_is_not_the_users_own_is_not_used(
    folder: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """Code is compiled into a folder that only this process knows, which is gone afterwards."""
    planted(folder)
    before = sorted(folder.iterdir())
    if way == "a link":
        folder.rename(folder.with_name("elsewhere"))
        folder.symlink_to(folder.with_name("elsewhere"))
    elif way == "a file":
        folder.rename(folder.with_name("elsewhere"))
        folder.touch()
    elif way == "no home":
        monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/caches")
    else:
        folder.chmod(0o702 if way == "others write" else 0o720)
    assert cache_folder() is None
    assert number(1) == 1
    if folder.is_dir():
        assert sorted(folder.iterdir()) == before


@needs_owners
def test_another_users_folder_is_not_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder() == folder
    monkeypatch.setattr(os, "geteuid", lambda: folder.stat().st_uid + 1)
    assert cache_folder() is None
