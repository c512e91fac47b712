"""Sections of reports on systems: separation, searched constants, noise, simulation."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from ..identification.report import (
    AbstractReport,
    AbstractSection,
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
from ._constants import ConstantEstimate
from ._network import SystemNetwork
from ._noise_correction import NoiseCorrection
from ._search_result import ConstantSearch
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

    @classmethod
    def of(cls, report: AbstractReport[Any]) -> AbstractSection:
        network = report.network
        values = np.asarray(network.nonlinear).tolist()
        searched = zip(network.system.nonlinear, values, strict=True)
        return cls(
            lambda: {
                **separation_document(network),
                "searched": {constant.name: value for constant, value in searched},
            }
        )

    def text(self, report: AbstractReport[Any]) -> Iterator[Sequence[str]]:
        yield [*report.model.lines, f"settings: {report.settings}"]


class SearchSection(AbstractSection):
    """Constants that enter nonlinearly, and all minima of the error over them."""

    name = "search"
    results = MappingProxyType({"search": None})
    entries = MappingProxyType({"minima": list, "search_text": list})

    @classmethod
    def of(cls, report: AbstractReport[Any]) -> AbstractSection:
        search: ConstantSearch | None = report.results.get(cls.name)
        if search is None:
            return cls(lambda: {"minima": []})
        return cls(
            lambda: {
                "minima": [
                    {
                        "constants": dict(zip(search.names, minimum.values, strict=True)),
                        "equation_error_rms": minimum.error,
                        "starts": minimum.starts,
                    }
                    for minimum in search.minima
                ],
                "search_text": ["searched constants", str(search)],
            }
        )

    def text(self, report: AbstractReport[Any]) -> Iterator[Sequence[str]]:
        yield self.data.get("search_text", ())


class ConstantSection(AbstractSection):
    """Constants that follow from coefficients, and what keeps others from doing so."""

    name = "constants"
    results = MappingProxyType({"constants": ()})
    entries = MappingProxyType({"constants": dict, "constants_text": list})

    @classmethod
    def of(cls, report: AbstractReport[Any]) -> AbstractSection:
        constants: tuple[ConstantEstimate, ...] = report.results.get(cls.name, ())
        separation = report.network.system.separation
        others = [str(row) for row in constants if row.name not in report.names]
        return cls(
            lambda: {
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
        )

    def result(self, name: str, report: AbstractReport[Any]) -> tuple[ConstantEstimate, ...]:
        return tuple(
            ConstantEstimate(
                constant,
                entry.get("unit", ""),
                float("nan") if entry["value"] is None else entry["value"],
                float("inf") if entry["standard_error"] is None else entry["standard_error"],
            )
            for constant, entry in self.data["constants"].items()
        )

    def text(self, report: AbstractReport[Any]) -> Iterator[Sequence[str]]:
        yield self.data.get("constants_text", ())


class CorrectionSection(AbstractSection):
    """The bias of measurement noise and of smoothing, taken off the coefficients."""

    name = "correction"
    results = MappingProxyType({"correction": None})
    entries = MappingProxyType({"noise": object, "noise_text": list})

    @classmethod
    def of(cls, report: AbstractReport[Any]) -> AbstractSection:
        correction: NoiseCorrection | None = report.results.get(cls.name)
        if correction is None:
            return cls(lambda: {"noise": None})
        return cls(
            lambda: {
                "noise": {
                    "deviation": dict(correction.noise),
                    "bias": correction.bias,
                    "smoothing_bias": correction.smoothing_bias,
                    "smoothing_remainder": correction.smoothing_remainder,
                    "equation_error_ratio": correction.ratio,
                    "explained": correction.explained,
                    "draws": correction.draws,
                },
                "noise_text": str(correction).splitlines(),
            }
        )

    def text(self, report: AbstractReport[Any]) -> Iterator[Sequence[str]]:
        yield self.data.get("noise_text", ())


class SimulationSection(AbstractSection):
    """The identified system simulated along the validation recording."""

    name = "simulation"
    results = MappingProxyType({"simulation": None})
    entries = MappingProxyType({"simulation": object, "simulation_text": list})

    @classmethod
    def of(cls, report: AbstractReport[Any]) -> AbstractSection:
        simulation: Simulation | str | None = report.results.get(cls.name)
        if simulation is None:
            return cls(lambda: {"simulation": None})
        if isinstance(simulation, str):
            return cls(
                lambda: {
                    "simulation": {"not_simulated": simulation},
                    "simulation_text": [f"not simulated: {simulation}"],
                }
            )
        return cls(
            lambda: {
                "simulation": {
                    "seconds": float(simulation.time[-1] - simulation.time[0]),
                    "rms": dict(zip(simulation.names, simulation.error, strict=True)),
                    "horizon": simulation.horizon(),
                },
                "simulation_text": ["simulation, validation recording", str(simulation)],
            }
        )

    def text(self, report: AbstractReport[Any]) -> Iterator[Sequence[str]]:
        yield self.data.get("simulation_text", ())


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
