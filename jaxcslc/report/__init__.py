"""Reports: sections with text, JSON and blocks of a page; charts; saved files.

results ──► Report (sections) ──► text, identification.json, CSV, index.html

- `_report`, `_section`, `sections/`: a report and its kinds of results.
- `_files`: its files, written and read back; `_comparison`: two reports.
- `_page`, `_charts`: HTML pages.
- `_coefficients`, `_errors`, `_excitation`: verdicts and figures of a fit, as sections show them.
- `_derivation_report`: what a network has.
"""

from .._scratch import all_or_nothing as all_or_nothing
from ._charts import (
    COLOURS as COLOURS,
    AbstractChart as AbstractChart,
    ArmChart as ArmChart,
    Curve as Curve,
    Ellipsoid as Ellipsoid,
    Film as Film,
    MatrixChart as MatrixChart,
    Panel as Panel,
    PanelChart as PanelChart,
    envelope as envelope,
    rounded as rounded,
)
from ._coefficients import (
    WELL_DETERMINED as WELL_DETERMINED,
    Verdict as Verdict,
    coefficient_rows as coefficient_rows,
    coefficient_text as coefficient_text,
    compared_with_value as compared_with_value,
    verdicts as verdicts,
)
from ._comparison import ReportComparison as ReportComparison, compare_reports as compare_reports
from ._derivation_report import DerivationReport as DerivationReport
from ._errors import (
    ErrorTable as ErrorTable,
    compare as compare,
    condition_warning as condition_warning,
    fit_warnings as fit_warnings,
    predicted_torque as predicted_torque,
    torque_errors as torque_errors,
)
from ._excitation import Excitation as Excitation, degree_of_excitation as degree_of_excitation
from ._files import (
    load_settings as load_settings,
    replaced_files as replaced_files,
    write_csv as write_csv,
    write_json as write_json,
)
from ._page import (
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
    notebook_frame as notebook_frame,
    render as render,
)
from ._report import (
    AbstractReport as AbstractReport,
    Report as Report,
    load_report as load_report,
    read_report as read_report,
)
from ._section import AbstractSection as AbstractSection, AnyReport as AnyReport
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
    "load_report",
    "load_settings",
    "predicted_torque",
    "render",
    "torque_errors",
    "verdicts",
]
