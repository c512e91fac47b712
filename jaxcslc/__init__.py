import importlib as _importlib
from importlib.metadata import version as _version
from types import ModuleType as _ModuleType
from typing import TYPE_CHECKING as _TYPE_CHECKING

from .assessment import regress_friction as regress_friction
from .derivation import Coefficient as Coefficient
from .export import (
    CCode as CCode,
    WrittenRobot as WrittenRobot,
    c_code as c_code,
    write_robot as write_robot,
)
from .identification import (
    RESULTS as RESULTS,
    Candidates as Candidates,
    ErrorTable as ErrorTable,
    Fixed as Fixed,
    Identification as Identification,
    LeastSquares as LeastSquares,
    PayloadFit as PayloadFit,
    PayloadReport as PayloadReport,
    PhysicalParameters as PhysicalParameters,
    Refinement as Refinement,
    Report as Report,
    SavedReport as SavedReport,
    Selection as Selection,
    Settings as Settings,
    SlopeFit as SlopeFit,
    choose_settings as choose_settings,
    compare as compare,
    fit_payload as fit_payload,
    fit_slopes as fit_slopes,
    identify as identify,
    identify_payload as identify_payload,
    load_report as load_report,
    load_settings as load_settings,
    physical_parameters as physical_parameters,
    refine_thresholds as refine_thresholds,
    reidentify as reidentify,
)
from .manipulator import (
    LinkInertia as LinkInertia,
    LinkParameters as LinkParameters,
    Manipulator as Manipulator,
    RobotError as RobotError,
    load_robot as load_robot,
    panda as panda,
    puma560 as puma560,
    tx40 as tx40,
)
from .motion import (
    AveragedSplines as AveragedSplines,
    Butterworth as Butterworth,
    Patterns as Patterns,
    Preparation as Preparation,
    Recording as Recording,
    RecordingError as RecordingError,
    SavitzkyGolay as SavitzkyGolay,
    load_recording as load_recording,
    prepare as prepare,
    save_recording as save_recording,
)
from .network import CSLC as CSLC, derive as derive


__version__ = _version("jaxcslc")

# Networks that learn take a quarter as long to import as all else: they load on first use.
if _TYPE_CHECKING:
    from . import adaptive as adaptive, training as training
else:

    def __getattr__(name: str) -> _ModuleType:
        if name in ("adaptive", "training"):
            return _importlib.import_module(f".{name}", __name__)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
