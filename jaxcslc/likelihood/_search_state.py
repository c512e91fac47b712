"""State that changes from step to step of a search: signs, weights, levels of noise, intervals.

Noise levels are those of marginal likelihood, from draws of the present noise.
"""

import dataclasses
import enum

import numpy as np
from jaxtyping import Bool, Float

from ..network import CoupledTerm
from ._blocks import TURN, MotionBlock, PriorBlock, ReadingBlock, RestBlock, ReversalBlock
from ._equations import AbstractEquations
from ._laws import Intervals, Sticking, sticking_equations
from ._levenberg import DAMPING, SMALL_DAMPING, LevenbergStep, LinearMinimum
from ._objective import Linear, Objective, Residuals
from ._point import Point
from ._problem import LikelihoodProblem
from ._signs import Signs, dilated


Levels = Float[np.ndarray, "recordings joints"]
# Equations left uncertain on either side of a reversal, step by step; after these steps, reversals
# are moments to be estimated.
MARGINS = (4, 3, 2)
# From this step on, a reversal that comes or goes is left uncertain.
SIGN_STEPS = 7

Mask = Bool[np.ndarray, "equations joints"]


class Stage(enum.Enum):
    """Stage of a search: what follows the motion from step to step, next to signs.

    - `LEVELS`: noise levels and weights of outliers, while readings are normally distributed.
    - `COUNTS`: nothing, until steps are short: then counts become intervals where that says more.
    - `INTERVALS`: edges of intervals, and the torque noise that these leave.
    - `OUTLIERS`: weights of outliers, once, of a search that starts near its end.
    - `FINAL`: nothing.
    """

    LEVELS = enum.auto()
    COUNTS = enum.auto()
    INTERVALS = enum.auto()
    OUTLIERS = enum.auto()
    FINAL = enum.auto()


@dataclasses.dataclass(frozen=True)
class SearchState:
    """State of a search, which changes from step to step.

    - `outlier_weight`: (equations, n) of equations far beyond the noise.
    - `ambiguous`: (equations, n) of reversals that came and went.
    - `undecided`: (equations, n) of joints with a common shaft that may turn either way.
    - `stage`: what else changes.
    - `moments`: (samples, n) of reversals to start from, NaN where they are not known; None if none
      is.
    - `refinements`: of the level of torque noise beside intervals.
    - `of_friction`: the point whose friction says how uncertain friction is where its sign is, and
      how large static friction may be; None: the present one.
    - `truncation`: what equations leave out [N m or N]; None: what they do at the present point.
    """

    point: Point
    signs: Signs | None
    torque_noise: Levels
    position_noise: Levels
    outlier_weight: Float[np.ndarray, "equations joints"]
    ambiguous: Mask
    undecided: Mask
    intervals: Intervals | None
    damping: float
    stage: Stage
    refinements: int = 0
    moments: Float[np.ndarray, "samples _"] | None = None
    of_friction: Point | None = None
    truncation: Float[np.ndarray, "equations joints"] | float | None = None

    @classmethod
    def start(
        cls,
        problem: LikelihoodProblem,
        point: Point,
        torque_noise: Levels,
        position_noise: Levels,
        fixed: bool,
        edge: Levels | None,
        moments: Float[np.ndarray, "samples _"] | None,
    ) -> "SearchState":
        samples, n = problem.readings.position.shape
        intervals = None if edge is None else intervals_of(problem, edge)
        stage = Stage.LEVELS
        if fixed:
            stage = Stage.FINAL if edge is None else Stage.OUTLIERS
        return cls(
            point,
            None,
            np.maximum(torque_noise, problem.least_torque_noise),
            position_noise,
            np.ones((samples - 2, n)),
            np.zeros((samples - 2, n), bool),
            np.zeros((samples - 2, n), bool),
            intervals,
            DAMPING,
            stage,
            moments=moments,
        )

    def same_motion(self, other: "SearchState") -> bool:
        """Return whether signs, and what is uncertain of them, are the other's.

        Sums of squares are comparable only then.
        """
        return self.signs is other.signs and np.array_equal(self.undecided, other.undecided)


