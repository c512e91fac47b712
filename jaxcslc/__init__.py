from typing import TYPE_CHECKING


# The public face. A name loads its package on first use, and so does a package, as in `jc.motion`:
# `import jaxcslc` alone takes no time, and nobody waits for packages that they do not use.
if TYPE_CHECKING:
    from . import adaptive as adaptive, training as training
    from ._environment import enable_x64 as enable_x64
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
        DataCheck as DataCheck,
        DirectDynamics as DirectDynamics,
        ErrorTable as ErrorTable,
        Finding as Finding,
        Identification as Identification,
        InstrumentalVariables as InstrumentalVariables,
        LeastSquares as LeastSquares,
        LikelihoodFit as LikelihoodFit,
        MaximumLikelihood as MaximumLikelihood,
        PayloadFit as PayloadFit,
        PayloadReport as PayloadReport,
        PhysicalParameters as PhysicalParameters,
        Report as Report,
        Selection as Selection,
        Settings as Settings,
        SlopeFit as SlopeFit,
        check as check,
        choose_settings as choose_settings,
        compare as compare,
        fit_payload as fit_payload,
        fit_slopes as fit_slopes,
        identify as identify,
        identify_payload as identify_payload,
        load_report as load_report,
        load_settings as load_settings,
        physical_parameters as physical_parameters,
        regress_friction as regress_friction,
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
