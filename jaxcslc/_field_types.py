"""Check of a file's entries against the field annotations of the class that they make.

Used for settings and other documents that are read from JSON or TOML.
"""

import types
from collections.abc import Mapping
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints


# How a person says what a field expects.
_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}


def check_field_types(kind: type, values: Mapping[str, Any], prefix: str) -> None:
    """Check entries of a file against the annotations of the class that they will make.

    Only what a file can hold is checked: numbers, texts, lists and what is absent. Names that the
    class does not have, and what its constructor checks itself, are left to it.

    **Arguments**

    - `kind`: a dataclass or `equinox.Module`.
    - `values`: its fields by name, lists as tuples.
    - `prefix`: of the message, such as `"settings"`.

    **Raises**

    - `ValueError`: naming the entry, what was expected and what it is.

    >>> from jaxcslc.recordings import Preparation
    >>> check_field_types(Preparation, {"trim": "x"}, "settings")
    Traceback (most recent call last):
    ValueError: settings, trim: expected a whole number or nothing, got 'x'
    """
    hints = get_type_hints(kind)
    for name, value in values.items():
        if name in hints and not _fits(value, hints[name]):
            raise ValueError(
                f"{prefix}, {name}: expected {_described(hints[name])}, got {_shown(value)}"
            )


def _alternatives(hint: Any) -> tuple[Any, ...]:
    if get_origin(hint) in (Union, types.UnionType):
        return tuple(one for part in get_args(hint) for one in _alternatives(part))
    return (hint,)


def _fits(value: Any, hint: Any) -> bool:
    return any(_fits_one(value, one) for one in _alternatives(hint))


def _fits_one(value: Any, hint: Any) -> bool:
    if get_origin(hint) is Literal:
        # A wrong text is the constructor's to refuse: it says which there are.
        return isinstance(value, str)
    if get_origin(hint) is tuple:
        entry = get_args(hint)[0]
        return isinstance(value, tuple) and all(_fits(part, entry) for part in value)
    if hint is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool)
    if hint in (str, bool, type(None)):
        return isinstance(value, hint)
    return True


def _described(hint: Any) -> str:
    words: list[str] = []
    for one in _alternatives(hint):
        if get_origin(one) is tuple:
            words.append("a list of numbers")
        elif get_origin(one) is Literal:
            words.append(" or ".join(map(repr, get_args(one))))
        else:
            words.append("nothing" if one is type(None) else _NAMES.get(one, "an entry"))
    return " or ".join(dict.fromkeys(words))


def _shown(value: Any) -> str:
    return repr(list(value) if isinstance(value, tuple) else value)