def with_signs(
    problem: LikelihoodProblem, state: SearchState, number: int
) -> tuple[SearchState, bool]:
    """Return the signs of the present motion, unless they are those of before, which is said.

    A reversal between two samples belongs to the one that it was with. Of a reversal that comes and
    goes, as next to a rest, and of one whose moment would leave its samples, as where a joint
    breaks away, equations stay uncertain.
    """
    readings, before, point = problem.readings, state.signs, state.point
    modelled = number >= len(MARGINS)
    ambiguous = state.ambiguous
    while True:
        signs = Signs.of(
            point.q,
            readings.time,
            problem.stuck,
            margin=MARGINS[min(number, len(MARGINS) - 1)],
            modelled=modelled,
            joined=readings.joined,
            ambiguous=ambiguous,
        )
        if before is None and state.moments is not None:
            unknown = signs.without_moments(state.moments) & ~ambiguous
            if not unknown.any():
                break
            ambiguous = ambiguous | unknown
            continue
        if before is None or number <= len(MARGINS):
            break
        unmatched = signs.unmatched(before)
        if number >= SIGN_STEPS:
            unmatched |= before.at_bounds(point.turn)
        if not unmatched.any():
            return state, True
        if number < SIGN_STEPS or np.all(ambiguous[unmatched]):
            break
        ambiguous = ambiguous | unmatched
    if before is not None:
        turn = signs.carried(before, point.turn)
    elif state.moments is not None:
        turn = signs.from_moments(state.moments)
    else:
        turn = signs.turn
    point = dataclasses.replace(point, turn=turn)
    return dataclasses.replace(state, signs=signs, point=point, ambiguous=ambiguous), False


def with_common_shafts(
    problem: LikelihoodProblem, state: SearchState, number: int
) -> tuple[SearchState, bool]:
    """Leave out equations in which a common shaft of two joints turns.

    Also returns whether these equations are those of before.

    Dry friction of a shaft that two joints turn together has the sign of a sum of their velocities,
    which no sign of a single joint holds while a step is judged. Where the shaft turns, the sum of
    squares jumps with noise of positions. Linear equations do not know of that, and damping grows
    without an end (a Stäubli TX40, which begins at rest: 12 were promised, and a thirtieth of that
    step lost 10).

    As of other reversals, more is left out in the first steps; later no equation comes back.
    """
    terms = problem.equations.network.terms
    pairs = [
        pair
        for term in terms
        if isinstance(term, CoupledTerm) and term.kind == "coupled_dry"
        for pair in term.pairs
    ]
    if not pairs:
        return state, True
    mask = np.zeros_like(state.undecided)
    margin = MARGINS[number] if number < len(MARGINS) else 0
    for pair in pairs:
        joints = [pair.first - 1, pair.second - 1]
        sign = np.sign(np.diff(state.point.q[:, joints] @ [1.0, float(pair.ratio)]))
        mask[:, joints] |= dilated((sign[1:] * sign[:-1] <= 0.0)[:, None], margin)
    if number >= SIGN_STEPS:
        mask |= state.undecided
    same = np.array_equal(mask, state.undecided)
    return dataclasses.replace(state, undecided=mask), same


def intervals_of(problem: LikelihoodProblem, edge: Levels) -> Intervals | None:
    """Return readings with edges of the given widths; None if all are 0."""
    if not edge.any():
        return None
    part = problem.readings.part
    return Intervals(problem.reading_shares, problem.encoder_step[part], edge[part])


# Standard deviation of friction that is anything up to break-away, and of a reversal's whose moment
# is estimated, as parts of the break-away torque. Simulated: 0.003 to 0.006 for the latter.
_UNCERTAIN, _REVERSAL = 0.6, 0.01
# Huber's constant, in standard deviations: what is beyond counts by its size, not by its square.
_OUTLIER = 4.0
# A joint at rest moves by this part of its position noise from sample to sample.
_REST = 0.02


