import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ...motion import Patterns, Recording, joined_patterns
from ...network import CSLC
from .._held_out import RelativeError, Source
from .._held_out_part import FEWEST_SAMPLES, held_out_from
from ..friction import along_motion, state_at
from ..likelihood import Estimator, EstimatorComparison, LikelihoodFit, MaximumLikelihood
from ..possible import (
    Choice,
    Part,
    PhysicalParameters,
    PossibleFit,
    fixed_bodies,
    judged_bodies,
    possible_coefficients,
)
from ..prior import Known, Prior, with_knowledge
from ..report import Report, predicted_torque
from ..solver import Identification
from ._checks import EstimatorChoice, check_size
from ._likelihood_fits import (
    FitsBeside,
    LikelihoodFits,
    estimator_for,
    fit_before,
    on_time,
    start_of,
)
from ._likelihood_report import JudgedErrors, likelihood_report
from ._with_states import fit_along, with_states


# Estimators are judged in as many stretches, whose spread says what is chance.
_STRETCHES = 8


def with_likelihood(
    report: Report,
    network: CSLC,
    training: Mapping[str, Recording],
    validation: Recording | None,
    *,
    estimator: EstimatorChoice,
    likelihood: MaximumLikelihood | None,
    possible: Choice,
    prior: Prior | None,
    memory: float,
    step: Callable[[str], None],
    beside: FitsBeside | None = None,
) -> Report:
    """A report of least squares with maximum likelihood beside it, and the better one's numbers.

    **Arguments**

    - `report`: of least squares.
    - `network`: that the recordings are to be identified by, slopes not fitted yet.
    - `training`: by name; `validation`: as of `identify`.
    - `estimator`: `"maximum-likelihood"`, or `"auto"`: it is used where it predicts motion that was
      not fitted better than least squares, by more than chance and by 1 %. They are judged by
      `MaximumLikelihood.misfit`: torque errors of smoothed motion favour regression on such.
    - `likelihood`, `possible`, `prior`, `memory`, `step`: as of `identify`. Where it has lengths of
      pre-sliding, dry friction of both estimators has states over them.
    - `beside`: fits that have begun; they are computed now if None.

    **Returns** the report; `report.estimators` compares the two.

    **Raises**

    - `ValueError`, `RuntimeError`: as `MaximumLikelihood.fit`, unless `"auto"`; and lengths that
      are not those of the network.
    """
    likelihood = likelihood or MaximumLikelihood()
    report = with_states(report, likelihood.lengths)
    try:
        check_size(network, training, memory)
        judged = _Judged(
            report,
            network,
            training,
            validation,
            likelihood,
            possible,
            prior,
            step,
            beside,
        )
        return judged.report(estimator)
    except (ValueError, RuntimeError) as error:
        if estimator != "auto":
            raise
        warning = f"maximum likelihood failed, least squares is used: {error}"
        return dataclasses.replace(report, warnings=(*report.warnings, warning))


