"""Reports: sections with text, JSON and blocks of a page; charts; saved files.

results ──► Report (sections) ──► text, identification.json, CSV, index.html

- `_report`, `_section`, `sections/`: a report and its kinds of results.
- `_load`: reports read back.
- `_blocks`, `_render`, `_chart` and its kinds: HTML pages.
"""

from ._arm_chart import ArmChart as ArmChart, Ellipsoid as Ellipsoid
from ._blocks import (
    TONES as TONES,
    AbstractBlock as AbstractBlock,
    Code as Code,
    Column as Column,
    Details as Details,
    Grid as Grid,
    Link as Link,
    Message as Message,
    Messages as Messages,
    Page as Page,
    Paragraph as Paragraph,
    Picture as Picture,
    Section as Section,
    Table as Table,
    Tone as Tone,
    Value as Value,
)
from ._chart import AbstractChart as AbstractChart
from ._chart_curves import (
    Curve as Curve,
    envelope as envelope,
    intervals as intervals,
    plain as plain,
)
from ._coefficient_table import (
    coefficient_rows as coefficient_rows,
    coefficient_text as coefficient_text,
)
from ._comparison import ReportComparison as ReportComparison, compare_reports as compare_reports
from ._derivation_report import DerivationReport as DerivationReport
from ._errors import (
    ErrorTable as ErrorTable,
    compare as compare,
    predicted_torque as predicted_torque,
    torque_errors as torque_errors,
)
from ._excitation import Excitation as Excitation, degree_of_excitation as degree_of_excitation
from ._film import Film as Film
from ._load import (
    load_report as load_report,
    load_settings as load_settings,
    read_report as read_report,
)
from ._matrix_chart import MatrixChart as MatrixChart
from ._output import (
    all_or_nothing as all_or_nothing,
    check_output_folder as check_output_folder,
    replaced_files as replaced_files,
    write_csv as write_csv,
    write_json as write_json,
)
from ._panel_chart import Panel as Panel, PanelChart as PanelChart
from ._render import render as render
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


__all__ = [
    "TONES",
    "AbstractBlock",
    "AbstractChart",
    "ArmChart",
    "Code",
    "Column",
    "Curve",
    "DerivationReport",
    "Details",
    "Ellipsoid",
    "ErrorTable",
    "Excitation",
    "Film",
    "Grid",
    "Link",
    "MatrixChart",
    "Message",
    "Messages",
    "Page",
    "Panel",
    "PanelChart",
    "Paragraph",
    "Picture",
    "Report",
    "ReportComparison",
    "Section",
    "Table",
    "Tone",
    "Value",
    "Verdict",
    "coefficient_rows",
    "coefficient_text",
    "compare",
    "compare_reports",
    "degree_of_excitation",
    "envelope",
    "intervals",
    "load_report",
    "load_settings",
    "plain",
    "predicted_torque",
    "render",
    "torque_errors",
    "verdicts",
]
