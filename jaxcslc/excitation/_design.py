"""Entry of the package: `design_motion`, and the `Planner` for several designs of one robot."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ..recordings import Recording
from ._criteria import (
    CRITERIA,
    ON_TASK,
    Knowledge,
    log_criterion,
    prior_information,
    wanted_indices,
)
from ._families import AbstractFamily, BSplines, FourierSeries, MinimumJerkMoves, Parameters
from ._feasibility import DenseCheck, Use
from ._information import (
    UNDETERMINED,
    MotionInformation,
    Prediction,
    coefficient_sizes,
    column_scaled,
    condition_of,
    error_covariance,
    regressor_of,
    time_grid,
)
from ._limits import Limits, Surroundings
from ._noise import Noise
from ._output import Design
from ._search import DesignProblem, Search
from ._task import body_prior, random_parameters, random_products, task_products
from .collision import CollisionBodies


FamilyName = Literal["splines", "fourier", "periodic", "moves"]
FAMILIES: tuple[FamilyName, ...] = get_args(FamilyName)

# Of families' parameters, by the duration [s].
_KNOT, _HARMONIC, _MOVE = 0.35, 0.6, 1.1
_COARSEST, _FINEST, _SAMPLES = 0.04, 0.01, 1000  # of the grid that motions are judged on
_REPAIRS, _REPAIR_PENALTY, _BESIDE = 4, 200.0, 0.004  # of distances to other bodies [m]
_NEAR = 1.002  # of a limit: shrinking by so little costs nothing
_RESTS = 200  # poses that are tried for a start


def family_named(name: str, duration: float) -> AbstractFamily:
    """A family with as many parameters as suit a duration.

    **Arguments**

    - `name`: `"splines"`, `"fourier"`, `"periodic"` or `"moves"`.
    - `duration`: of the motion [s].

    **Raises**

    - `ValueError`: another name.

    >>> family_named("splines", 7.0).description
    'quintic B-splines of 20 intervals'
    """
    if name == "splines":
        return BSplines(duration, int(np.clip(round(duration / _KNOT), 4, 60)))
    if name in ("fourier", "periodic"):
        harmonics = int(np.clip(round(duration / _HARMONIC), 3, 30))
        return FourierSeries(duration, harmonics, periodic=name == "periodic")
    if name == "moves":
        return MinimumJerkMoves(duration, int(np.clip(round(duration / _MOVE), 2, 40)))
    raise ValueError(f"family: expected {', '.join(FAMILIES)}, got {name!r}")


def design_motion(
    network: CSLC,
    limits: Limits,
    noise: Noise,
    *,
    duration: float = 10.0,
    family: str | AbstractFamily = "splines",
    wanted: Sequence[str] | None = None,
    criterion: str = "overall",
    knowledge: Knowledge | None = None,
    task: Recording | tuple[Any, Any, Any] | None = None,
    surroundings: Surroundings | None = None,
    start: Float[np.ndarray, " joints"] | None = None,
    seed: int = 0,
    starts: int = 3,
    rounds: int = 5,
    steps: int = 60,
    progress: Callable[[str], None] | None = None,
) -> Design:
    """Design the motion to record: that which makes predicted standard errors least.

    The logarithm of the criterion is minimised by gradients through the regressor under all limits
    (augmented Lagrangian, L-BFGS), from several random motions of which the best is refined. Then
    the motion is checked densely, bounds between samples included, and shrunk towards its start
    until it keeps every limit: what is returned always does.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `limits`: of joints.
    - `noise`: of the recording chain, and the estimator.
    - `duration`: [s], for a family by name.
    - `family`: of motions, or its name: `"splines"`, `"fourier"`, `"periodic"`, `"moves"`.
    - `wanted`: names, groups or kinds of coefficients that matter; all if None.
    - `criterion`: one of `CRITERIA`.
    - `knowledge`: of coefficients before; by default that of the robot's file.
    - `task`: motion on which torques are to be predicted, for the criteria `"overall"` and
      `"torque"`; random motions within the limits if None.
    - `surroundings`: bodies that must not collide; not watched if None.
    - `start`: the pose to start from, (n,); any if None.
    - `seed`: of the random motions; the same seed gives the same design.
    - `starts`, `rounds`, `steps`: random motions, rounds of multipliers, and steps in a round.
    - `progress`: is called with a few words. Ctrl-C ends the search; the best so far is returned.

    **Raises**

    - `ValueError`: no pose keeps the limits, with the limit; arguments that do not fit together.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import Knowledge, Limits, Noise, design_motion
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> knowledge = Knowledge(np.array([0.5, 2, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    >>> limits = Limits.of(arm, {"position": [-2, 2], "velocity": 3, "torque": 30})
    >>> design = design_motion(
    ...     network, limits, Noise(0.1, 1e-4), duration=3.0, knowledge=knowledge, starts=1, rounds=2
    ... )
    >>> design.use.feasible, bool(np.max(design.prediction.relative_error) < 0.2)
    (True, True)
    """
    planner = Planner.of(
        network,
        limits,
        noise,
        family_named(family, duration) if isinstance(family, str) else family,
        wanted=wanted,
        criterion=criterion,
        knowledge=knowledge,
        task=task,
        surroundings=surroundings,
        start=start,
        seed=seed,
    )
    return planner.design(seed, starts, rounds, steps, progress or (lambda _: None))


@dataclasses.dataclass(frozen=True, eq=False)
class Planner:
    """Shared data of all designs for one robot, family and wish.

    **Attributes**

    - `problem`: of the search; `check`: of limits; `bodies`: that must not collide, or None.
    - `family`, `limits`, `noise`, `knowledge`: as of `design_motion`.
    - `time`: the grid on which motions are judged.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import BSplines, Knowledge, Limits, Noise, Planner
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> knowledge = Knowledge(np.array([0.5, 2, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    >>> limits = Limits.of(arm, {"position": [-2, 2], "velocity": 3, "torque": 30})
    >>> network, family = jc.derive(arm, lengths="numeric"), BSplines(3.0, 8)
    >>> planner = Planner.of(network, limits, Noise(0.1, 1e-4), family, knowledge=knowledge)
    >>> planner.family.description, planner.bodies is None
    ('quintic B-splines of 8 intervals', True)
    """

    problem: DesignProblem
    check: DenseCheck
    bodies: CollisionBodies | None
    family: AbstractFamily
    limits: Limits
    noise: Noise
    knowledge: Knowledge
    time: Float[np.ndarray, " samples"]
    start: Float[np.ndarray, " joints"] | None

    @classmethod
    def of(
        cls,
        network: CSLC,
        limits: Limits,
        noise: Noise,
        family: AbstractFamily,
        *,
        wanted: Sequence[str] | None = None,
        criterion: str = "overall",
        knowledge: Knowledge | None = None,
        task: Recording | tuple[Any, Any, Any] | None = None,
        surroundings: Surroundings | None = None,
        start: Float[np.ndarray, " joints"] | None = None,
        seed: int = 0,
    ) -> "Planner":
        """Make a planner from the arguments of `design_motion`; raises as it does."""
        n = network.joint_count
        if criterion not in CRITERIA:
            raise ValueError(f"criterion: expected {', '.join(CRITERIA)}, got {criterion!r}")
        if task is not None and criterion not in ON_TASK:
            raise ValueError(
                f"criterion {criterion!r} has no task; expected {' or '.join(ON_TASK)}, or no task"
            )
        if start is not None and np.shape(start) != (n,):
            raise ValueError(f"start: expected {n} positions, got {np.shape(start)}")
        knowledge = knowledge or Knowledge.of_robot(network)
        deviation = noise.torque_deviation(n)
        noise.position_deviation(n)  # raises for another robot's
        coarse = np.clip(family.duration / _SAMPLES, _FINEST, _COARSEST)
        time, interval = time_grid(family.duration, float(coarse))
        model = knowledge.k if knowledge.is_model else None
        bodies = None if surroundings is None else CollisionBodies.of(network.robot, surroundings)
        check = DenseCheck(
            network, model, limits, family, distance=None if bodies is None else bodies.clearance
        )
        typical = family.motion(
            random_parameters(check, limits.middle, np.random.default_rng(seed)), time
        )
        torque = np.where(np.isfinite(limits.torque), limits.torque, 100 * deviation)
        size = coefficient_sizes(network, knowledge.k, typical, torque)
        information = MotionInformation(network, knowledge.k, size, noise, interval)
        of_task: Any = np.zeros((network.size, network.size))
        if criterion == "bodies":
            of_task = body_prior(network, size)
        elif task is not None:
            of_task = task_products(information, task)
        elif criterion in ON_TASK:
            rng = np.random.default_rng(seed)
            of_task = random_products(information, check, model, time, rng)
        problem = DesignProblem.of(
            information,
            family,
            time,
            limits,
            prior=prior_information(size, knowledge.information),
            wanted=wanted_indices(network, wanted),
            task=of_task,
            criterion=criterion,
            start=start,
        )
        return cls(problem, check, bodies, family, limits, noise, knowledge, time, start)

    def design(
        self, seed: int, starts: int, rounds: int, steps: int, progress: Callable[[str], None]
    ) -> Design:
        """The best of several starts, refined; see `design_motion`."""
        rng = np.random.default_rng(seed)
        pose = self.rest_pose(rng)
        spread = None if self.start is None else 0.0
        initial = [random_parameters(self.check, pose, rng, spread) for _ in range(starts)]
        contacts = None if self.bodies is None else self.bodies.contacts
        interrupted = False
        search = Search(self.problem, contacts)
        best, least = self.problem.variables(initial[0]), np.inf
        try:
            for number, parameters in enumerate(initial, 1):
                search.progress = lambda text, i=number: progress(f"start {i}, {text}")
                value = search.run(self.problem.variables(parameters), 2, max(steps // 3, 5))
                if value < least:
                    best, least = np.array(search.best), value
            search.progress = lambda text: progress(f"refining, {text}")
            search.run(best, rounds, steps)
            self._repair(search, steps)
        except KeyboardInterrupt:
            interrupted = True
            progress("interrupted: the best motion so far is checked")
        # A search that was interrupted may not have reached what an earlier one had.
        reached = [search.best] if not interrupted and search.best is not None else []
        reached = reached or [x for x in (best, search.best) if x is not None]
        scaled = [self.check.scaled(self._of_variables(x)) for x in reached]
        parameters, use, scale = min(scaled, key=lambda motion: self.criterion_of(motion[0]))
        notes = (*self.limits.notes, *self._notes(interrupted))
        return self.described(parameters, use, self.criterion_of(parameters), scale, notes)

    def _repair(self, search: Search, steps: int) -> None:
        """Search once more from where a search ended, with limits a little narrower.

        They are narrower where the dense check finds a motion beyond them between the search's
        samples. Other bodies are kept a little further away, as long as linear distances were not
        enough.
        """
        bodies, beside = self.bodies, _BESIDE
        for _ in range(_REPAIRS):
            parameters = self._of_variables(search.best)
            use = self.check.use(parameters)
            apart = use.distance is None or use.distance >= 0.0
            if apart and max(float(x.max()) for x in use.joints.values()) <= _NEAR:
                return
            search.problem = search.problem.narrowed(use.joints)
            if bodies is not None and not apart:
                beside *= 1.5
                search.contacts = functools.partial(bodies.contacts, beside=beside)
            x = self.problem.variables(parameters)
            search.run(x, 2, steps, _REPAIR_PENALTY, search.multipliers)

    def _of_variables(self, x: Any) -> Parameters:
        return np.asarray(self.problem.parameters(jnp.asarray(x)))

    def rest_pose(self, rng: np.random.Generator) -> Float[np.ndarray, " joints"]:
        """A pose in which the arm can rest: that to start from, the middle of the ranges, or the
        first random one.

        **Raises**

        - `ValueError`: no pose keeps the limits at rest; names the limit.
        """
        middle = self.limits.middle
        half = (self.limits.high - self.limits.low) / 2
        fallback: Use | None = None
        for number in range(1 if self.start is not None else _RESTS):
            pose = middle if number == 0 else middle + half * rng.uniform(-0.8, 0.8, len(half))
            pose = pose if self.start is None else self.start
            parameters = np.zeros((self.family.size, len(pose)))
            parameters[0] = pose
            use = self.check.use(parameters)
            if use.feasible:
                return pose
            fallback = fallback or use
        assert fallback is not None
        where = "the start" if self.start is not None else f"any of {_RESTS} poses"
        raise ValueError(f"no motion keeps the limits: at rest in {where}, {fallback.worst}")

    def criterion_of(self, parameters: Parameters) -> float:
        """The criterion of a motion on the grid."""
        problem = self.problem
        motion = self.family.motion(np.asarray(parameters), self.time)
        moments = self.moments(motion)
        value = log_criterion(
            problem.criterion, moments, problem.prior, problem.wanted, problem.task
        )
        return float(np.exp(value))

    def moments(self, motion: Any) -> Any:
        """Compute the information that a motion on the grid has about the coefficients."""
        information = self.problem.information
        q, qd, qdd = (np.asarray(x) for x in motion)
        regressor = regressor_of(information.network, q, qd, qdd)
        return _moments(information, (q, qd, qdd), information.spectra(q), regressor)

    def prediction(self, motion: Any) -> Prediction:
        """Standard errors after a motion on the grid, and after what was known before."""
        return predicted(self.problem.information, self.knowledge, self.moments(motion))

    def described(
        self, parameters: Parameters, use: Use, value: float, scale: float, notes: tuple[str, ...]
    ) -> Design:
        """A `Design` of a motion."""
        network = self.problem.information.network
        names = tuple(network.names[i] for i in np.asarray(self.problem.wanted))
        motion = self.family.motion(np.asarray(parameters), self.time)
        return Design(
            network,
            self.family,
            np.asarray(parameters),
            self.limits,
            use,
            self.noise,
            self.prediction(motion),
            self.problem.criterion,
            value,
            names,
            scale,
            notes,
        )

    def _notes(self, interrupted: bool) -> list[str]:
        notes: list[str] = []
        if not self.knowledge.is_model:
            notes.append(
                "the robot's file has no masses: torques are not limited, and noise of positions"
                " does not count; expected an earlier identification"
            )
        if interrupted:
            notes.append("interrupted: the best motion until then")
        return notes


def predicted(information: MotionInformation, knowledge: Knowledge, moments: Any) -> Prediction:
    """Standard errors after a motion of these moments."""
    size, network = information.size, information.network
    prior = prior_information(size, knowledge.information, UNDETERMINED)
    covariance = np.asarray(error_covariance(moments, jnp.asarray(prior))) * np.outer(size, size)
    plain = np.asarray(moments.plain)
    return Prediction(
        network.names,
        tuple(coefficient.unit for coefficient in network.coefficients),
        knowledge.k,
        size,
        covariance,
        knowledge.standard_error,
        condition_of(plain),
        condition_of(column_scaled(plain)),
    )


@eqx.filter_jit
def _moments(information: MotionInformation, motion: Any, spectra: Any, regressor: Any) -> Any:
    return information.moments(motion, spectra, regressor)