def objective_of(
    problem: LikelihoodProblem, state: SearchState, number: int
) -> tuple[Objective, Mask]:
    """Return the sum of squares, and which equations have their full weight; `number`: of the
    step."""
    readings, signs, point = problem.readings, state.signs, state.point
    assert signs is not None
    of_equation, of_interval = readings.part[1:-1], readings.part[:-1]
    equations = problem.equations.about(point.q, readings.time, readings.part)
    scale = state.of_friction or point
    breakaway = problem.breakaway(scale)
    of_friction = _friction_variance(problem, equations, signs, point, breakaway)
    weight = state.outlier_weight / (state.torque_noise[of_equation] ** 2 + of_friction)
    without = problem.at_rest | state.undecided | readings.joined[:, None]
    weight[without] = 0.0
    motion = MotionBlock(equations, readings.torque, signs, weight)
    left_out = state.truncation
    if left_out is None and readings.torque.sampling == "sampled":
        left_out = equations.truncation(motion.at(point), readings.time, readings.part)
    if left_out is not None:
        motion = dataclasses.replace(motion, truncation=left_out)
    expected, known = problem.known(point, scale)
    at_rest = 1.0 / (_REST * state.position_noise[of_interval]) ** 2
    position_weight = problem.reading_shares / state.position_noise[readings.part] ** 2
    blocks = {
        "torque": motion,
        "position": ReadingBlock(
            readings.position, readings.part, position_weight, state.intervals
        ),
        "standstill": RestBlock(np.where(problem.stuck, at_rest, 0.0)),
        "turn": ReversalBlock(signs.turn, np.full(len(signs.samples), TURN**-2)),
        "border": PriorBlock(expected, known),
        **problem.added,
    }
    objective = Objective(blocks, problem.scale)
    if number >= len(MARGINS):
        objective = _with_sticking(problem, state, objective)
    return objective, (of_friction == 0.0) & ~without


def _with_sticking(
    problem: LikelihoodProblem, state: SearchState, objective: Objective
) -> Objective:
    """Add equations of joints that stick, which bound friction at break-away.

    Not of joints whose friction has a state, which bears what it does where they rest. Nor where
    all coefficients are fixed, of which alone bounds say something: wrong ones would draw positions
    to where friction bears what they make of the torque.
    """
    point, breakaway = state.point, problem.breakaway(state.point)
    fixed = not problem.scale[: len(point.k)].any()
    if fixed or not problem.at_rest.any():
        return objective
    motion = objective.motion
    signs = motion.signs
    friction = motion.residuals(point) + signs.direction * breakaway
    mask = sticking_equations(problem.at_rest, friction, breakaway) & (
        problem.equations.presliding_distance == 0.0
    )
    mask &= ~problem.readings.joined[:, None]
    if not mask.any():
        return objective
    direction = np.where(mask, np.where(friction < 0.0, -1.0, 1.0), signs.direction)
    noise = state.torque_noise[problem.readings.part[1:-1]]
    return objective.with_blocks(
        torque=dataclasses.replace(
            motion,
            signs=dataclasses.replace(signs, direction=direction),
            sticking=Sticking(mask, direction, noise),
        )
    )


def _friction_variance(
    problem: LikelihoodProblem,
    equations: AbstractEquations,
    signs: Signs,
    point: Point,
    breakaway: Float[np.ndarray, " joints"],
) -> Float[np.ndarray, "equations joints"]:
    """Return variance of friction that signs do not tell, and of states at the start of a
    recording."""
    sizes, unknown = equations.states(point.k)
    of_states = (_UNCERTAIN * sizes * unknown) ** 2
    breakaway = np.maximum(breakaway - sizes, 0.0)
    extra = np.where(signs.uncertain, (_UNCERTAIN * breakaway) ** 2, 0.0)
    for offset in (-1, 0, 1):
        extra[signs.samples - 1 + offset, signs.joints] = (_REVERSAL * breakaway[signs.joints]) ** 2
    return extra + of_states


