"""Identification of a system: `identify_system`, and the reports on it (thesis C.2)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import numpy as np

from ..least_squares import Identification, Settings
from ..recordings import AveragedSplines, Patterns, Preparation, choose_spacing
from ..report import (
    AbstractReport,
    AbstractSection,
    AnyReport,
    CoefficientSection,
    CurveSection,
    ErrorSection,
    ErrorTable,
    ExcitationSection,
    HeldOutSection,
    QualitySection,
    RecordingSection,
    RepeatSection,
    SettingsSection,
    WarningSection,
    all_or_nothing,
    coefficient_rows,
    compare,
    condition_warning,
    degree_of_excitation,
    read_report,
    write_csv,
    write_json,
)
from ..uncertainty import cross_validated_error, held_out_error
from ._constants import ConstantEstimate, constants_from
from ._description import DescriptionError
from ._network import SystemNetwork
from ._noise_correction import EquationsUndefined, Noise, NoiseCorrection, correct_for_noise
from ._recording import SystemRecording, check_noise, measurement_noise, system_patterns
from ._search import ConstantSearch, search_constants
from ._simulation import Simulation, simulate_system
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
                "follows_for": result.follows_for(),
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


# Spacings of splines that are tried, as by `choose_spacing`, and those for finer sampling.
_SPACINGS = (5, 7, 9, 11, 13, 15, 17, 21, 25, 29, 35, 41, 49, 69, 97)
# Splines need some twenty knots.
_KNOTS = 20


def identify_system(
    system: System,
    training: SystemRecording,
    validation: SystemRecording | None = None,
    settings: Settings | None = None,
    *,
    noise: Noise = "estimated",
    progress: Callable[[str], None] | None = None,
) -> SystemReport:
    """Identifies a system's coefficients from a recording, and judges the result (thesis C.2).

    Constants that enter nonlinearly are searched, as by `search_constants`. The identified system
    is simulated from the first sample of the validation recording, if its equations can be solved
    for the highest derivatives: see `simulate_system`.

    **Arguments**

    - `system`: n equations, p coefficients.
    - `training`: the recording to fit.
    - `validation`: a recording to judge the fit on; no coefficient depends on it.
    - `settings`: of preparation and fit; by default those of `system_settings` for the training
      recording.
    - `noise`: standard deviation of the white noise of columns, by name, 0 for the others; by
      default it is estimated from the recording. Its bias and that of smoothing are taken off
      the coefficients, and standard errors follow from it: see `correct_for_noise`. None
      leaves the fit as it is; so do constants that are searched.
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `SystemReport`.

    **Raises**

    - `DescriptionError`: a system that cannot be separated.
    - `ValueError`: a recording that cannot be used, named as training or validation recording;
      noise of no column, or below zero.
    - `RuntimeError`: a fit that fails, as of `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> report = jc.identify_system(*jc.examples.tank())
    >>> np.round(report.k, 4).tolist(), report.network.names
    ([3.0, 0.5], ('area', 'outlet'))
    """
    step = progress or (lambda words: None)
    step("separating constants")
    network = system.network
    recordings = {"training": training} | ({} if validation is None else {"validation": validation})
    step("preparing patterns")
    settings, patterns = _prepared(system, recordings, settings)
    search = None
    if system.nonlinear:
        step("searching constants")
        search = search_constants(system, patterns["training"], settings.solver)
        patterns = {name: search.with_known_sides(values) for name, values in patterns.items()}
        network, fit = search.network, search.coefficients
    else:
        step("fitting coefficients")
        fit = settings.fit(network, patterns["training"])
    correction, uncorrected = None, ()
    if noise is not None and not system.nonlinear:
        step("simulating noise")
        correction, uncorrected = _correction(
            system, training, patterns["training"], settings, fit, noise
        )
        fit = fit if correction is None else correction.fit
    simulation: Simulation | str | None = None
    if validation is not None:
        step("simulating")
        simulation = _simulated(network, fit, patterns["validation"])
    step("computing errors")
    constants = constants_from(system, fit)
    errors = {name: compare(network, values, {"fit": fit.k}) for name, values in patterns.items()}
    if validation is None:
        held_out = cross_validated_error(network, patterns["training"], settings, fit=fit)
    else:
        held_out = held_out_error(network, fit, patterns["training"], patterns["validation"])
    return SystemReport(
        network,
        settings,
        fit,
        MappingProxyType(patterns),
        errors=MappingProxyType(errors),
        excitation=degree_of_excitation(network, patterns["training"]),
        held_out=held_out,
        warnings=(
            *held_out.warnings,
            *uncorrected,
            *_warnings(network, fit, patterns["training"], errors["training"]),
        ),
        search=search,
        simulation=simulation,
        constants=constants,
        correction=correction,
    )


def system_settings(system: System, recording: SystemRecording) -> Settings:
    """Settings with a smoothing that suits a recording of a system.

    Averaged splines of the widest spacing that takes next to nothing from the states, each by
    itself, as `choose_spacing` finds it from how well splines predict held-out samples.
    They are divided where velocities change sign only if an equation contains a sign, as of dry
    friction: without one, accelerations do not jump.

    (A robot's settings are chosen by the torque that they predict. A known side that is zero, or
    made of derivatives, shrinks with smoothing, and would speak for ever more of it.)

    **Arguments**

    - `system`: whose states are smoothed.
    - `recording`: of all its states.

    **Returns** the settings; the defaults of a system without states.

    **Raises** `RecordingError` for a column that is missing.

    >>> import jaxcslc as jc
    >>> from jaxcslc.systems import system_settings
    >>> print(system_settings(*jc.examples.tank(samples=400)).preparation.smoothing.description)
    averaged splines of (5,) samples
    """
    if not system.states:
        return Settings()
    position = recording.stacked(system.variables[i].column_name for i in system.states)
    longest = max(recording.samples // _KNOTS, _SPACINGS[0])
    candidates = [spacing for spacing in _SPACINGS if spacing <= longest]
    sections = any(system.signs)
    spacing = choose_spacing(recording.time, position, candidates=candidates, sections=sections)
    return Settings(Preparation(AveragedSplines(spacing, sections)))


def _prepared(
    system: System, recordings: Mapping[str, SystemRecording], settings: Settings | None
) -> tuple[Settings, dict[str, Patterns]]:
    """Return the settings, by default those of the first recording, and patterns by recording."""
    patterns: dict[str, Patterns] = {}
    for name, recording in recordings.items():
        try:
            settings = settings or system_settings(system, recording)
            patterns[name] = system_patterns(system, recording, settings.preparation)
        except ValueError as error:
            raise ValueError(f"{name} recording: {error}") from None
    assert settings is not None
    return settings, patterns


def _simulated(network: SystemNetwork, fit: Identification, patterns: Patterns) -> Simulation | str:
    """Return the simulation of an identified system, or why it cannot be simulated."""
    try:
        return simulate_system(network.system, fit.k, patterns, network=network)
    except DescriptionError as error:
        return str(error)


def _correction(
    system: System,
    training: SystemRecording,
    patterns: Patterns,
    settings: Settings,
    fit: Identification,
    noise: Mapping[str, float] | Literal["estimated"],
) -> tuple[NoiseCorrection | None, tuple[str, ...]]:
    """The correction for noise, if there is any and the equations allow it, and warnings."""
    levels = measurement_noise(system, training) if noise == "estimated" else noise
    check_noise(system, levels)
    if not any(levels.values()):
        return None, ()
    try:
        correction = correct_for_noise(system, training, patterns, settings, fit, noise)
    except EquationsUndefined as error:
        return None, (f"{error}; no bias is taken off",)
    return correction, correction.warnings


def _warnings(
    network: SystemNetwork, fit: Identification, patterns: Patterns, errors: ErrorTable
) -> Iterator[str]:
    """Yield warnings of a meaningless condition and of equations that the fit explains poorly.

    An equation has a warning if the fit explains less than half of its known side's variance.
    """
    yield from condition_warning(fit)
    deviation = np.std(np.asarray(patterns.torque), axis=0)
    for name, rms, size in zip(
        network.output_names, np.asarray(errors.rms[0]), deviation, strict=True
    ):
        if size > 0.0 and rms > np.sqrt(0.5) * size:
            yield (
                f"{name}: training RMS {rms:.3g}, standard deviation of its known side {size:.3g}:"
                " the model explains less than half of the variance; check units and signs"
            )
