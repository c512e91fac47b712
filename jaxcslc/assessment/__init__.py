from ._baselines import regress_friction as regress_friction
from ._coefficient_table import (
    coefficient_rows as coefficient_rows,
    coefficient_text as coefficient_text,
)
from ._errors import (
    ErrorTable as ErrorTable,
    compare as compare,
    predicted_torque as predicted_torque,
    torque_errors as torque_errors,
)
from ._output import (
    all_or_nothing as all_or_nothing,
    write_csv as write_csv,
    write_json as write_json,
)
from ._pictures import save_picture as save_picture, torque_picture as torque_picture
from ._report import (
    derivation_document as derivation_document,
    identification_report as identification_report,
)
from ._text import text_table as text_table