class _Unfitted(NamedTuple):
    """Motion that was not fitted, and what estimators that have not seen it make of it.

    - `source`: of the motion.
    - `recordings`: as recorded; `patterns`: as the report's settings prepare them.
    - `least_squares`: (p,) its coefficients, those of possible bodies where the report has them.
    - `likelihood`: the other fit, as it is.
    - `contact`: (n,) states of dry friction that the patterns start with; None for zeros.
    """

    source: Source
    recordings: Sequence[Recording]
    patterns: Patterns
    least_squares: np.ndarray
    likelihood: LikelihoodFit
    contact: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class _Judged:
    """Both estimators of the same recordings; fields as the arguments of `with_likelihood`."""

    least_squares: Report
    network: CSLC
    training: Mapping[str, Recording]
    validation: Recording | None
    options: MaximumLikelihood
    possible: Choice
    prior: Prior | None
    step: Callable[[str], None]
    beside: FitsBeside | None

    def report(self, estimator: EstimatorChoice) -> Report:
        """The report of the estimator that is asked for, or better."""
        self.step("maximum likelihood")
        training = self._on_time(self.training.values())
        if self.beside is None:
            start = start_of(self.network, self._fit_with_states)
            likelihood = self._with_bodies.fit(self.network, training, start, self.step)
            fits = LikelihoodFits(likelihood, None)
        else:
            fits = self.beside.result()
        base, likelihood = self.least_squares, fits.whole
        unfitted = self._unfitted(fits)
        ours, theirs = (
            along_motion(network, unfitted.patterns, likelihood.lengths, unfitted.contact)
            for network in (likelihood.network, base.network)
        )
        parts = Part.held_out(ours, unfitted.patterns, unfitted.likelihood.fit, _STRETCHES)
        fit = likelihood.free
        if fit is None:
            fit = self._informed(likelihood.fit)
        bodies, _, sentences = judged_bodies(
            likelihood.network,
            fit,
            base.patterns["training"],
            lambda: parts,
            choice=self.possible,
            prior=self.prior,
            source=unfitted.source,
            parameters=likelihood.bodies,
            step=self.step,
        )
        self.step("judging estimators")
        predicted = self._predicted(unfitted.likelihood.fit, bodies)
        torque, mask = np.asarray(unfitted.patterns.torque), np.asarray(unfitted.patterns.mask)
        errors: dict[Estimator, np.ndarray] = {
            "least-squares": torque
            - predicted_torque(theirs, unfitted.patterns, unfitted.least_squares),
            "maximum-likelihood": torque - predicted_torque(ours, unfitted.patterns, predicted),
        }
        relative = self._relative(unfitted, predicted)
        better: Estimator = (
            "maximum-likelihood"
            if estimator == "maximum-likelihood" or relative.beyond_chance()
            else "least-squares"
        )
        comparison = EstimatorComparison(
            unfitted.source,
            MappingProxyType({name: _rms(error, mask) for name, error in errors.items()}),
            MappingProxyType(
                {name: _rms(error, np.ones_like(mask)) for name, error in errors.items()}
            ),
            relative,
            better,
            likelihood,
            base.network.output_units,
        )
        notes = (*base.notes, *_notes(self.training))
        base = dataclasses.replace(base, estimators=comparison, notes=notes)
        if better == "least-squares":
            return base
        fit = fit if bodies is None else bodies.fit if likelihood.free is None else likelihood.fit
        self.step("computing errors")
        judged = JudgedErrors(errors["maximum-likelihood"], mask, unfitted.source)
        base = likelihood_report(base, likelihood, fit, bodies, judged)
        return dataclasses.replace(base, warnings=(*sentences, *base.warnings))

    @property
    def _estimator(self) -> MaximumLikelihood:
        return estimator_for(self.options, self.least_squares.settings)

    @property
    def _with_bodies(self) -> MaximumLikelihood:
        """The estimator of everything, whose search has possible bodies if they are used anyway."""
        prior = self.prior or self.options.prior or Prior()
        bounds = any(
            entry.value is None or entry.low > -np.inf or entry.high < np.inf
            for entry in prior.coefficients.values()
        )
        if bounds or not (self.possible == "always" or prior.links):
            return self._estimator
        return dataclasses.replace(self._estimator, possible=True, prior=prior)

    def _on_time(self, recordings: Iterable[Recording]) -> list[Recording]:
        return on_time(self.least_squares.settings, recordings)

    def _unfitted(self, fits: LikelihoodFits) -> _Unfitted:
        report, likelihood = self.least_squares, fits.whole
        if self.validation is not None:
            return _Unfitted(
                "validation",
                self._on_time([self.validation]),
                report.patterns["validation"],
                np.asarray(report.fit.k)
                if report.pre_sliding is None
                else self._regression(report.patterns["training"]),
                likelihood,
            )
        shortest = min(recording.samples for recording in self.training.values())
        if shortest < FEWEST_SAMPLES:
            raise ValueError(
                f"{shortest} samples are too few to hold a stretch out; expected"
                f" {FEWEST_SAMPLES} or a validation recording"
            )
        settings = report.settings.with_options(torque_lag=0.0)
        training = self._on_time(self.training.values())
        late: list[Recording] = []
        fitted: list[Patterns] = []
        unfitted: list[Patterns] = []
        contacts: list[np.ndarray] = []
        for recording in training:
            start, end, split = recording.time[0], recording.time[-1], held_out_from(recording)
            late.append(recording.between(split - float(start), float(end - start)))
            patterns = settings.patterns(recording)
            fitted.append(patterns.between(float(start), split))
            unfitted.append(patterns.between(split, float(end)))
            first = int(np.searchsorted(np.asarray(patterns.time), unfitted[-1].time[0]))
            contacts.append(state_at(patterns, self._lengths, first))
        k = self._regression(joined_patterns(fitted))
        shorter = fits.before
        if shorter is None:
            shorter = fit_before(self._estimator, self.network, training, likelihood, self.step)
        together = joined_patterns(unfitted)
        return _Unfitted("held-out stretch", late, together, k, shorter, contacts[0])

    def _regression(self, patterns: Patterns) -> np.ndarray:
        """(p,) coefficients of least squares, those of possible bodies where the report has them,
        with the dry friction that maximum likelihood has."""
        report = self.least_squares
        fit = fit_along(report, patterns, self._lengths)
        fit = with_knowledge(fit, self._known)
        if report.possible is not None and report.possible.used:
            return self._possible(report.network, fit, report.possible.parameters)
        return np.asarray(fit.k)

    @property
    def _lengths(self) -> np.ndarray:
        """(n,) of pre-sliding."""
        states = self.least_squares.pre_sliding
        return np.zeros(self.network.joint_count) if states is None else states.lengths

    @property
    def _fit_with_states(self) -> Identification:
        """Of least squares, with the friction that maximum likelihood has."""
        states = self.least_squares.pre_sliding
        return self.least_squares.fit if states is None else states.fit

    def _informed(self, fit: Identification) -> Identification:
        """A fit of maximum likelihood with what is known, unless its search knew it."""
        return fit if self.options.prior is not None else with_knowledge(fit, self._known)

    def _predicted(self, fit: Identification, bodies: PossibleFit | None) -> np.ndarray:
        """The coefficients of maximum likelihood that unfitted motion is predicted by."""
        fit = self._informed(fit)
        if bodies is None or not bodies.used:
            return np.asarray(fit.k)
        return self._possible(self.network, fit, bodies.parameters)

    def _possible(
        self, network: CSLC, fit: Identification, bodies: PhysicalParameters
    ) -> np.ndarray:
        """Coefficients of the bodies nearest to a fit, with the prior's weight of other bodies."""
        robot = network.robot
        knowledge = () if self.prior is None else self.prior.link_values(robot)
        return possible_coefficients(
            network, fit, fixed_bodies(robot), knowledge, bodies.prior_weight
        )

    @property
    def _known(self) -> Mapping[int, Known]:
        return {} if self.prior is None else self.prior.coefficient_values(self.network)

    def _relative(self, unfitted: _Unfitted, predicted: np.ndarray) -> RelativeError:
        """Misfits of maximum likelihood over those of least squares."""
        likelihood = unfitted.likelihood
        estimator = self._estimator.as_of(likelihood)
        levels = (
            np.sqrt(np.mean(likelihood.torque_noise**2, axis=0)),
            np.sqrt(np.mean(likelihood.position_noise**2, axis=0)),
        )
        other = _with_coefficients(
            likelihood.network, self.least_squares.network, unfitted.least_squares
        )
        rigid = dataclasses.replace(likelihood, transmission=None)
        ours, theirs = (
            estimator.misfit(network, unfitted.recordings, k, *levels, fit)
            for network, k, fit in (
                (likelihood.network, predicted, likelihood),
                (*other, rigid),
            )
        )
        stretches = np.array_split(np.arange(len(ours.mask)), _STRETCHES)
        return RelativeError.of(
            *(
                [values[rows] for rows in stretches]
                for values in (ours.error, theirs.error, ours.mask & theirs.mask)
            )
        )


def _with_coefficients(network: CSLC, other: CSLC, k: np.ndarray) -> tuple[CSLC, np.ndarray]:
    """Another network as this one, with zeros for what it lacks: no function is compiled for it."""
    if not set(other.names) <= set(network.names):
        return other, k
    index = {name: number for number, name in enumerate(network.names)}
    result = np.zeros(network.size)
    result[[index[name] for name in other.names]] = k
    slopes = other.static_slopes
    return network if slopes is None else network.with_static_slopes(slopes), result


def _notes(training: Mapping[str, Recording]) -> list[str]:
    return [
        f"{name}: recorded velocities are not used by maximum likelihood"
        for name, recording in training.items()
        if recording.velocity is not None
    ]


def _rms(error: np.ndarray, mask: np.ndarray) -> np.ndarray:
    counts = np.maximum(mask.sum(axis=0), 1)
    return np.sqrt(np.sum(np.where(mask, error, 0.0) ** 2, axis=0) / counts)
