"""Sections of reports on systems: separation, searched constants, noise, simulation."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ..report import (
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
)
from ._constants import ConstantEstimate, ConstantSearch
from ._network import SystemNetwork
from ._noise_correction import NoiseCorrection
from ._simulation import Simulation


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
