"""Kinds of results of a report, one file each; `_registry` lists them in the order of the text."""

from ._coefficient_table import (
    CoefficientSection as CoefficientSection,
    ExcitationSection as ExcitationSection,
)
from ._errors import (
    ErrorSection as ErrorSection,
    HeldOutSection as HeldOutSection,
    QualitySection as QualitySection,
    fit_quality as fit_quality,
)
from ._method import RepeatSection as RepeatSection, SettingsSection as SettingsSection
from ._recordings import (
    CurveSection as CurveSection,
    RecordingSection as RecordingSection,
    WarningSection as WarningSection,
    curve_chart as curve_chart,
)
from ._registry import SECTIONS as SECTIONS
