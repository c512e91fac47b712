import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .._environment import require
from ..identification import (
    ErrorTable,
    Excitation,
    HeldOut,
    Identification,
    Settings,
    coefficient_rows,
    coefficient_text,
    settings_document,
)
from ..identification.report import (
    all_or_nothing,
    determination_lines,
    held_out_lines,
    quality_document,
    report_data,
    save_report,
    summary_text,
    write_csv,
    write_json,
)
from ..motion import Patterns
from ._constants import ConstantEstimate
from ._network import SystemNetwork
from ._noise_correction import NoiseCorrection
from ._search_result import ConstantSearch
from ._simulation import Simulation
from ._system import System


@dataclasses.dataclass(frozen=True, eq=False)
class SystemReport:
    """The result of `identify_system`: coefficients, their uncertainty, and equation errors.

    `print` shows what `jaxcslc identify` prints of a system; `save` writes what it writes.

    **Attributes**

    - `network`: of the system; with the values that were found for searched constants, if it has
      any.
    - `settings`: of preparation and fit.
    - `fit`: the `Identification`, with standard errors and covariance.
    - `patterns`: by recording, `"training"` and, if there was one, `"validation"`.
    - `errors`: of the equations, by recording: root mean squares of known side less output.
    - `excitation`: of the training recording.
    - `held_out`: errors of the validation recording beside those of the training recording; without
      a validation recording by cross-validation.
    - `warnings`: one sentence each.
    - `search`: of the constants that enter nonlinearly; None without any.
    - `correction`: of the bias of noise and smoothing, already in `fit`; None without noise.
    - `constants`: that follow from the coefficients, see `constants_from`.
    - `simulation`: of the identified system from the first sample of the validation recording, or
      why it cannot be simulated; None without a validation recording.

    >>> import numpy as np, sympy
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable, identify_system
    >>> current, voltage, resistance = sympy.symbols("current voltage resistance")
    >>> wire = System(
    ...     "wire", {"Ohm": sympy.Eq(voltage, resistance * current)},
    ...     (Variable(current, "A"), Variable(voltage, "V")), (Constant(resistance, "Ω"),),
    ... )
    >>> time = np.arange(400) * 0.1
    >>> columns = {"current": np.sin(time), "voltage": 2.5 * np.sin(time)}
    >>> report = identify_system(wire, SystemRecording(time, columns))
    >>> [(row["name"], round(row["value"], 6), row["unit"]) for row in report.rows()]
    [('resistance', 2.5, 'Ω')]
    """

    network: SystemNetwork
    settings: Settings
    fit: Identification
    patterns: Mapping[str, Patterns]
    errors: Mapping[str, ErrorTable]
    excitation: Excitation
    held_out: HeldOut
    warnings: tuple[str, ...] = ()
    search: ConstantSearch | None = None
    simulation: Simulation | str | None = None
    constants: tuple[ConstantEstimate, ...] = ()
    correction: NoiseCorrection | None = None

    @property
    def k(self) -> Float[Array, " coefficients"]:
        """(p,) identified coefficients, in the order of `network.coefficients`."""
        return self.fit.k

    def rows(self, level: float = 0.95) -> list[dict[str, str | float | bool]]:
        """One row a coefficient: value, interval, verdict and expression, as of `Report.rows`."""
        return coefficient_rows(self.network, self.fit, excitation=self.excitation, level=level)

    def network_along(self, recording: str) -> SystemNetwork:
        """The network that predicts known sides along a recording's motion: that of all motion."""
        del recording
        return self.network

    def to_pandas(self, level: float = 0.95) -> Any:
        """`rows()` as a `pandas.DataFrame` indexed by coefficient.

        **Arguments**

        - `level`: of the confidence intervals.
        """
        pandas = require("pandas", "tables")

        return pandas.DataFrame(self.rows(level)).set_index("name").rename_axis("coefficient")

    def save(
        self, folder: str | Path, *, pictures: bool = True, command: str | None = None
    ) -> tuple[Path, ...]:
        """Writes the report into a folder: the files that `Report.save` writes of a robot.

        `identification.json` is read by `Identification.load`; torques are the known sides of the
        equations.

        **Arguments**

        - `folder`: is made if it is missing.
        - `pictures`: whether to draw known sides and outputs.
        - `command`: that repeats the identification, for the page.

        **Returns** the files.

        **Raises** as `Report.save`.
        """
        data = report_data(self, command=command)
        document = _document(self) | quality_document(data)
        return save_report(Path(folder), self, document, data, pictures=pictures)

    @property
    def verdict(self) -> str:
        """As `Report.verdict`."""
        return summary_text(report_data(self))

    def __repr__(self) -> str:
        return f"SystemReport({self.network.name}; {self.fit!r})"

    def __str__(self) -> str:
        return "\n\n".join("\n".join(section) for section in self._sections() if section)

    def _sections(self) -> Iterator[list[str]]:
        separation = self.network.system.separation
        yield [str(self.network), f"settings: {self.settings}"]
        yield [coefficient_text(self.rows())]
        yield [] if self.search is None else ["searched constants", str(self.search)]
        others = [str(row) for row in self.constants if row.name not in self.network.names]
        yield [
            *([f"constants: {', '.join(others)}"] if others else []),
            *(str(row) for row in separation.identifiability if row.verdict != "alone"),
            *separation.notes,
        ]
        yield determination_lines(self.fit, self.network.size, self.excitation)
        yield [] if self.correction is None else str(self.correction).splitlines()
        for name, table in self.errors.items():
            yield [f"equation error, {name} recording", str(table)]
        yield held_out_lines(self.held_out, "equation by equation")
        yield self._simulation_lines()
        yield [f"warning: {warning}" for warning in self.warnings]

    def _simulation_lines(self) -> list[str]:
        if self.simulation is None:
            return []
        if isinstance(self.simulation, str):
            return [f"not simulated: {self.simulation}"]
        return ["simulation, validation recording", str(self.simulation)]


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
        write_json(scratch / names[2], _separation_document(network))
    return tuple(folder / name for name in names)


