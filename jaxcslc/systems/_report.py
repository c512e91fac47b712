"""Reports on systems: of an identification, and of what separation makes of equations."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..report import (
    AbstractReport,
    AbstractSection,
    AnyReport,
    CoefficientSection,
    CurveSection,
    ErrorSection,
    ExcitationSection,
    HeldOutSection,
    QualitySection,
    RecordingSection,
    RepeatSection,
    SettingsSection,
    WarningSection,
    all_or_nothing,
    coefficient_rows,
    read_report,
    write_csv,
    write_json,
)
from ._constants import ConstantEstimate
from ._network import SystemNetwork
from ._noise_correction import NoiseCorrection
from ._search import ConstantSearch
from ._simulation import Simulation
from ._system import System


class SystemSection(AbstractSection):
    """The system's equations, separated into known sides and regressors."""

    name = "system"
    entries = MappingProxyType(
        {
            **{"system": str, "separated": dict, "order": int, "order_per_equation": list},
            "searched": dict,
        }
    )
    always = True

    @classmethod
    def document_of(cls, result: None, report: AnyReport) -> Mapping[str, Any]:
        network = report.network
        values = np.asarray(network.nonlinear).tolist()
        searched = zip(network.system.nonlinear, values, strict=True)
        return {
            **separation_document(network),
            "searched": {constant.name: value for constant, value in searched},
        }

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        yield [*report.model.lines, f"settings: {report.settings}"]


class SearchSection(AbstractSection):
    """Constants that enter nonlinearly, and all minima of the error over them."""

    name = "search"
    results = MappingProxyType({"search": None})
    entries = MappingProxyType({"minima": list, "search_text": list})
    always = True

    @classmethod
    def document_of(cls, result: ConstantSearch | None, report: AnyReport) -> Mapping[str, Any]:
        if result is None:
            return {"minima": []}
        return {
            "minima": [
                {
                    "constants": dict(zip(result.names, minimum.values, strict=True)),
                    "equation_error_rms": minimum.error,
                    "starts": minimum.starts,
                }
                for minimum in result.minima
            ],
            "search_text": ["searched constants", str(result)],
        }


class ConstantSection(AbstractSection):
    """Constants that follow from coefficients, and what keeps others from doing so."""

    name = "constants"
    results = MappingProxyType({"constants": ()})
    entries = MappingProxyType({"constants": dict, "constants_text": list})
    always = True

    @classmethod
    def document_of(
        cls, result: tuple[ConstantEstimate, ...] | None, report: AnyReport
    ) -> Mapping[str, Any]:
        constants, separation = result or (), report.network.system.separation
        others = [str(row) for row in constants if row.name not in report.names]
        return {
            "constants": {
                row.name: {
                    "value": row.value,
                    "standard_error": row.standard_error,
                    "unit": row.unit,
                }
                for row in constants
            },
            "constants_text": [
                *([f"constants: {', '.join(others)}"] if others else []),
                *(str(row) for row in separation.identifiability if row.verdict != "alone"),
                *separation.notes,
            ],
        }

    def result(self, name: str, report: AnyReport) -> tuple[ConstantEstimate, ...]:
        return tuple(
            ConstantEstimate(
                constant,
                entry.get("unit", ""),
                float("nan") if entry["value"] is None else entry["value"],
                float("inf") if entry["standard_error"] is None else entry["standard_error"],
            )
            for constant, entry in self.data.get("constants", {}).items()
        )


class CorrectionSection(AbstractSection):
    """The bias of measurement noise and of smoothing, taken off the coefficients."""

    name = "correction"
    results = MappingProxyType({"correction": None})
    entries = MappingProxyType({"noise": object, "correction_text": list})
    always = True

    @classmethod
    def document_of(cls, result: NoiseCorrection | None, report: AnyReport) -> Mapping[str, Any]:
        if result is None:
            return {"noise": None}
        return {
            "noise": {
                "deviation": dict(result.noise),
                "bias": result.bias,
                "smoothing_bias": result.smoothing_bias,
                "smoothing_remainder": result.smoothing_remainder,
                "equation_error_ratio": result.ratio,
                "explained": result.explained,
                "draws": result.draws,
            },
            "correction_text": str(result).splitlines(),
        }


class SimulationSection(AbstractSection):
    """The identified system simulated along the validation recording."""

    name = "simulation"
    results = MappingProxyType({"simulation": None})
    entries = MappingProxyType({"simulation": object, "simulation_text": list})
    always = True

    @classmethod
    def document_of(cls, result: Simulation | str | None, report: AnyReport) -> Mapping[str, Any]:
        if result is None:
            return {"simulation": None}
        if isinstance(result, str):
            return {
                "simulation": {"not_simulated": result},
                "simulation_text": [f"not simulated: {result}"],
            }
        return {
            "simulation": {
                "seconds": float(result.time[-1] - result.time[0]),
                "rms": dict(zip(result.names, result.error, strict=True)),
                "horizon": result.horizon(),
            },
            "simulation_text": ["simulation, validation recording", str(result)],
        }


