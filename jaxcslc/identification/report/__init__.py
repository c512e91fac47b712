"""Reports of identifications: lists of sections, written and read back."""

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
from ._load import (
    load_report as load_report,
    load_settings as load_settings,
    read_report as read_report,
)
from ._output import (
    all_or_nothing as all_or_nothing,
    check_output_folder as check_output_folder,
    replaced_files as replaced_files,
    write_csv as write_csv,
    write_json as write_json,
)
from ._payload_report import PayloadReport as PayloadReport
from ._report import AbstractReport as AbstractReport, Report as Report
from ._section import AbstractSection as AbstractSection, AnyReport as AnyReport
from ._verdicts import Verdict as Verdict, verdicts as verdicts
from ._warnings import condition_warning as condition_warning, fit_warnings as fit_warnings
from .sections import (
    SECTIONS as SECTIONS,
    CoefficientSection as CoefficientSection,
    CurveSection as CurveSection,
    ErrorSection as ErrorSection,
    ExcitationSection as ExcitationSection,
    HeldOutSection as HeldOutSection,
    QualitySection as QualitySection,
    RecordingSection as RecordingSection,
    RepeatSection as RepeatSection,
    SettingsSection as SettingsSection,
    WarningSection as WarningSection,
    fit_quality as fit_quality,
)
