import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ....manipulator import RobotError
from ....motion import Patterns
from ....network import CSLC, AbstractLinearNetwork
from ..._held_out import HeldOut
from ..._settings import Settings, settings_document
from ...likelihood import EstimatorComparison
from ...possible import PhysicalParameters, PossibleFit
from ...prediction import HorizonError
from ...selection import FrictionChoice, Selection
from ...several import SeveralFit
from ...solver import Identification
from .._errors import ErrorTable, predicted_torque
from .._excitation import Excitation
from .._report_text import expression_legend
from ._bodies import arm_document
from ._curves import friction_points, torque_curves
from ._quality import fit_quality


_LIBRARIES = ("jaxcslc", "jax", "jaxlib", "equinox", "numpy", "scipy", "sympy")
# Pairs of coefficients that are listed as correlated.
_MOST_PAIRS = 12
_CORRELATED = 0.9


@runtime_checkable
class WritableReport(Protocol):
    """What a report has, of a robot or of another system, that files are written from."""

    @property
    def network(self) -> AbstractLinearNetwork: ...

    @property
    def settings(self) -> Settings: ...

    @property
    def fit(self) -> Identification: ...

    @property
    def patterns(self) -> Mapping[str, Patterns]: ...

    @property
    def errors(self) -> Mapping[str, ErrorTable]: ...

    @property
    def excitation(self) -> Excitation | None: ...

    @property
    def held_out(self) -> HeldOut | None: ...

    @property
    def warnings(self) -> tuple[str, ...]: ...

    def rows(self, level: float = 0.95) -> list[dict[str, str | float | bool]]: ...

    def network_along(self, recording: str) -> AbstractLinearNetwork: ...


def report_data(
    report: WritableReport,
    *,
    selection: Selection | None = None,
    bodies: PhysicalParameters | None = None,
    possible: PossibleFit | None = None,
    several: SeveralFit | None = None,
    judged_part: str | None = None,
    estimators: EstimatorComparison | None = None,
    horizon: HorizonError | None = None,
    friction: FrictionChoice | None = None,
    findings: Sequence[str] = (),
    notes: Sequence[str] = (),
    command: str | None = None,
) -> dict[str, Any]:
    """Everything that a report's page shows, as plain data.

    **Arguments**

    - `report`: of a robot or of another system.
    - `selection`: of its settings, with every trial.
    - `bodies`: possible ones nearest to the fit.
    - `possible`: how they predict torque, beside the fit.
    - `several`: of several training recordings.
    - `judged_part`: of a long recording, in words.
    - `estimators`: beside each other.
    - `horizon`: errors of open-loop simulation.
    - `friction`: terms that were tried, joint by joint.
    - `findings`: about the recordings, a sentence each, beside the report's own warnings.
    - `notes`: what readers decided, a sentence each.
    - `command`: that repeats it.

    **Returns** numbers, texts, lists and dictionaries with texts as keys. Numbers are those of the
    report, but for the points of curves: they have five digits.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification.report.page import report_data
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], q, torque)
    >>> data = report_data(jc.identify(network, recording, settings=jc.Settings()))
    >>> data["joints"], round(data["recordings"]["training"]["quality"]["all"]["r_squared"][0], 3)
    (['joint 1'], 1.0)
    """
    network, fit = report.network, report.fit
    k = np.asarray(fit.k)
    joints = list(network.output_names)
    along = {name: report.network_along(name) for name in report.patterns}
    predicted = {
        name: np.asarray(predicted_torque(along[name], patterns, k))
        for name, patterns in report.patterns.items()
    }
    recordings = {
        name: _recording(network, patterns, predicted[name], len(predicted))
        for name, patterns in report.patterns.items()
    }
    data: dict[str, Any] = {
        "name": network.name,
        "kind": network.output_kind,
        "quantity": network.output_quantity,
        "joints": joints,
        "units": list(network.output_units),
        "recordings": recordings,
        "coefficients": report.rows(),
        "legend": expression_legend(network) if isinstance(network, CSLC) else None,
        "degrees_of_freedom": float(fit.degrees_of_freedom),
        "errors_of_fit": fit.errors,
        "rank": int(fit.rank),
        "condition": float(fit.condition),
        "meaningful": bool(fit.meaningful),
        "unidentifiable": list(fit.unidentifiable),
        "correlation": np.asarray(fit.correlation).tolist(),
        "correlated": _correlated(fit),
        "excitation": None if report.excitation is None else _excitation(report.excitation),
        "held_out": None if report.held_out is None else _held_out(report.held_out),
        "warnings": list(report.warnings),
        "findings": list(findings),
        "notes": list(notes),
        "settings": str(report.settings),
        "settings_document": settings_document(report.settings),
        "trials": [] if selection is None else _trials(selection),
        "friction": [],
        "friction_trials": [] if friction is None else friction.document(),
        "bodies": None,
        "several": None if several is None else several.document(),
        "estimators": None if estimators is None else estimators.document(),
        "horizon": None if horizon is None else horizon.document(),
        "versions": versions(),
        "judged_part": judged_part,
        "command": command,
    }
    network = along["training"]
    if isinstance(network, CSLC):
        training = report.patterns["training"]
        data["friction"] = friction_points(network, k, training, predicted["training"])
        if bodies is not None:
            data["bodies"] = _bodies(network, bodies, np.asarray(training.q)[0])
            data["bodies"]["judged"] = None if possible is None else _judged(possible)
    return data


