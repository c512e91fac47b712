"""Kinds of results of a report, in the order of its text: a new kind is a line of `SECTIONS`."""

from .._section import AbstractSection
from ._bodies import PossibleSection
from ._coefficient_table import (
    CoefficientSection as CoefficientSection,
    ExcitationSection as ExcitationSection,
    SystematicSection,
)
from ._errors import (
    ErrorSection as ErrorSection,
    EstimatorSection,
    HeldOutSection as HeldOutSection,
    HorizonSection,
    QualitySection as QualitySection,
    fit_quality as fit_quality,
)
from ._friction import FrictionSection, FrictionTrialSection, PreSlidingSection, SlopeSection
from ._method import (
    FilePriorSection,
    GroupsSection,
    ModelSection,
    MotionSection,
    PriorSection,
    RepeatSection as RepeatSection,
    SettingsSection as SettingsSection,
)
from ._recordings import (
    CurveSection as CurveSection,
    RecordingSection as RecordingSection,
    SeveralSection,
    WarningSection as WarningSection,
    curve_chart as curve_chart,
)


SECTIONS: tuple[type[AbstractSection], ...] = (
    ModelSection,
    SettingsSection,
    GroupsSection,
    PriorSection,
    FilePriorSection,
    SeveralSection,
    CoefficientSection,
    SlopeSection,
    SystematicSection,
    ExcitationSection,
    ErrorSection,
    QualitySection,
    HeldOutSection,
    CurveSection,
    RecordingSection,
    EstimatorSection,
    HorizonSection,
    FrictionSection,
    PossibleSection,
    PreSlidingSection,
    FrictionTrialSection,
    WarningSection,
    MotionSection,
    RepeatSection,
)
