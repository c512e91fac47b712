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
from ._excitation import Excitation as Excitation, degree_of_excitation as degree_of_excitation
from ._output import (
    all_or_nothing as all_or_nothing,
    write_csv as write_csv,
    write_json as write_json,
)
from ._report import (
    derivation_document as derivation_document,
    identification_report as identification_report,
)
from ._text import text_table as text_table
from ._verdicts import Verdict as Verdict, verdicts as verdicts
