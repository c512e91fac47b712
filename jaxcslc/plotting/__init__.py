"""Pictures by matplotlib: one look for all, and measured with predicted torque.

- `_look`: colours, line styles, and empty figures.
- `_pictures`: torque against time, and PNG files.
"""

from ._look import (
    COLOURS as COLOURS,
    MEASURED as MEASURED,
    STYLES as STYLES,
    new_figure as new_figure,
)
from ._pictures import save_picture as save_picture


__all__ = [
    "COLOURS",
    "MEASURED",
    "STYLES",
    "new_figure",
    "save_picture",
]