def outlier_weights(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask
) -> Float[np.ndarray, "equations joints"]:
    """Return Huber's weights of a step's residuals.

    Uncertain friction is within break-away; what pushes a joint at its limit is not.
    """
    linear = step.minimum.linear
    motion, noise = linear.objective.motion, state.torque_noise[problem.readings.part[1:-1]]
    signs = motion.signs
    breakaway = problem.breakaway(step.point)
    of_friction = _friction_variance(problem, motion.equations, signs, step.point, breakaway)
    extra = np.where(signs.uncertain, of_friction, 0.0)
    deviation = np.sqrt(noise**2 + extra)
    weight, residual = linear.weights["torque"], step.residuals["torque"]
    robust = (counted | (extra > 0.0)) & (weight > 0.0)
    size = np.maximum(np.abs(residual), 1e-300)
    return np.where(robust, np.minimum(1.0, _OUTLIER * deviation / size), 1.0)


# A noise level falls to no less than this part in a step (continuation: while torque counts for
# little, the sum of squares has no other minima near).
_FALL = 0.25
# Noise levels go all the way to where residuals would have them in so many steps, then half of it;
# they are fixed when they change by less than this part in a step, or after so many steps.
_FREE_LEVEL_STEPS, _LEVEL_TOLERANCE, _MOST_LEVEL_STEPS = 6, 0.05, 14
# Counts become intervals when a step moves no coefficient by more than this part of its standard
# error. Where all of them will, the level of torque noise need not be settled: it follows later.
NEAR = 0.3
# Beside intervals, edges and the level of torque noise follow so many steps. The level goes all the
# way, and in later ones half of it.
_REFINEMENTS, _FREE_REFINEMENTS = 5, 3
# Readings of an encoder whose noise is less than so many times that of its steps have that.
_MORE_THAN_STEPS = 1.3
# Counts are intervals where positions are known better than this part of a step. The width of an
# edge is so many times the error of positions, for then scores are linear in errors, and at least
# that of an encoder, in steps. Intervals reduce the error, and their width follows.
_SHARP, _EDGE, _LEAST_EDGE = 0.1, 2.0, 0.01
# With less damping than this part of the readings' weights, draws of noise are fitted all the same.
LITTLE_DAMPING = 1e-2


