"""Kinds of results of a report, a file each; `SECTIONS` lists them in the order of the text."""

from ._coefficients import (
    CoefficientSection as CoefficientSection,
    ExcitationSection as ExcitationSection,
    SlopeSection as SlopeSection,
    SystematicSection as SystematicSection,
)
from ._errors import (
    ErrorSection as ErrorSection,
    HeldOutSection as HeldOutSection,
    QualitySection as QualitySection,
)
from ._estimators import EstimatorSection as EstimatorSection
from ._fit_quality import fit_quality as fit_quality
from ._friction_trials import (
    FrictionTrialSection as FrictionTrialSection,
    PreSlidingSection as PreSlidingSection,
)
from ._given import GroupsSection as GroupsSection, PriorSection as PriorSection
from ._horizon import HorizonSection as HorizonSection
from ._model import ModelSection as ModelSection, MotionSection as MotionSection
from ._possible import PossibleSection as PossibleSection
from ._recordings import (
    CurveSection as CurveSection,
    FrictionSection as FrictionSection,
    RecordingSection as RecordingSection,
    WarningSection as WarningSection,
)
from ._registry import SECTIONS as SECTIONS
from ._repeat import RepeatSection as RepeatSection
from ._settings import SettingsSection as SettingsSection
from ._several import SeveralSection as SeveralSection
