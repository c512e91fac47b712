"""Kinds of results of a report, in the order of its text: a new kind is one line here."""

from .._section import AbstractSection
from ._bodies import PossibleSection
from ._coefficient_table import CoefficientSection, ExcitationSection, SystematicSection
from ._errors import (
    ErrorSection,
    EstimatorSection,
    HeldOutSection,
    HorizonSection,
    QualitySection,
)
from ._friction import FrictionSection, FrictionTrialSection, PreSlidingSection, SlopeSection
from ._method import (
    FilePriorSection,
    GroupsSection,
    ModelSection,
    MotionSection,
    PriorSection,
    RepeatSection,
    SettingsSection,
)
from ._recordings import CurveSection, RecordingSection, SeveralSection, WarningSection


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