@dataclasses.dataclass(frozen=True)
class NoiseDraws:
    """Residuals that a fit of all unknowns leaves of noise of the present levels, one draw of each.

    Errors of readings that are intervals are uniform, and count by their scores.

    **Attributes**

    - `problem`, `state`: with the present levels; `linear`: equations about the present point.
    - `by_torque`, `by_position`: residuals of torque's noise alone, and of positions' alone.
    - `position`: (samples, n) the noise of positions that was drawn.
    """

    problem: LikelihoodProblem
    state: SearchState
    linear: Linear
    by_torque: Residuals
    by_position: Residuals
    position: Float[np.ndarray, "samples joints"]

    @classmethod
    def of(
        cls, problem: LikelihoodProblem, state: SearchState, minimum: LinearMinimum
    ) -> "NoiseDraws":
        """Draw noise and fit it."""
        linear, part = minimum.linear, problem.readings.part
        # Damped positions do not follow noise that is drawn: they would seem to be known better
        # than readings say (a Stäubli TX40 with damping of 1e4: to 0.005 of a step, not 0.28).
        little = minimum.damping <= LITTLE_DAMPING
        factored = minimum.factored if little else linear.factored(SMALL_DAMPING)
        rng = np.random.default_rng(0)
        counts = linear.weights["torque"] > 0.0
        normal = np.where(counts, rng.normal(size=counts.shape), 0.0)
        torque = normal * state.torque_noise[part[1:-1]]
        weight = linear.weights["position"]
        position = rng.normal(size=weight.shape) * state.position_noise[part]
        intervals = linear.objective.readings.intervals
        if intervals is not None:
            counts = intervals.edge > 0.0
            errors = rng.uniform(-0.5, 0.5, weight.shape) * intervals.step
            readings = intervals.working(np.where(counts, errors, 0.0), weight)
            position = np.where(counts, readings.weight * readings.residual / weight, position)
        drawn = [linear.zeros(torque=torque), linear.zeros(position=position)]
        steps = linear.steps(factored, drawn)
        by_torque, by_position = map(linear.after, steps, drawn)
        return cls(problem, state, linear, by_torque, by_position, position)

    def levels(self, residuals: Residuals, counted: Mask) -> tuple[Levels, Levels]:
        """Return the levels at which residuals would be as large as they are, of torque and of
        positions; none below its least.

        The squares of what is left of both kinds of noise add up, so that the level of torque noise
        follows from what positions do not explain (a fixed point of the marginal likelihood, whose
        trace is estimated from one draw; Harville 1977).

        - `residuals`: at the minimum; `counted`: equations that count fully.
        """
        problem, part = self.problem, self.problem.readings.part
        torque_noise, position_noise = self.state.torque_noise, self.state.position_noise
        new_torque, new_position = torque_noise.copy(), position_noise.copy()
        for index in np.ndindex(*torque_noise.shape):
            number, joint = index
            rows = counted[:, joint] & (part[1:-1] == number)
            if rows.any():
                square, alone, others = (
                    np.median(np.abs(x["torque"][rows, joint])) ** 2
                    for x in (residuals, self.by_torque, self.by_position)
                )
                ratio = (square - others) / alone if alone > 0.0 else 0.0
                new_torque[index] = torque_noise[index] * np.sqrt(np.clip(ratio, _FALL**2, 9.0))
            rows = problem.moving[:, joint] & (part == number)
            if rows.any():
                square, alone, others = (
                    np.mean(x["position"][rows, joint] ** 2)
                    for x in (residuals, self.by_position, self.by_torque)
                )
                ratio = (square - others) / alone if alone > 0.0 else 1.0
                new_position[index] = position_noise[index] * np.sqrt(np.clip(ratio, 0.1, 9.0))
        return (
            np.maximum(new_torque, problem.least_torque_noise),
            np.maximum(new_position, problem.least_position_noise),
        )

    def hidden(self, torque_noise: Levels) -> Levels:
        """Return the least noise of positions beside torque noise that would hide it.

        Where noise of positions makes less of an equation's error than torque noise does, residuals
        say little of its level, and a small one is as likely as none; with none, noise of
        accelerations makes inertias too small. So there the level is at least what readings
        themselves scatter by. If it is motion that they see, torque noise has made it: little is
        lost, for that is at the highest frequencies, which say nothing of coefficients.
        """
        seen, part = self.problem.scatter, self.problem.readings.part
        n = seen.shape[1]
        by_position = self.linear.motion.by_position
        near = by_position.reshape(len(by_position), n, -1, n)
        size = np.sqrt(np.sum(near**2, axis=2))  # of the equation of one joint, by another's noise
        result = np.zeros_like(seen)
        for number in range(len(seen)):
            of_noise = np.median(size[part[1:-1] == number], axis=0)
            of_noise /= torque_noise[number][:, None]
            least = 1.0 / np.maximum(np.max(of_noise, axis=0), 1e-300)
            result[number] = np.minimum(seen[number], least)
        return result

    def position_errors(self) -> Levels:
        """Return errors of estimated positions with their offsets, in steps of encoders; infinite
        where no joint moves, or there are no steps."""
        part, step = self.problem.readings.part, self.problem.encoder_step
        of_torque, of_position = self.by_torque["position"], self.by_position["position"]
        squares = (self.position - of_position) ** 2 + of_torque**2
        result = np.full(step.shape, np.inf)
        for index in np.ndindex(*result.shape):
            number, joint = index
            rows = self.problem.moving[:, joint] & (part == number)
            if rows.any():
                result[index] = np.sqrt(np.mean(squares[rows, joint]))
        return result / np.where(step > 0.0, step, 1e-300)


