from ._look import (
    COLOURS as COLOURS,
    MEASURED as MEASURED,
    STYLES as STYLES,
    new_figure as new_figure,
)
from ._pictures import save_picture as save_picture
