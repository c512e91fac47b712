"""Designs of motions: `design_motion`, and the `Planner` for several designs of one robot."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ._collision import BESIDE, CollisionBodies
from ._criteria import (
    ON_TASK,
    Goal,
    Knowledge,
    body_prior,
    log_criterion,
    prior_information,
    random_parameters,
    random_products,
    task_products,
    wanted_indices,
)
from ._families import AbstractFamily, BSplines, FourierSeries, MinimumJerkMoves, Parameters
from ._feasibility import DenseCheck, Use
from ._information import (
    UNDETERMINED,
    MotionInformation,
    Noise,
    Prediction,
    coefficient_sizes,
    condition_number,
    error_covariance,
    motion_regressor,
    time_grid,
)
from ._limits import Limits
from ._output import Design
from ._search import DesignProblem, Search


FamilyName = Literal["splines", "fourier", "periodic", "moves"]
FAMILIES: tuple[FamilyName, ...] = get_args(FamilyName)
"""Names of the families of motions."""

# Settings of searches. `scripts/studies/excitation/study.py` judges them by what designs reach.
_KNOT, _HARMONIC, _MOVE = 0.35, 0.6, 1.1  # duration per parameter of each family [s]
_COARSEST, _FINEST = 0.04, 0.01  # intervals of the grid that motions are judged on [s]
_SAMPLES = 1000  # of that grid, between these intervals
_REPAIRS, _REPAIR_PENALTY = 4, 200.0  # searches after the first; their penalty
_LOOK = 0.03  # from one look at distances of bodies to the next [s]
_FURTHER = 1.5  # factor of what is kept beside the clearance, from repair to repair
_NEAR = 1.002  # of a limit: shrinking by so little costs nothing
_RESTS = 200  # poses that are tried for a start


def family_named(name: str, duration: float) -> AbstractFamily:
    """Return a family with as many parameters as suit a duration.

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


@dataclasses.dataclass(frozen=True)
class Effort:
    """Length of a search.

    **Attributes**

    - `starts`: random motions, of which the best is refined.
    - `rounds`: of multipliers, when refining.
    - `steps`: of L-BFGS in a round.
    - `seed`: of the random motions; the same seed gives the same design.
    """

    starts: int = 3
    rounds: int = 5
    steps: int = 60
    seed: int = 0


_MOST_SAMPLES = 1e6  # half an hour at 500 Hz; of some kB each while a motion is judged


def design_motion(
    network: CSLC,
    limits: Limits,
    noise: Noise,
    *,
    goal: Goal | None = None,
    knowledge: Knowledge | None = None,
    duration: float = 10.0,
    family: str | AbstractFamily = "splines",
    start: Float[np.ndarray, " joints"] | None = None,
    effort: Effort = Effort(),
    progress: Callable[[str], None] | None = None,
) -> Design:
    """Design the motion to record: the one with the smallest predicted standard errors.

    The logarithm of the criterion is minimised by gradients through the regressor under all limits
    (augmented Lagrangian, L-BFGS), from several random motions of which the best is refined. Then
    the motion is checked densely, bounds between samples included, and scaled about its start
    until it satisfies all limits: what is returned always does.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `limits`: of joints, and surroundings.
    - `noise`: of the recording chain, and the estimator.
    - `goal`: criterion, coefficients that matter, and motion to predict; `Goal()` if None.
    - `knowledge`: of coefficients before; by default that of the robot's file.
    - `duration`: [s], for a family by name.
    - `family`: of motions, or its name: `"splines"`, `"fourier"`, `"periodic"`, `"moves"`.
    - `start`: the pose to start from, (n,); any if None.
    - `effort`: length of the search, and its seed.
    - `progress`: is called with a few words. Ctrl-C ends the search; the best so far is returned.

    **Raises**

    - `ValueError`: no pose keeps the limits, with the limit; arguments that do not fit together.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import Effort, Knowledge, Limits, Noise, design_motion
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> knowledge = Knowledge(np.array([0.5, 2, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    >>> limits = Limits.of(network.robot, {"position": [-2, 2], "velocity": 3, "torque": 30})
    >>> noise, effort = Noise(0.1, 1e-4), Effort(starts=1, rounds=2)
    >>> design = design_motion(
    ...     network, limits, noise, duration=3.0, knowledge=knowledge, effort=effort
    ... )
    >>> design.use.feasible, bool(np.max(design.prediction.sized_error) < 0.2)
    (True, True)
    """
    family = family_named(family, duration) if isinstance(family, str) else family
    if not family.duration * noise.rate <= _MOST_SAMPLES:
        raise ValueError(
            f"duration: expected at most {_MOST_SAMPLES / noise.rate:.3g} s at {noise.rate:g} Hz,"
            f" got {family.duration:g} s"
        )
    planner = Planner.of(
        network,
        limits,
        noise,
        family,
        goal=goal,
        knowledge=knowledge,
        start=start,
        seed=effort.seed,
    )
    return planner.design(effort, progress)


