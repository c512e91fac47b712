import contextlib
from collections.abc import Mapping
from pathlib import Path

from .._toml_document import toml_document


_HEADER = """\
# Motor inertias of {name}, for which URDF has no element: what the motor adds to the inertia of its
# joint, seen at the joint [kg m², of a prismatic joint kg]. MJCF calls it armature, Pinocchio
# model.armature. The bodies of {name} are those beside them.
robot = "{name}"

[motor_inertia]
"""


def motor_file(robot: str | Path) -> Path:
    """The file of a URDF's motor inertias: beside it, `.motors.toml` in place of its suffix.

    >>> from jaxcslc.export import motor_file
    >>> motor_file("build/arm_identified.urdf").name
    'arm_identified.motors.toml'
    """
    path = Path(robot)
    return path.with_name(f"{path.stem}.motors.toml")


def write_motor_inertias(robot: str | Path, inertias: Mapping[str, float]) -> Path:
    """Writes the motor inertias of a URDF's joints beside it, as TOML.

    **Arguments**

    - `robot`: the URDF.
    - `inertias`: by joint [kg m², of prismatic joints kg].

    **Returns** the file: `motor_file(robot)`.

    **Raises**

    - `OSError`: it cannot be written.

    >>> import tempfile
    >>> from jaxcslc.export import read_motor_inertias, write_motor_inertias
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_motor_inertias(Path(folder) / "arm.urdf", {"elbow": 0.25})
    ...     read_motor_inertias(path)
    {'elbow': 0.25}
    """
    path, name = motor_file(robot), _quoted(Path(robot).name)
    lines = [f'"{_quoted(joint)}" = {float(value)!r}' for joint, value in inertias.items()]
    text = _HEADER.format(name=name) + "\n".join(lines) + "\n"
    scratch = path.with_name(f".{path.name}.part")
    try:
        scratch.write_text(text, encoding="utf-8")
        scratch.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink(missing_ok=True)
    return path


def read_motor_inertias(path: str | Path) -> dict[str, float]:
    """What `write_motor_inertias` wrote, by joint [kg m², of prismatic joints kg].

    **Arguments**

    - `path`: of the file.

    **Returns** the inertias.

    **Raises**

    - `ValueError`: the file is no such file; the message names file and entry.
    - `OSError`: it cannot be read.

    >>> import tempfile
    >>> from jaxcslc.export import read_motor_inertias
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "arm.motors.toml"
    ...     _ = path.write_text("[motor_inertia]\\nelbow = 0.25\\n")
    ...     read_motor_inertias(path)
    {'elbow': 0.25}
    """
    document = toml_document(path, "file of motor inertias", ValueError)
    table = document.get("motor_inertia")
    if not isinstance(table, dict):
        raise ValueError(f"{path}: expected a table [motor_inertia] of numbers by joint")
    for joint, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not value >= 0:
            raise ValueError(f"{path}, motor_inertia, {joint}: expected 0 or more, got {value!r}")
    return {joint: float(value) for joint, value in table.items()}


def _quoted(text: str) -> str:
    """A text as TOML has it between quotes."""
    escapes = {'"': '\\"', "\\": "\\\\"}
    return "".join(
        escapes.get(letter, letter if letter.isprintable() else f"\\u{ord(letter):04x}")
        for letter in text
    )
