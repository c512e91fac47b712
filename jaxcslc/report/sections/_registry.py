"""Kinds of results of a report, in the order of its text: a new kind is one line here."""

from .._section import AbstractSection
from ._coefficients import CoefficientSection, ExcitationSection, SlopeSection, SystematicSection
from ._errors import ErrorSection, HeldOutSection, QualitySection
from ._estimators import EstimatorSection
from ._friction_trials import FrictionTrialSection, PreSlidingSection
from ._given import GroupsSection, PriorSection
from ._horizon import HorizonSection
from ._model import ModelSection, MotionSection
from ._possible import PossibleSection
from ._recordings import CurveSection, FrictionSection, RecordingSection, WarningSection
from ._repeat import RepeatSection
from ._settings import SettingsSection
from ._several import SeveralSection


SECTIONS: tuple[type[AbstractSection], ...] = (
    ModelSection,
    SettingsSection,
    GroupsSection,
    PriorSection,
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
