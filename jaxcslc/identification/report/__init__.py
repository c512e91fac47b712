from ..._text_table import text_table as text_table
from ._coefficient_table import (
    coefficient_rows as coefficient_rows,
    coefficient_text as coefficient_text,
)
from ._comparison import (
    ReportComparison as ReportComparison,
    compare_reports as compare_reports,
)
from ._derivation_report import (
    DerivationReport as DerivationReport,
    derivation_document as derivation_document,
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
    check_output_folder as check_output_folder,
    write_csv as write_csv,
    write_json as write_json,
)
from ._payload_report import PayloadReport as PayloadReport
from ._report import Report as Report
from ._report_files import (
    quality_document as quality_document,
    replaced_files as replaced_files,
    save_report as save_report,
)
from ._report_text import (
    determination_lines as determination_lines,
    held_out_lines as held_out_lines,
)
from ._saved import (
    SavedReport as SavedReport,
    load_report as load_report,
    load_settings as load_settings,
)
from ._saved_result import SavedResult as SavedResult
from ._verdicts import Verdict as Verdict, verdicts as verdicts
from ._warnings import condition_warning as condition_warning, fit_warnings as fit_warnings
from .page import (
    fit_quality as fit_quality,
    report_data as report_data,
    report_page as report_page,
    summary_text as summary_text,
)