def versions() -> dict[str, str]:
    """Of Python and of the libraries that numbers depend on."""
    numbers = {"Python": platform.python_version()}
    for library in _LIBRARIES:
        try:
            numbers[library] = version(library)
        except PackageNotFoundError:  # a copy that was not installed
            numbers[library] = "unknown"
    return numbers


def _recording(
    network: AbstractLinearNetwork, patterns: Patterns, predicted: np.ndarray, count: int
) -> dict[str, Any]:
    time, q, qd = (np.asarray(values) for values in (patterns.time, patterns.q, patterns.qd))
    per_joint = isinstance(network, CSLC)  # of other systems, motion is of variables
    return {
        "samples": patterns.samples,
        "duration": float(time[-1] - time[0]),
        "interval": float(np.median(np.diff(time))) if len(time) > 1 else None,
        "share_judged": np.mean(np.asarray(patterns.mask), axis=0).tolist(),
        "lowest": np.min(q, axis=0).tolist() if per_joint else None,
        "highest": np.max(q, axis=0).tolist() if per_joint else None,
        "top_speed": np.max(np.abs(qd), axis=0).tolist() if per_joint else None,
        "quality": fit_quality(patterns, predicted),
        "curves": torque_curves(patterns, predicted, count),
    }


def _correlated(fit: Identification) -> list[dict[str, Any]]:
    """The most correlated pairs of coefficients, the largest first."""
    correlation = np.asarray(fit.correlation)
    rows, columns = np.triu_indices(len(correlation), 1)
    size = np.abs(correlation[rows, columns])
    strongest = [i for i in np.argsort(-size, kind="stable")[:_MOST_PAIRS] if size[i] > _CORRELATED]
    return [
        {
            "first": fit.names[rows[i]],
            "second": fit.names[columns[i]],
            "correlation": float(correlation[rows[i], columns[i]]),
        }
        for i in strongest
    ]


def _excitation(excitation: Excitation) -> dict[str, Any]:
    return {
        "condition": float(excitation.condition),
        "smallest": float(excitation.smallest),
        "least_determined": excitation.worst_combination,
        "groups": excitation.rows(),
    }


def _held_out(held_out: HeldOut) -> dict[str, Any]:
    return {
        "source": held_out.source,
        "training_rms": held_out.training.tolist(),
        "held_out_rms": held_out.held_out.tolist(),
        "ratio": held_out.ratio.tolist(),
        "limit": held_out.limit.tolist(),
        "beyond_chance": list(held_out.beyond_chance),
    }


def _trials(selection: Selection) -> list[dict[str, Any]]:
    """The trials of a selection, the best first."""
    ordered = sorted(selection.trials, key=lambda trial: trial.score)
    return [
        {
            "settings": str(trial.settings),
            "score": float(trial.score),
            "error": trial.error.tolist(),
            "selected": trial.settings == selection.settings,
        }
        for trial in ordered
    ]


def _bodies(network: CSLC, bodies: PhysicalParameters, q: np.ndarray) -> dict[str, Any]:
    names = [
        f"link of {joint}" if body.isdigit() else body
        for body, joint in zip(bodies.body_names, network.robot.joint_names, strict=True)
    ]
    links = [
        {
            "mass": float(link.mass),
            "centre": np.asarray(link.centre_of_gravity, float).tolist(),
            "inertia": np.asarray(link.inertia, float).tolist(),
            "motor_inertia": float(link.motor_inertia),
        }
        for link in bodies.bodies
    ]
    document: dict[str, Any] = {
        "names": names,
        "links": links,
        "distance": float(bodies.distance),
        "torque_distance": bodies.torque_distance.tolist(),
        "arm": None,
    }
    try:
        document["arm"] = arm_document(
            network.robot, bodies.links, names, np.asarray(network.positions_of_all_joints(q))
        )
    except RobotError as error:
        document["no_arm"] = str(error)
    return document


def _judged(possible: PossibleFit) -> dict[str, Any]:
    return {
        "used": possible.used,
        "source": possible.held_out.source,
        "held_out_rms": possible.held_out.held_out.tolist(),
        "free_held_out_rms": possible.free_held_out.held_out.tolist(),
        "change": possible.change,
        "change_error": possible.change_error,
    }