def with_levels(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask, number: int
) -> SearchState:
    """Let noise levels and weights of outliers follow the residuals of a step."""
    draws = NoiseDraws.of(problem, state, step.minimum)
    torque_noise, position_noise = draws.levels(step.residuals, counted)
    position_noise = np.maximum(position_noise, draws.hidden(torque_noise))
    if number > _FREE_LEVEL_STEPS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
        position_noise = np.sqrt(position_noise * state.position_noise)
    change = max(
        np.abs(np.log(new / old)).max()
        for new, old in (
            (torque_noise, state.torque_noise),
            (position_noise, state.position_noise),
        )
    )
    modelled = number > len(MARGINS)
    settled = modelled and bool(change <= _LEVEL_TOLERANCE)
    final = settled or number >= _MOST_LEVEL_STEPS
    if modelled and step.change <= NEAR:
        final |= _all_sharp(problem, draws, position_noise)
    if final:
        least = problem.least_position_noise
        counted_steps = (problem.encoder_step > 0.0) & (position_noise <= _MORE_THAN_STEPS * least)
        position_noise = np.where(counted_steps, least, position_noise)
    levelled = dataclasses.replace(state, torque_noise=torque_noise, position_noise=position_noise)
    return dataclasses.replace(
        levelled,
        outlier_weight=outlier_weights(problem, levelled, step, counted),
        stage=Stage.COUNTS if final else Stage.LEVELS,
    )


def _all_sharp(problem: LikelihoodProblem, draws: NoiseDraws, position_noise: Levels) -> bool:
    """Return whether positions of all joints that move are known much better than steps."""
    errors = draws.position_errors()
    steps = position_noise <= _MORE_THAN_STEPS * problem.least_position_noise
    return bool(np.all(np.isinf(errors) | (steps & (errors <= _SHARP))))


def with_intervals(
    problem: LikelihoodProblem, state: SearchState, minimum: LinearMinimum
) -> SearchState:
    """Make counts intervals, where positions are known much better than a step."""
    errors = NoiseDraws.of(problem, state, minimum).position_errors()
    counts = state.position_noise <= problem.least_position_noise
    edge = np.where(counts & (errors <= _SHARP), np.maximum(_EDGE * errors, _LEAST_EDGE), 0.0)
    intervals = intervals_of(problem, edge)
    # What linear equations say of intervals holds near only.
    damping = state.damping if intervals is None else max(state.damping, DAMPING)
    stage = Stage.FINAL if intervals is None else Stage.INTERVALS
    return dataclasses.replace(state, intervals=intervals, stage=stage, damping=damping)


def with_refined_intervals(
    problem: LikelihoodProblem, state: SearchState, step: LevenbergStep, counted: Mask
) -> SearchState:
    """Let torque noise and edges follow what intervals leave.

    Single counts hide torque noise far below what they leave of torque. Intervals show it, and with
    a level that is too large, standard errors would be.
    """
    part, intervals = problem.readings.part, state.intervals
    assert intervals is not None
    draws = NoiseDraws.of(problem, state, step.minimum)
    errors = draws.position_errors()
    torque_noise, _ = draws.levels(step.residuals, counted)
    if state.refinements >= _FREE_REFINEMENTS:
        torque_noise = np.sqrt(torque_noise * state.torque_noise)
    edge = np.clip(_EDGE * errors, _LEAST_EDGE, _EDGE * _SHARP)[part]
    refinements = state.refinements + 1
    return dataclasses.replace(
        state,
        intervals=dataclasses.replace(intervals, edge=np.where(intervals.edge > 0.0, edge, 0.0)),
        torque_noise=torque_noise,
        refinements=refinements,
        stage=Stage.FINAL if refinements == _REFINEMENTS else Stage.INTERVALS,
    )