SYSTEM_SECTIONS: tuple[type[AbstractSection], ...] = (
    SystemSection,
    SettingsSection,
    CoefficientSection,
    SearchSection,
    ConstantSection,
    ExcitationSection,
    CorrectionSection,
    ErrorSection,
    QualitySection,
    HeldOutSection,
    CurveSection,
    RecordingSection,
    SimulationSection,
    WarningSection,
    RepeatSection,
)


def separation_document(network: SystemNetwork) -> dict[str, Any]:
    """Return equations as separation leaves them, as plain data."""
    separation = network.system.separation
    return {
        "system": network.name,
        "separated": {
            name: {
                "known": str(known),
                "regressor": {
                    coefficient: str(expression)
                    for coefficient, expression in zip(separation.names, row, strict=True)
                    if expression != 0
                },
            }
            for name, known, row in zip(
                separation.outputs, separation.known, separation.regressor, strict=True
            )
        },
        "order": network.order,
        "order_per_equation": network.order_per_joint,
    }


class SystemReport(AbstractReport[SystemNetwork]):
    """The result of `identify_system`: coefficients, their uncertainty, and equation errors.

    `print` shows what `jaxcslc identify` prints of a system; `save` writes what it writes.

    **Attributes**

    - `network`: of the system; with the values that were found for searched constants, if it has
      any.
    - `settings`: of preparation and fit.
    - `fit`: the `Identification`, with standard errors and covariance.
    - `patterns`: by recording, `"training"` and, if there was one, `"validation"`; empty of a
      report that was loaded.
    - `results`: by name, what sections are made of: `errors` to `simulation` below.
    - `document`: what the files hold of a report that was loaded; None of others.
    - `errors`: of the equations, by recording: root mean squares of known side less output.
    - `excitation`: of the training recording.
    - `held_out`: errors of the validation recording next to those of the training recording;
      without a validation recording by cross-validation.
    - `warnings`: one sentence each.
    - `search`: of the constants that enter nonlinearly; None without any.
    - `correction`: of the bias of noise and smoothing, already in `fit`; None without noise.
    - `constants`: that follow from the coefficients, see `constants_from`.
    - `simulation`: of the identified system from the first sample of the validation recording, or
      why it cannot be simulated; None without a validation recording.

    >>> import jaxcslc as jc
    >>> report = jc.identify_system(*jc.examples.tank())
    >>> [(row["name"], round(row["value"], 3), row["unit"]) for row in report.rows()]
    [('area', 3.0, 'm²'), ('outlet', 0.5, '')]
    """

    kinds: ClassVar[tuple[type[AbstractSection], ...]] = SYSTEM_SECTIONS

    def network_along(self, recording: str) -> SystemNetwork:
        """Return the network that predicts known sides along a recording: that of all motion."""
        del recording
        return self.network

    def derived_network(self) -> SystemNetwork:
        """**Raises** `AttributeError`: files do not hold the equations as they were written."""
        raise AttributeError("network: the files of a report on a system do not hold it")


def load_system_report(path: str | Path) -> SystemReport:
    """Return the report on a system that `SystemReport.save` wrote.

    Its sections, coefficients and their covariance are those of the report that was saved. Files
    hold neither its network nor its patterns.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.

    **Raises** `ValueError`: there is no such file, or it holds something else.

    >>> import tempfile, jaxcslc as jc
    >>> from jaxcslc.systems import load_system_report
    >>> report = jc.identify_system(*jc.examples.tank())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     str(load_system_report(folder)) == str(report)
    True
    """
    return read_report(path, SystemReport)


def save_derivation(system: System, folder: str | Path) -> tuple[Path, ...]:
    """Writes what separation made of a system: `coefficients.csv`, `constants.csv`, `system.json`.

    **Arguments**

    - `system`: that is separated.
    - `folder`: is made if it is missing.

    **Returns** the files.

    **Raises**

    - `DescriptionError`: as `System.separation`.
    - `ValueError`: `folder` is a file.
    - `OSError`: the folder cannot be written.
    """
    folder, network = Path(folder), system.network
    names = ("coefficients.csv", "constants.csv", "system.json")
    with all_or_nothing(folder) as scratch:
        write_csv(scratch / names[0], coefficient_rows(network))
        constants = [
            {
                "constant": row.constant,
                "verdict": row.verdict,
                "coefficients": " ".join(row.coefficients),
            }
            for row in system.separation.identifiability
        ]
        write_csv(scratch / names[1], constants)
        write_json(scratch / names[2], separation_document(network))
    return tuple(folder / name for name in names)
