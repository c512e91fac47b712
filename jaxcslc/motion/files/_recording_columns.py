import re
from collections.abc import Sequence

from .. import RecordingError, column_names
from ._layout import QUANTITIES, REQUIRED, Column, Layout


EXPECTED = (
    "expected time, position_1..n, torque_1..n and, optionally, velocity_1..n, acceleration_1..n"
)


def checked_columns(file: str, names: Sequence[str]) -> Layout:
    """The layout of a file as this package writes it: SI units, joints numbered from 1.

    **Arguments**

    - `file`: as it is named in messages.
    - `names`: the columns, in any order.

    **Returns**

    What they are.

    **Raises**

    - `RecordingError`: duplicate, unknown or missing columns; nothing is guessed.
    """

    def wrong(problem: str) -> RecordingError:
        return RecordingError(f"{file}: {problem}; {EXPECTED}")

    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise wrong(f"column {_listed(duplicates)} occurs more than once")
    numbers: dict[str, set[int]] = {quantity: set() for quantity in QUANTITIES}
    unknown: list[str] = []
    for name in names:
        parts = re.fullmatch(r"(position|torque|velocity|acceleration)_([1-9][0-9]*)", name)
        if parts is not None:
            numbers[parts[1]].add(int(parts[2]))
        elif name != "time":
            unknown.append(name)
    if unknown:
        raise wrong(f"unknown column {_listed(unknown)}")
    if "time" not in names:
        raise wrong("missing column time")
    for quantity in REQUIRED:
        if not numbers[quantity]:
            raise wrong(f"missing column {quantity}_1 (no {quantity} columns at all)")
    for quantity, present in numbers.items():
        gaps = [f"{quantity}_{number}" for number in range(1, max(present, default=0))]
        gaps = [name for name in gaps if name not in names]
        if gaps:
            raise wrong(f"missing column {_listed(gaps)} before {quantity}_{max(present)}")
    joints = len(numbers["position"])
    for quantity, present in numbers.items():
        if present and len(present) != joints:
            raise wrong(
                f"{joints} position columns but {len(present)} {quantity} columns "
                "(as many of each are needed)"
            )
    return Layout(
        Column("time"),
        {
            quantity: tuple(Column(name) for name in column_names(quantity, joints))
            for quantity, present in numbers.items()
            if present
        },
        relative=False,
        torque_measured=False,
    )


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name) if not name.isidentifier() else name for name in names[:4])
    return shown if len(names) <= 4 else f"{shown} and {len(names) - 4} more"
