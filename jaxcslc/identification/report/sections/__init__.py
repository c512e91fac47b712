"""Kinds of results of a report, a file each; `SECTIONS` lists them in the order of the text."""

from .._section import AbstractSection
from ._coefficients import (
    CoefficientSection as CoefficientSection,
    ExcitationSection as ExcitationSection,
    SlopeSection,
    SystematicSection,
)
from ._errors import (
    ErrorSection as ErrorSection,
    HeldOutSection as HeldOutSection,
    QualitySection as QualitySection,
)
from ._estimators import EstimatorSection
from ._fit_quality import fit_quality as fit_quality
from ._friction_trials import FrictionTrialSection, PreSlidingSection
from ._given import GroupsSection, PriorSection
from ._horizon import HorizonSection
from ._model import ModelSection, MotionSection
from ._possible import PossibleSection
from ._recordings import (
    CurveSection as CurveSection,
    FrictionSection,
    RecordingSection as RecordingSection,
    WarningSection as WarningSection,
)
from ._repeat import RepeatSection as RepeatSection
from ._settings import SettingsSection as SettingsSection
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
