"""Static pictures by matplotlib, as studies draw them: one look for all. `_look` has it."""

from ._look import (
    COLOURS as COLOURS,
    MEASURED as MEASURED,
    STYLES as STYLES,
    new_figure as new_figure,
    save_picture as save_picture,
)


__all__ = [
    "COLOURS",
    "MEASURED",
    "STYLES",
    "new_figure",
    "save_picture",
]
