"""Public names of `jaxcslc`, for type checkers and for the loader of `__init__.py`."""

from . import (
    bodies as bodies,
    checks as checks,
    codegen as codegen,
    control as control,
    derivation as derivation,
    examples as examples,
    excitation as excitation,
    export as export,
    friction as friction,
    identification as identification,
    instruments as instruments,
    least_squares as least_squares,
    likelihood as likelihood,
    manipulator as manipulator,
    network as network,
    payload as payload,
    recordings as recordings,
    report as report,
    selection as selection,
    servo as servo,
    systems as systems,
    training as training,
    uncertainty as uncertainty,
)
from ._environment import enable_x64 as enable_x64
from .bodies import (
    PhysicalParameters as PhysicalParameters,
    physical_parameters as physical_parameters,
)
from .checks import DataCheck as DataCheck, Finding as Finding, check as check
from .derivation import Coefficient as Coefficient
from .export import (
    CCode as CCode,
    WrittenRobot as WrittenRobot,
    c_code as c_code,
    write_robot as write_robot,
)
from .friction import (
    SlopeFit as SlopeFit,
    fit_slopes as fit_slopes,
    regress_friction as regress_friction,
)
from .identification import identify as identify
from .instruments import (
    DirectDynamics as DirectDynamics,
    InstrumentalVariables as InstrumentalVariables,
)
from .least_squares import (
    RESULTS as RESULTS,
    Identification as Identification,
    LeastSquares as LeastSquares,
    Settings as Settings,
    reidentify as reidentify,
)
from .likelihood import LikelihoodFit as LikelihoodFit, MaximumLikelihood as MaximumLikelihood
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
from .network import CSLC as CSLC, derive as derive
from .payload import (
    PayloadFit as PayloadFit,
    PayloadReport as PayloadReport,
    fit_payload as fit_payload,
    identify_payload as identify_payload,
)
from .recordings import (
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
from .report import (
    ErrorTable as ErrorTable,
    Report as Report,
    compare as compare,
    load_report as load_report,
    load_settings as load_settings,
)
from .selection import (
    Candidates as Candidates,
    Selection as Selection,
    choose_settings as choose_settings,
)
from .systems import (
    System as System,
    SystemRecording as SystemRecording,
    SystemReport as SystemReport,
    identify_system as identify_system,
    load_system as load_system,
    load_system_recording as load_system_recording,
)

__version__: str
