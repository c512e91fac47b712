"""Entry point: `identify_system`, from a recording to a `SystemReport` (thesis C.2)."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from ..least_squares import Identification, Settings
from ..recordings import AveragedSplines, Patterns, Preparation, choose_spacing
from ..report import ErrorTable, compare, condition_warning, degree_of_excitation
from ..uncertainty import cross_validated_error, held_out_error
from ._constants import constants_from
from ._description import DescriptionError
from ._network import SystemNetwork
from ._noise_correction import EquationsUndefined, Noise, NoiseCorrection, correct_for_noise
from ._recording import SystemRecording, check_noise, measurement_noise, system_patterns
from ._report import SystemReport
from ._search import search_constants
from ._simulation import Simulation, simulate_system
from ._system import System


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
