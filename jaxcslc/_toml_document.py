"""Reader of TOML files, with one-line errors of the caller's class."""

import os
import tomllib
from pathlib import Path
from typing import Any


def toml_document(
    path: str | os.PathLike[str], what: str, error: type[ValueError]
) -> dict[str, Any]:
    """Return the content of a TOML file, or one table of it.

    **Arguments**

    - `path`: of the file, in UTF-8. If it ends in `#` and a name, the table of that name is read.
    - `what`: the file is, for the message if it is missing, as in `"robot file"`.
    - `error`: the class of what is raised.

    **Raises**

    - `error`: the file is missing, cannot be read, or is not valid TOML; one line that names it.
      Also if it has no such table.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "arm.toml"
    ...     _ = file.write_text("a = 0.5", encoding="utf-8")
    ...     toml_document(file, "robot file", ValueError)
    ...     _ = file.write_text("[columns]\\nunit = 'deg'", encoding="utf-8")
    ...     toml_document(f"{file}#columns", "file of columns", ValueError)
    {'a': 0.5}
    {'unit': 'deg'}
    """
    whole, _, name = str(path).rpartition("#")
    if whole.endswith(".toml"):
        table = toml_document(whole, what, error).get(name)
        if not isinstance(table, dict):
            raise error(f"{whole}: has no table {name!r}")
        return table
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise error(f"{path}: no such {what}") from None
    except (OSError, UnicodeDecodeError) as reason:
        raise error(f"{path}: cannot be read: {reason}") from None
    except (tomllib.TOMLDecodeError, RecursionError) as reason:
        raise error(f"{path}: not valid TOML: {reason}") from None