def _separation_document(network: SystemNetwork) -> dict[str, Any]:
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


def _document(report: SystemReport) -> dict[str, Any]:
    """A report as plain data, without its patterns; with every entry of `Identification`'s."""
    network, errors = report.network, report.errors
    nonlinear = zip(network.system.nonlinear, np.asarray(network.nonlinear).tolist(), strict=True)
    return {
        **_separation_document(network),
        "settings": settings_document(report.settings),
        "expressions": [coefficient.expression for coefficient in network.coefficients],
        "units": [coefficient.unit for coefficient in network.coefficients],
        "searched": {constant.name: value for constant, value in nonlinear},
        "minima": _minima(report.search),
        "simulation": _simulation_document(report.simulation),
        "noise": _correction_document(report.correction),
        "constants": {
            row.name: {"value": row.value, "standard_error": row.standard_error}
            for row in report.constants
        },
        "unidentifiable": report.fit.unidentifiable,
        **report.fit.document(),
        "least_determined": report.excitation.worst_combination,
        "held_out": {
            "training_rms": report.held_out.training,
            "held_out_rms": report.held_out.held_out,
            "limit": report.held_out.limit,
            "beyond_chance": report.held_out.beyond_chance,
        },
        "equation_error_rms": {name: table.rms[0] for name, table in errors.items()},
        "share_judged": {name: table.share_judged for name, table in errors.items()},
        "warnings": report.warnings,
    }


def _correction_document(correction: NoiseCorrection | None) -> dict[str, Any] | None:
    if correction is None:
        return None
    return {
        "deviation": dict(correction.noise),
        "bias": correction.bias.tolist(),
        "smoothing_bias": correction.smoothing_bias.tolist(),
        "smoothing_remainder": correction.smoothing_remainder.tolist(),
        "equation_error_ratio": correction.ratio.tolist(),
        "explained": correction.explained,
        "draws": correction.draws,
    }


def _minima(search: ConstantSearch | None) -> list[dict[str, Any]]:
    """Of the error over the searched constants, the best first."""
    if search is None:
        return []
    return [
        {
            "constants": dict(zip(search.names, minimum.values.tolist(), strict=True)),
            "equation_error_rms": minimum.error.tolist(),
            "starts": minimum.starts,
        }
        for minimum in search.minima
    ]


def _simulation_document(simulation: Simulation | str | None) -> dict[str, Any] | None:
    if simulation is None:
        return None
    if isinstance(simulation, str):
        return {"not_simulated": simulation}
    rms = np.where(np.isfinite(simulation.error), simulation.error, np.nan)
    return {
        "seconds": float(simulation.time[-1] - simulation.time[0]),
        "rms": {
            name: None if np.isnan(value) else float(value)
            for name, value in zip(simulation.names, rms, strict=True)
        },
        "horizon": simulation.horizon(),
    }
