"""Identification of robot dynamics with context-sensitive linear combiners (CSLC), in JAX.

A robot's inverse dynamics are derived exactly, as a network that is linear in its coefficients.
The coefficients are identified from recordings of motion and torque.

     robot file --> manipulator --> derivation --> network ----+
                                                               |
     log ---------> recordings (smoothing, masks) --> patterns +--> estimators --> report
                                                                                     |
          export, control, payload, excitation (the next motion) <-------------------+

A name below, or a package, is loaded when it is first used: `import jaxcslc` alone is quick.
Start with `load_robot`, `derive`, `load_recording` and `identify`.
"""

from typing import TYPE_CHECKING


# The public face. A name loads its package on first use, and so does a package, as in
# `jc.recordings`: `import jaxcslc` alone takes no time, and nobody waits for packages that they do
# not use.
if TYPE_CHECKING:
    from . import examples as examples, training as training
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

else:
    import ast
    import importlib
    import importlib.util

    def _packages() -> dict[str, str]:
        """The package of each public name, read from the imports above."""
        (block,) = (
            node
            for node in ast.parse(__loader__.get_source(__name__)).body
            if isinstance(node, ast.If)
        )
        imports = (node for node in block.body if isinstance(node, ast.ImportFrom) and node.module)
        return {alias.name: node.module for node in imports for alias in node.names}

    _PACKAGES = _packages()

    def __getattr__(name: str) -> object:
        if name == "__version__":
            value = importlib.import_module("importlib.metadata").version(__name__)
        elif name in _PACKAGES:
            value = getattr(importlib.import_module(f".{_PACKAGES[name]}", __name__), name)
        elif not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}"):
            value = importlib.import_module(f".{name}", __name__)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted([*_PACKAGES, "__version__"])