@dataclasses.dataclass(frozen=True, eq=False)
class Planner:
    """Shared data of all designs for one robot, family and goal.

    **Attributes**

    - `problem`: of the search; `check`: of limits.
    - `bodies`: that must not collide; None if there are none, or none are watched.
    - `collisions`: sentences on the collisions that are looked for; empty if none are.
    - `family`, `limits`, `noise`, `knowledge`, `start`: as of `design_motion`.
    - `time`: the grid on which motions are judged.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.excitation import BSplines, Knowledge, Limits, Noise, Planner
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> knowledge = Knowledge(np.array([0.5, 2, 0.1, 0.2, 0.3]), None, np.full(5, np.inf))
    >>> limits = Limits.of(network.robot, {"position": [-2, 2], "velocity": 3, "torque": 30})
    >>> noise, family = Noise(0.1, 1e-4), BSplines(3.0, 8)
    >>> planner = Planner.of(network, limits, noise, family, knowledge=knowledge)
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
    collisions: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        network: CSLC,
        limits: Limits,
        noise: Noise,
        family: AbstractFamily,
        *,
        goal: Goal | None = None,
        knowledge: Knowledge | None = None,
        start: Float[np.ndarray, " joints"] | None = None,
        seed: int = 0,
    ) -> "Planner":
        """Make a planner from the arguments of `design_motion`; raises as it does."""
        n = network.joint_count
        if start is not None and np.shape(start) != (n,):
            raise ValueError(f"start: expected {n} positions, got {np.shape(start)}")
        goal, knowledge = goal or Goal(), knowledge or Knowledge.of_robot(network)
        deviation = noise.torque_deviation(n)
        noise.position_deviation(n)  # raises for another robot's
        time, interval = time_grid(
            family.duration, float(np.clip(family.duration / _SAMPLES, _FINEST, _COARSEST))
        )
        model = knowledge.k if knowledge.is_model else None
        bodies = limits.surroundings and CollisionBodies.of(network.robot, limits.surroundings)
        collisions = () if bodies is None else bodies.notes
        bodies = bodies if bodies is not None and len(bodies.pairs) else None
        clearance = None if bodies is None else bodies.clearance
        check = DenseCheck(network, model, limits, family, distance=clearance)
        rng = np.random.default_rng(seed)
        typical = family.motion(random_parameters(check, limits.middle, rng), time)
        torque = np.where(np.isfinite(limits.torque), limits.torque, 100 * deviation)
        size = coefficient_sizes(network, knowledge.k, typical, torque)
        information = MotionInformation(network, knowledge.k, size, noise, interval)
        task: Any = np.zeros((network.size, network.size))
        if goal.criterion == "bodies":
            task = body_prior(network, size)
        elif goal.task is not None:
            task = task_products(information, goal.task)
        elif goal.criterion in ON_TASK:
            rng = np.random.default_rng(seed)
            task = random_products(information, check, model, time, rng)
        problem = DesignProblem.of(
            information,
            family,
            time,
            limits,
            prior=prior_information(size, knowledge.information),
            wanted=wanted_indices(network, goal.wanted),
            task=task,
            criterion=goal.criterion,
            start=start,
        )
        return cls(
            problem, check, bodies, family, limits, noise, knowledge, time, start, collisions
        )

    def design(
        self, effort: Effort = Effort(), progress: Callable[[str], None] | None = None
    ) -> Design:
        """Search from several random motions, and refine the best; see `design_motion`."""
        say = progress or (lambda _: None)
        rng = np.random.default_rng(effort.seed)
        pose = self.rest_pose(rng)
        spread = None if self.start is None else 0.0
        initial = [random_parameters(self.check, pose, rng, spread) for _ in range(effort.starts)]
        interrupted = False
        bodies = self.bodies
        every = max(1, round(_LOOK / float(self.time[1])))
        search = Search(self.problem, bodies and functools.partial(bodies.contacts, every=every))
        best, least = self.problem.variables(initial[0]), np.inf
        try:
            for number, parameters in enumerate(initial, 1):
                search.progress = lambda text, i=number: say(f"start {i}, {text}")
                value = search.run(self.problem.variables(parameters), 2, max(effort.steps // 3, 5))
                if value < least:
                    best, least = np.array(search.best), value
            search.progress = lambda text: say(f"refining, {text}")
            search.run(best, effort.rounds, effort.steps)
            self._repair(search, effort.steps)
        except KeyboardInterrupt:
            interrupted = True
            say("interrupted: the best motion so far is checked")
        # A search that was interrupted may not have reached what an earlier one had.
        reached = [best, search.best] if interrupted or search.best is None else [search.best]
        found = [self._of_variables(x) for x in reached if x is not None]
        scaled = [self.check.scaled(parameters, pose) for parameters in found]
        parameters, use, scale = min(scaled, key=lambda motion: self.criterion_value(motion[0]))
        notes = [*self.limits.notes]
        if not self.knowledge.is_model:
            notes.append(
                "the robot's file has no masses: torques are not limited, and noise of positions"
                " does not count; expected an earlier identification"
            )
        if interrupted:
            notes.append("interrupted: the best motion until then")
        return self.described(parameters, use, scale, tuple(notes))

    def _repair(self, search: Search, steps: int) -> None:
        """Search once more from where a search ended, with limits a little narrower.

        The dense check finds which limits the motion exceeds between the search's samples. Where
        bodies are too near between looks at distances, it looks at every sample, and keeps them a
        little further away.
        """
        bodies, beside = self.bodies, BESIDE
        for _ in range(_REPAIRS):
            parameters = self._of_variables(search.best)
            use = self.check.use(parameters)
            apart = use.distance is None or use.distance >= 0.0
            if apart and max(float(x.max()) for x in use.joints.values()) <= _NEAR:
                return
            search.problem = search.problem.narrowed(use.joints)
            if bodies is not None and not apart:
                beside *= _FURTHER
                search.contacts = functools.partial(bodies.contacts, beside=beside)
            x = self.problem.variables(parameters)
            search.run(x, 2, max(steps // 3, 5), _REPAIR_PENALTY, warm=True)

    def _of_variables(self, x: Any) -> Parameters:
        return np.asarray(self.problem.parameters(jnp.asarray(x)))

    def rest_pose(self, rng: np.random.Generator) -> Float[np.ndarray, " joints"]:
        """Return a pose for the arm to rest in.

        It is the one to start from, else the middle of the ranges, or the first random one.

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

    def criterion_value(self, parameters: Parameters) -> float:
        """Compute the criterion of a motion on the grid."""
        problem = self.problem
        motion = self.family.motion(np.asarray(parameters), self.time)
        value = log_criterion(
            problem.criterion, self.moments(motion), problem.prior, problem.wanted, problem.task
        )
        return float(np.exp(value))

    def moments(self, motion: Any) -> Any:
        """Compute the information that a motion on the grid has about the coefficients."""
        information = self.problem.information
        q, qd, qdd = (np.asarray(x) for x in motion)
        regressor = motion_regressor(information.network, q, qd, qdd)
        return _moments(information, (q, qd, qdd), information.spectra(q), regressor)

    def prediction(self, motion: Any) -> Prediction:
        """Predict standard errors after a motion on the grid, with what was known before."""
        return predicted(self.problem.information, self.knowledge, self.moments(motion))

    def described(
        self, parameters: Parameters, use: Use, scale: float, notes: tuple[str, ...]
    ) -> Design:
        """Make the `Design` of a motion."""
        network = self.problem.information.network
        return Design(
            network,
            self.family,
            np.asarray(parameters),
            self.limits,
            use,
            self.noise,
            self.prediction(self.family.motion(np.asarray(parameters), self.time)),
            self.problem.criterion,
            self.criterion_value(parameters),
            tuple(network.names[i] for i in np.asarray(self.problem.wanted)),
            scale,
            notes,
            self.collisions,
        )


def predicted(information: MotionInformation, knowledge: Knowledge, moments: Any) -> Prediction:
    """Predict standard errors after a motion with the given moments."""
    size, network = information.size, information.network
    prior = prior_information(size, knowledge.information, UNDETERMINED)
    covariance = np.asarray(error_covariance(moments, jnp.asarray(prior))) * np.outer(size, size)
    plain = np.asarray(moments.plain)
    length = np.sqrt(np.maximum(np.diag(plain), 0.0))
    length = np.where(length > 0.0, length, 1.0)
    return Prediction(
        network.names,
        tuple(coefficient.unit for coefficient in network.coefficients),
        knowledge.k,
        size,
        covariance,
        knowledge.standard_error,
        condition_number(plain),
        condition_number(plain / np.outer(length, length)),
    )


@eqx.filter_jit
def _moments(information: MotionInformation, motion: Any, spectra: Any, regressor: Any) -> Any:
    return information.moments(motion, spectra, regressor)
