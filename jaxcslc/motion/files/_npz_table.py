import contextlib
import struct
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np

from .. import RecordingError
from ._errors import one_line
from ._layout import Header


# What unpacking a damaged file raises; `RuntimeError` is of encrypted ones and unknown versions.
_DAMAGE = (zipfile.BadZipFile, zlib.error, struct.error)


def read_npz(path: Path) -> tuple[Header, dict[str, Any]]:
    """Reads the arrays of a NumPy `.npz` file as columns.

    An array of one axis is a column of its name; one of two axes, samples by joints, is the columns
    `name[0]`, `name[1]` and on. `joint_names`, an array of texts, names the joints.

    **Returns** the header and the columns.

    **Raises** `RecordingError` for what is no such file, and arrays of different lengths.
    """
    try:
        with path.open("rb") as stream, contextlib.closing(_loaded(path, stream)) as file:
            arrays = {name: np.asarray(file[name]) for name in file.files}
    except RecordingError:
        raise
    except (ValueError, OSError, EOFError, RuntimeError, *_DAMAGE) as error:
        if isinstance(error, PermissionError):
            raise
        raise RecordingError(f"{path}: is no readable .npz file: {one_line(error)}") from error
    joint_names: tuple[str, ...] | None = None
    columns: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        if name == "joint_names":
            joint_names = tuple(str(text) for text in values.ravel())
        elif not (np.issubdtype(values.dtype, np.number) and not np.iscomplexobj(values)):
            continue
        elif values.ndim == 1:
            columns[name] = values
        elif values.ndim == 2 and values.shape[1] == 1:
            columns[name] = values[:, 0]
        elif values.ndim == 2:
            columns |= {f"{name}[{i}]": column for i, column in enumerate(values.T)}
    if not columns:
        listed = ", ".join(arrays) or "no array"
        raise RecordingError(f"{path}: has {listed}; expected arrays time, position and torque")
    return Header(list(columns), joint_names), columns


def _loaded(path: Path, stream: IO[bytes]) -> Any:
    file = np.load(stream, allow_pickle=False)
    if not isinstance(file, np.lib.npyio.NpzFile):
        raise RecordingError(
            f"{path}: holds one array; expected an .npz file of several: time, position, torque"
        )
    return file
