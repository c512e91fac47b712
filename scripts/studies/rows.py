"""Finished rows of a study in a file: an interrupted run goes on from there."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jaxcslc
import sim


def made_of(options: Mapping[str, Any], code: Sequence[Path] = ()) -> str:
    """A digest of options, of both packages, and of the study's files that compute rows.

    Rows of other options or of other code have another digest.

    **Arguments**

    - `options`: values that JSON can hold.
    - `code`: files of the study; those that only print or draw need not be among them.

    **Returns** 64 hexadecimal digits.
    """
    digest = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    packages = [Path(package.__file__ or "").parent for package in (jaxcslc, sim)]
    files = [path for root in packages for path in root.rglob("*") if path.suffix in _SOURCES]
    for path in (*sorted(files), *code):
        digest.update(path.read_bytes())
    return digest.hexdigest()


_SOURCES = (".py", ".c", ".toml", ".json")


class Rows:
    """Rows in a JSON Lines file, one a line, by their key.

    A row is written as soon as it is added, so that a study that is interrupted loses only the row
    in progress. Rows with another `made_of` stay in the file and are ignored.

    **Attributes**

    - `path`: the file.
    - `keys`: names of the fields that identify a row.
    - `by_key`: the rows, by their key.
    - `digest`: what they are made of.
    """

    def __init__(self, path: Path, keys: Sequence[str], made_of: str) -> None:
        """Reads the rows that the file holds.

        **Raises**

        - `ValueError`: a line of the file is no row with these keys.
        """
        self.path, self.keys = path, tuple(keys)
        self.by_key: dict[tuple[Any, ...], dict[str, Any]] = {}
        self.digest = made_of
        text = path.read_bytes() if path.exists() else b""
        whole = text[: text.rfind(b"\n") + 1]
        if whole != text:  # the last line is half-written
            path.write_bytes(whole)
        for number, line in enumerate(whole.decode("utf-8").splitlines(), start=1):
            try:
                row = json.loads(line)
                if row.pop("made_of") == made_of:
                    self._take(row)
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                raise ValueError(
                    f"{path}, line {number}: {error!r}; expected a row of this study"
                ) from error

    def __contains__(self, key: tuple[Any, ...]) -> bool:
        return key in self.by_key

    def __getitem__(self, key: tuple[Any, ...]) -> dict[str, Any]:
        return self.by_key[key]

    def all(self) -> list[dict[str, Any]]:
        """The rows in the order of the file."""
        return list(self.by_key.values())

    def add(self, *rows: Mapping[str, Any]) -> None:
        """Appends rows to the file; a row replaces an earlier one of the same key."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a", encoding="utf-8") as file:
            for row in rows:
                file.write(json.dumps({"made_of": self.digest, **row}) + "\n")
                self._take(row)

    def _take(self, row: Mapping[str, Any]) -> None:
        self.by_key[tuple(row[name] for name in self.keys)] = dict(row)
