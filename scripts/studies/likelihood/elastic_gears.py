"""Maximum likelihood of elastic gears: rotor and link of a joint as two bodies.

A spring, a damper and play are between them. Readings are of rotors, and positions of links are
unknown at every sample. `fit_with_gears` is the estimator: blocks that are added to the problem of
rigid gears. On simulated arms it finds stiffness and play (`two_mass`). Of a KUKA KR300 and a
Franka Panda its searches did not converge.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

import jaxcslc as jc
from jaxcslc.least_squares import regressor_of
from jaxcslc.likelihood import (
    AbstractEquations,
    ConstantBlock,
    EquationPoint,
    JointColumns,
    LikelihoodProblem,
    Linearisation,
    Minimum,
    Normal,
    Point,
    SearchStart,
    Step,
    border_errors,
    likelihood_fit,
    search,
)
from jaxcslc.network import CSLC
from jaxcslc.recordings import Patterns


class TransmissionParameters(NamedTuple):
    """Parameters of the gears of f joints.

    **Attributes**

    - `compliance`: (f,) one over stiffness [rad/(N m) or m/N].
    - `lag`: (f,) damping over stiffness [s].
    - `play`: (f,) how far a link moves while its rotor stands still [rad or m].
    - `rotor_inertia`: (f,) at the joint [kg m² or kg].
    """

    compliance: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]
    play: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]

    @classmethod
    def of(cls, values: Float[np.ndarray, " parameters"]) -> "TransmissionParameters":
        """Split (4 f,) values one after the other."""
        return cls(*values.reshape(4, -1))

    @property
    def values(self) -> Float[np.ndarray, " parameters"]:
        """(4 f,) one after the other."""
        return np.concatenate(self)


# Quantile of a normal distribution for intervals of 95 %.
_QUANTILE = 1.959964

Links = Float[np.ndarray, " links"]


@dataclasses.dataclass(frozen=True)
class Transmission:
    """Gears that give way between rotors and links, as they were estimated.

    A link is behind its rotor by u. Beyond the play, a spring bears its share of the torque, and a
    damper the remainder: torque = stiffness (u beyond play) + damping u'.

    **Attributes**

    - `joints`: whose links move apart from their rotors, from 1.
    - `compliance`: (f,) one over stiffness [rad/(N m) or m/N]; `compliance_error`: its standard
      deviation.
    - `lag`: (f,) damping over stiffness [s]; `lag_error`.
    - `play`: (f,) how far a link moves while its rotor stands still [rad or m]; `play_error`. An
      estimate of none may be below 0.
    - `rotor_inertia`: (f,) at the joint [kg m² or kg], a part of the network's coefficients;
      `rotor_inertia_error`.
    - `link_position`: (samples, f) of the links [rad or m].

    >>> import numpy as np
    >>> from scripts.studies.likelihood.elastic_gears import Transmission
    >>> one, error = np.ones(1), np.full(1, 1e-6)
    >>> gears = Transmission(
    ...     joints=(2,), compliance=4e-4 * one, compliance_error=error, lag=3e-3 * one,
    ...     lag_error=1e2 * error, play=1e-3 * one, play_error=error, rotor_inertia=0.5 * one,
    ...     rotor_inertia_error=1e3 * error, link_position=np.zeros((10, 1)),
    ... )
    >>> gears.stiffness_interval.round().tolist(), gears.damping.round(2).tolist()
    ([[2488.0, 2512.0]], [7.5])
    """

    joints: tuple[int, ...]
    compliance: Links
    compliance_error: Links
    lag: Links
    lag_error: Links
    play: Links
    play_error: Links
    rotor_inertia: Links
    rotor_inertia_error: Links
    link_position: Float[np.ndarray, "samples links"]

    @property
    def stiffness(self) -> Links:
        """(f,) [N m/rad or N/m]."""
        return 1.0 / self.compliance

    @property
    def stiffness_interval(self) -> Float[np.ndarray, "links 2"]:
        """(f, 2) of 95 %; infinite above where gears may be rigid."""
        reach = _QUANTILE * self.compliance_error
        low, high = np.maximum(self.compliance - reach, 1e-300), self.compliance + reach
        return np.stack([1.0 / high, np.where(low > 1e-300, 1.0 / low, np.inf)], axis=1)

    @property
    def play_interval(self) -> Float[np.ndarray, "links 2"]:
        """(f, 2) of 95 % [rad or m]."""
        reach = _QUANTILE * self.play_error
        return np.stack([self.play - reach, self.play + reach], axis=1)

    @property
    def damping(self) -> Links:
        """(f,) [N m s/rad or N s/m]."""
        return self.lag * self.stiffness


# Least width of a dead band's edges as a part of the play.
_EDGE = 0.005
# Gauss-Legendre nodes and weights on (0, 1), of each of two intervals.
_NODES, _WEIGHTS = (np.polynomial.legendre.leggauss(4)[i] / 2 + (0.5, 0.0)[i] for i in (0, 1))

LinkSeries = Float[np.ndarray, "samples links"]
LinkRows = Float[np.ndarray, "equations links"]
Weights = Float[np.ndarray, "3 equations"]


class Windup(NamedTuple):
    """Windup of gears, less their play, averaged with a triangle; and its derivatives.

    **Attributes**

    - `value`: (equations, f) [rad or m].
    - `by_difference`: (3, equations, f) by rotor minus link at three samples.
    - `by_play`: (equations, f) by the play.
    """

    value: LinkRows
    by_difference: Float[np.ndarray, "3 equations links"]
    by_play: LinkRows


@dataclasses.dataclass(frozen=True)
class Stencil:
    """Weights of three samples in an equation, from a parabola through them.

    **Attributes**

    - `mean`: in the triangle's mean over the two intervals that meet at the middle sample; `rate`:
      in that of the rate; `acceleration`: (3, equations) each.
    - `nodes`: (3, nodes, equations) at instants in these intervals, whose triangle's mean is that
      with `weights`, (nodes, equations).
    """

    mean: Weights
    rate: Weights
    acceleration: Weights
    nodes: Float[np.ndarray, "3 nodes equations"]
    weights: Float[np.ndarray, "nodes equations"]

    @classmethod
    def of(cls, time: Float[np.ndarray, " samples"]) -> "Stencil":
        """Compute it at samples of these times [s]."""
        h = np.diff(time)
        before, after = h[:-1], h[1:]
        total = before + after
        acceleration = np.stack(
            [2.0 / (before * total), -2.0 / (before * after), 2.0 / (after * total)]
        )
        rate = np.stack(
            [
                -after / (before * total),
                after / (before * total) - before / (after * total),
                before / (after * total),
            ]
        )
        one = np.array([[0.0], [1.0], [0.0]])
        instants = np.concatenate(
            [-_NODES[:, None] * before, _NODES[:, None] * after]
        )  # from the middle sample
        shares = np.concatenate([np.tile(before / total, (4, 1)), np.tile(after / total, (4, 1))])
        weights = shares * 2.0 * np.tile(_WEIGHTS * (1.0 - _NODES), 2)[:, None]
        nodes = (
            one[:, None]
            + rate[:, None] * instants[None]
            + 0.5 * acceleration[:, None] * instants[None] ** 2
        )
        return cls(
            np.sum(nodes * weights, axis=1),
            rate + (after - before) / 3.0 * acceleration,
            acceleration,
            nodes,
            weights,
        )

    @staticmethod
    def applied(weights: Weights, values: LinkSeries) -> LinkRows:
        """Return the weighted sum of three samples, for each equation."""
        before, now, after = weights[:, :, None]
        return before * values[:-2] + now * values[1:-1] + after * values[2:]

    def windup(
        self,
        difference: LinkSeries,
        play: Float[np.ndarray, " links"],
        width: Float[np.ndarray, " links"],
    ) -> Windup:
        """Return rotor minus link beyond the dead band of gears with play.

        A dead band of smooth edges: its derivatives are right for a play of zero too, where that by
        the play is minus half of the difference's sign. Beyond the band gears are linear, and the
        mean is a parabola's; in it, gears meet and part amid intervals, and the mean is that of a
        few instants.

        **Arguments**

        - `difference`: rotor minus link [rad or m].
        - `play`: (f,) how far a link moves while its rotor stands still [rad or m].
        - `width`: (f,) over which the edges are smooth at least [rad or m]; more than 0.

        >>> import numpy as np
        >>> time, u = np.arange(4.0), np.array([[-0.3], [-0.3], [-0.3], [0.3]])
        >>> stencil = Stencil.of(time)
        >>> stencil.windup(u, np.array([0.2]), np.array([1e-6])).value.round(3)[:, 0].tolist()
        [-0.2, -0.167]
        """
        edge = np.hypot(width, _EDGE * play)
        weights = self.weights[:, :, None]
        inside = sum(
            basis[:, :, None] * difference[index : len(difference) - 2 + index]
            for index, basis in enumerate(self.nodes)
        )  # (nodes, equations, f)
        above, below = inside + 0.5 * play, inside - 0.5 * play
        far, near = np.hypot(above, edge), np.hypot(below, edge)
        clipped = weights * 0.5 * (far - near)
        slope = weights * 0.5 * (above / far - below / near)
        by_edge = 0.5 * edge * (1.0 / far - 1.0 / near) * _EDGE**2 * play / edge
        by_play = weights * (0.25 * (above / far + below / near) + by_edge)
        taken = np.stack([np.sum(basis[:, :, None] * slope, axis=0) for basis in self.nodes])
        return Windup(
            self.applied(self.mean, difference) - np.sum(clipped, axis=0),
            self.mean[:, :, None] - taken,
            -np.sum(by_play, axis=0),
        )


Series = Float[np.ndarray, "samples series"]
Rows = Float[np.ndarray, "equations series"]
Turns = Float[np.ndarray, "equations joints"]
# Noise of torque that links have and motors have not, as a part of the motors': equations of gears
# are not quite exact, which also keeps a search from following a wrong spring.
_LINK_NOISE = 0.1


@dataclasses.dataclass(frozen=True)
class ElasticEquations(AbstractEquations):
    """Equations of motion of rotors and links that move apart, as functions of positions alone.

    Positions are those of n rotors, then those of f links that move apart from them; all other
    links move with their rotors. With ID the torque of the links' motion without friction, rotors'
    inertia J included, F friction, which is the rotors', and u = rotor minus link,

        torque = ID(link) + J (rotor'' - link'') + F(rotor)              n equations
        0 = ID(link) - J link'' - (beyond play(u) + lag u') / compliance   f equations

    All terms are averaged over two intervals with a triangle (`MotionEquations`).

    **Attributes**

    - `rigid`: equations of rotors and links that move together; of n joints.
    - `joints`: (f,) which links move apart, from 0.
    - `time`: (samples,) [s].
    - `friction`: (p,) coefficients that are of friction.
    - `width`: (f,) least width of a dead band's edges [rad or m].
    """

    rigid: AbstractEquations
    joints: Int[np.ndarray, " links"]
    time: Float[np.ndarray, " samples"]
    friction: Bool[np.ndarray, " coefficients"]
    width: Float[np.ndarray, " links"]

    @property
    def network(self) -> CSLC:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Network of rigid links."""
        return self.rigid.network

    @property
    def intervals(self) -> Float[np.ndarray, " intervals"]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """(samples - 1,) between samples [s]."""
        return self.rigid.intervals

    def noise(
        self, torque_noise: Float[np.ndarray, "recordings joints"]
    ) -> Float[np.ndarray, "recordings series"]:
        """Add that of gears' equations, which is small beside that of motors [N m or N]."""
        return np.concatenate([torque_noise, _LINK_NOISE * torque_noise[:, self.joints]], axis=1)

    def torque(self, at: EquationPoint) -> Rows:
        """Return torque of motors, then what is left of gears' equations, (equations, n + f).

        `at` has (n + 4 f,) laws: logarithms of friction's slopes, then `TransmissionParameters`;
        (samples, n + f) positions, and signs of rotors.
        """
        of_links, of_friction = map(self.rigid.torque, self._rigid_points(at))
        return self._equations(at.laws, at.q, of_links, of_friction)

    def linearised(self, at: EquationPoint) -> Linearisation:
        """Return the same with derivatives by positions, by `k` and `laws`, and by turns."""
        k, laws, q = at[:3]
        n, f = self.rigid.network.joint_count, len(self.joints)
        rotor, parameters = q[:, :n], TransmissionParameters.of(laws[n:])
        of_links, of_friction = map(self.rigid.linearised, self._rigid_points(at))
        stencil = self._stencil
        beyond = stencil.windup(rotor[:, self.joints] - q[:, n:], parameters.play, self.width)
        count = len(q) - 2
        compliance, inertia = parameters.compliance, parameters.rotor_inertia
        joints, gears, series = self.joints, np.arange(f), n + np.arange(f)

        by_position = np.zeros((count, n + f, 3, n + f))
        moved = of_links.by_position.reshape(count, n, 3, n).swapaxes(1, 2)  # (count, 3, n, n)
        rubbed = of_friction.by_position.reshape(count, n, 3, n).swapaxes(1, 2)
        together = np.setdiff1d(np.arange(n), joints)
        for i in range(3):
            of_motor = by_position[:, :n, i]
            of_motor[:, :, :n] = rubbed[:, i]
            of_motor[:, :, together] += moved[:, i][:, :, together]
            of_motor[:, :, n:] = moved[:, i][:, :, joints]
            turned = inertia * stencil.acceleration[i][:, None]
            of_motor[:, joints, joints] += turned
            of_motor[:, joints, series] -= turned
            of_gear = by_position[:, n:, i]
            borne = moved[:, i][:, joints]  # (count, f, n)
            of_gear[:, :, together] = borne[:, :, together]
            of_gear[:, :, n:] = borne[:, :, joints]
            apart = beyond.by_difference[i] + parameters.lag * stencil.rate[i][:, None]
            apart = apart / compliance
            of_gear[:, gears, joints] -= apart
            of_gear[:, gears, series] += apart - turned

        p = len(k)
        by_law = np.zeros((count, n + f, p + len(laws)))
        frictions, links = of_friction.by_coefficient.dense, of_links.by_coefficient.dense
        by_law[:, :n, :p] = np.where(self.friction, frictions[:, :, :p], links[:, :, :p])
        by_law[:, n:, :p] = np.where(self.friction, 0.0, links[:, joints, :p])
        by_law[:, :n, p : p + n] = frictions[:, :, p:]
        of_link = self._acceleration(q[:, n:])
        rate_of_windup = self._rate(rotor[:, joints] - q[:, n:])
        gears_give = beyond.value + parameters.lag * rate_of_windup
        first = p + n + gears
        by_law[:, series, first] = gears_give / compliance**2
        by_law[:, series, first + f] = -rate_of_windup / compliance
        by_law[:, series, first + 2 * f] = -beyond.by_play / compliance
        by_law[:, joints, first + 3 * f] = self._acceleration(rotor[:, joints] - q[:, n:])
        by_law[:, series, first + 3 * f] = -of_link
        torques = np.asarray(of_links.torque), np.asarray(of_friction.torque)
        return Linearisation(
            self._equations(laws, q, *torques),
            by_position.reshape(count, n + f, -1),
            JointColumns.of(by_law),
            of_friction.by_turn,
        )

    def _equations(
        self,
        laws: Float[np.ndarray, " laws"],
        q: Series,
        of_links: Float[np.ndarray, "equations joints"],
        of_friction: Float[np.ndarray, "equations joints"],
    ) -> Rows:
        n = self.rigid.network.joint_count
        parameters = TransmissionParameters.of(laws[n:])
        difference = q[:, self.joints] - q[:, n:]
        beyond = self._stencil.windup(difference, parameters.play, self.width).value
        motor = of_links + of_friction
        motor[:, self.joints] += parameters.rotor_inertia * self._acceleration(difference)
        borne = of_links[:, self.joints] - parameters.rotor_inertia * self._acceleration(q[:, n:])
        gears = beyond + parameters.lag * self._rate(difference)
        return np.concatenate([motor, borne - gears / parameters.compliance], axis=1)

    def _rigid_points(self, at: EquationPoint) -> tuple[EquationPoint, EquationPoint]:
        """Return those of links without friction, and of rotors with friction alone."""
        n = self.rigid.network.joint_count
        rigid = at._replace(laws=at.laws[:n], q=self._link(at.q))
        return (
            rigid._replace(k=np.where(self.friction, 0.0, at.k)),
            rigid._replace(k=np.where(self.friction, at.k, 0.0), q=at.q[:, :n]),
        )

    def _link(self, q: Series) -> Float[np.ndarray, "samples joints"]:
        """Return positions of all links."""
        n = self.rigid.network.joint_count
        result = q[:, :n].copy()
        result[:, self.joints] = q[:, n:]
        return result

    @cached_property
    def _stencil(self) -> Stencil:
        return Stencil.of(self.time)

    def _rate(self, values: Series) -> Rows:
        return Stencil.applied(self._stencil.rate, values)

    def _acceleration(self, values: Series) -> Rows:
        return Stencil.applied(self._stencil.acceleration, values)


# Frequency at which motion and torque are halved before they are derived [Hz].
_CUTOFF = 15.0
# About so many samples are compared, none within this part of a recording from its ends.
_SAMPLES, _ENDS = 300, 0.06
# What is tried, joint by joint, so many times: natural frequencies of links on their gears [Hz] and
# inertia of the rotor over the joint's, as it would be were gears rigid.
_FREQUENCIES = (40.0, 28.0, 20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5)
_ROTORS = (0.1, 0.25, 0.5, 0.9, 1.5)
_ROUNDS = 2
# Damping at first, as a part of the critical one.
_DAMPING = 0.05


@dataclasses.dataclass(frozen=True)
class FirstGears:
    """Gears that explain smoothed motion, to start from.

    **Attributes**

    - `compliance`, `lag`, `rotor_inertia`: (f,) as of `TransmissionParameters`, without play.
    - `k`: (p,) coefficients.
    - `windup`: (samples, f) rotor minus link [rad or m], smoothed.
    """

    compliance: Float[np.ndarray, " links"]
    lag: Float[np.ndarray, " links"]
    rotor_inertia: Float[np.ndarray, " links"]
    k: Float[np.ndarray, " coefficients"]
    windup: Float[np.ndarray, "samples links"]


def first_gears(
    problem: LikelihoodProblem, k: Float[np.ndarray, " coefficients"], links: Sequence[int]
) -> FirstGears:
    """Return gears that leave least of smoothed torques.

    What gears bear is the torque less what the rotor needs and friction takes, and a link is
    behind its rotor by the compliance times that: both follow from what was recorded of this joint
    alone. With links where they are, coefficients are a regression. So each joint's compliance and
    rotor are tried in turn, and the residual has one minimum where a search over phases of
    vibrations has many.

    **Arguments**

    - `problem`: with rigid gears; `k`: coefficients of a regression for these.
    - `links`: which move apart from their rotors, from 0.
    """
    network = problem.equations.network
    data = _Smoothed.of(problem, network)
    rows = data.rows(problem)
    joints = np.array(links)
    mass = np.asarray(network.mass_matrix(k, data.position[0][rows]))[:, joints, joints]
    apparent = np.maximum(np.abs(np.median(mass, axis=0)), 1e-9)

    compliance, inertia = np.zeros(len(joints)), np.zeros(len(joints))
    weights = np.ones(data.torque[0].shape[1])
    friction = np.zeros(network.size)
    friction[network.layout.friction] = k[network.layout.friction]
    fitted, residual = data.fit(network, joints, compliance, inertia, friction, weights, rows)
    weights = 1.0 / np.maximum(residual, 1e-12)
    for _ in range(_ROUNDS):
        for number, joint in enumerate(joints):
            best, solution = np.inf, (compliance, inertia, fitted, residual)
            for frequency in _FREQUENCIES:
                for part in _ROTORS:
                    tried, rotors = compliance.copy(), inertia.copy()
                    tried[number] = 1.0 / (apparent[number] * (2.0 * np.pi * frequency) ** 2)
                    rotors[number] = part * apparent[number]
                    values, left = data.fit(network, joints, tried, rotors, friction, weights, rows)
                    if left[joint] < best:
                        best, solution = left[joint], (tried, rotors, values, left)
            compliance, inertia, fitted, residual = solution
            weights = 1.0 / np.maximum(residual, 1e-12)
            friction[network.layout.friction] = fitted[network.layout.friction]
    borne = data.borne(joints, inertia, friction, 0)
    # Critical damping is 2 / ω times the stiffness.
    frequency = 1.0 / np.sqrt(compliance * apparent)
    return FirstGears(compliance, 2.0 * _DAMPING / frequency, inertia, fitted, compliance * borne)


@dataclasses.dataclass(frozen=True)
class _Smoothed:
    """Smoothed motion, torque and friction with their derivatives by time.

    - `position`: from none to the fourth; `torque`: to the second, of positions' samples.
    - `friction`: to the second, (samples, n, p) for coefficients of one.
    """

    position: list[Series]
    torque: list[Series]
    friction: list[Float[np.ndarray, "samples joints coefficients"]]

    @classmethod
    def of(cls, problem: LikelihoodProblem, network: CSLC) -> "_Smoothed":
        readings = problem.readings
        n = readings.position.shape[1]
        parts: list[list[np.ndarray]] = []
        averaged = readings.torque.averaged
        averaged = np.concatenate([averaged[:1], averaged, averaged[-1:]])
        for number in range(int(readings.part[-1]) + 1):
            rows = readings.part == number
            time, torque = readings.time[rows], averaged[rows]
            torque[0], torque[-1] = torque[1], torque[-2]
            position = _derivatives(time, readings.position[rows], 4)
            moving = regressor_of(network, _patterns(time, position, torque))
            columns = np.array(moving)
            others = np.setdiff1d(np.arange(network.size), network.layout.friction)
            columns[:, :, others] = 0.0
            flat = _derivatives(time, columns.reshape(len(time), -1), 2)
            friction = [values.reshape(len(time), n, -1) for values in flat]
            parts.append([*position, *_derivatives(time, torque, 2), *friction])
        joined = [np.concatenate(values) for values in zip(*parts, strict=True)]
        return cls(joined[:5], joined[5:8], joined[8:])

    def rows(self, problem: LikelihoodProblem) -> Int[np.ndarray, " rows"]:
        """Return samples that are compared."""
        part = problem.readings.part
        step = max(len(part) // _SAMPLES, 1)
        result: list[np.ndarray] = []
        for number in range(int(part[-1]) + 1):
            samples = np.flatnonzero(part == number)
            ends = max(int(_ENDS * len(samples)), 2)
            result.append(samples[ends:-ends:step])
        return np.concatenate(result)

    def borne(
        self,
        joints: Int[np.ndarray, " links"],
        inertia: Float[np.ndarray, " links"],
        friction: Float[np.ndarray, " coefficients"],
        derivative: int,
    ) -> Float[np.ndarray, "samples links"]:
        """Return torque that gears bear, or a derivative of it."""
        taken = self.friction[derivative][:, joints] @ friction
        rotor = inertia * self.position[2 + derivative][:, joints]
        return self.torque[derivative][:, joints] - rotor - taken

    def fit(
        self,
        network: CSLC,
        joints: Int[np.ndarray, " links"],
        compliance: Float[np.ndarray, " links"],
        inertia: Float[np.ndarray, " links"],
        friction: Float[np.ndarray, " coefficients"],
        weights: Float[np.ndarray, " joints"],
        rows: Int[np.ndarray, " rows"],
    ) -> tuple[Float[np.ndarray, " coefficients"], Float[np.ndarray, " joints"]]:
        """Return coefficients of links that are behind their rotors, and (n,) RMS residuals."""
        motion = [values[rows].copy() for values in self.position[:3]]
        torque = self.torque[0][rows].copy()
        behind = [
            compliance * self.borne(joints, inertia, friction, order)[rows] for order in range(3)
        ]
        for values, windup in zip(motion, behind, strict=True):
            values[:, joints] -= windup
        torque[:, joints] -= inertia * behind[2]
        columns = np.array(
            regressor_of(network, _patterns(np.arange(len(rows), dtype=float), motion, torque))
        )
        index = network.layout.friction
        columns[:, :, index] = self.friction[0][rows][:, :, index]
        weighted = (columns * weights[:, None]).reshape(-1, network.size)
        size = np.maximum(np.linalg.norm(weighted, axis=0), 1e-300)
        k = np.linalg.lstsq(weighted / size, (torque * weights).ravel(), rcond=1e-8)[0] / size
        return k, np.sqrt(np.mean((torque - columns @ k) ** 2, axis=0))


def _patterns(
    time: Float[np.ndarray, " samples"], motion: Sequence[Series], torque: Series
) -> Patterns:
    q, qd, qdd = motion[:3]
    every = np.ones(q.shape, bool)
    return Patterns(time, q, qd, qdd, torque, every, every)


def _derivatives(
    time: Float[np.ndarray, " samples"], values: Float[np.ndarray, "samples columns"], most: int
) -> list[Float[np.ndarray, "samples columns"]]:
    """Return smoothed values and their derivatives by time, by Fourier's series of an odd
    continuation."""
    count, span = len(time), time[-1] - time[0]
    even = np.linspace(time[0], time[-1], count)
    slope = (values[-1] - values[0]) / span
    line = values[0] + (even - time[0])[:, None] * slope
    if not np.allclose(even, time, rtol=0.0, atol=1e-3 * span / count):
        values = np.stack([np.interp(even, time, column) for column in values.T], axis=1)
    about = values - line
    periodic = np.concatenate([about, -about[-2:0:-1]])
    frequency = np.fft.rfftfreq(len(periodic), span / (count - 1))[:, None]
    spectrum = np.fft.rfft(periodic, axis=0) * 0.5 ** ((frequency / _CUTOFF) ** 2)
    result: list[np.ndarray] = []
    for order in range(most + 1):
        derived = np.fft.irfft(spectrum * (2j * np.pi * frequency) ** order, len(periodic), axis=0)
        more = (line, slope)[order] if order < 2 else 0.0
        result.append(derived[:count] + more)
    return result


# Which of compliance, lag, play and inertia of rotors are free, for how many steps at most.
_STAGES = (((True, True, True, False), 12), ((True, True, True, True), 60))
# Least compliance and inertia of a rotor beside those at first, and the standard deviation
# beforehand of the latter.
_LEAST, _ROTOR = 1e-3, 1.0
# Standard deviation of a link's position beforehand [rad or m]: none that says anything, but at an
# end of a recording, where few equations are.
_UNREAD = 1e3
GEARS, LINKS = "gears", "links"


@dataclasses.dataclass(frozen=True)
class LinkBlock(ConstantBlock):
    """Positions of links, which nothing reads: about 0, within as much as a joint may ever turn.

    - `joints`: n; links are the columns behind them.
    """

    joints: int
    weight: Float[np.ndarray, "samples links"]

    def residuals(self, point: Point) -> Float[np.ndarray, "samples links"]:
        """Return minus positions."""
        return -point.q[:, self.joints :]

    def changes(self, step: Step) -> Float[np.ndarray, "samples links"]:
        """Return changes with positions."""
        return step.position[:, self.joints :]

    def add_gradient(self, force: Float[np.ndarray, "samples links"], total: Step) -> None:
        """Add the gradient by positions."""
        total.position[:, self.joints :] += force

    def add_squares(self, weight: Float[np.ndarray, "samples links"], normal: Normal) -> None:
        """Add squares of positions."""
        normal.equations.band[normal.order.position[:, self.joints :], 0] += weight


def with_gears(
    problem: LikelihoodProblem, start: SearchStart, links: Sequence[int], first: FirstGears
) -> tuple[LikelihoodProblem, SearchStart]:
    """Return a problem of rigid gears with elastic ones, which have no play at first.

    **Arguments**

    - `links`: which move apart from their rotors, from 0.
    - `first`: gears to start from.
    """
    readings, point, index = problem.readings, start.point, np.array(links)
    network, inertia = problem.equations.network, first.rotor_inertia
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    zeros = np.zeros(len(links))
    parameters = TransmissionParameters(first.compliance, first.lag, zeros, inertia)
    size = np.std(readings.torque.averaged[:, index], axis=0)
    wide = problem.with_unknowns(
        GEARS,
        parameters._replace(play=first.compliance * size).values,
        TransmissionParameters(zeros, zeros, zeros, inertia).values,
        TransmissionParameters(zeros, zeros, zeros, (_ROTOR * inertia) ** -2.0).values,
        TransmissionParameters(
            _LEAST * first.compliance, zeros, zeros - np.inf, _LEAST * inertia
        ).values,
    )
    width = np.max(start.position_noise, axis=0)[index]
    unread = np.full((len(point.q), len(links)), _UNREAD**-2.0)
    wide = dataclasses.replace(
        wide,
        equations=ElasticEquations(problem.equations, index, readings.time, friction, width),
        added={**problem.added, LINKS: LinkBlock(problem.joints, unread)},
    )
    border = wide.layout.inserted(point.border, GEARS, parameters.values)
    q = np.concatenate([point.q, point.q[:, index] - first.windup], axis=1)
    apart = dataclasses.replace(point, border=border, layout=wide.layout, q=q)
    k = np.where(problem.scale[: network.size] > 0.0, first.k, point.k)
    return wide, start._replace(point=apart.with_values(k=k))


def transmission_search(
    problem: LikelihoodProblem,
    start: SearchStart,
    joints: Sequence[int],
    progress: Callable[[str], None],
) -> Minimum:
    """Search for the most likely rotors and links that move apart.

    From rigid gears, a search may end with ever stiffer ones: phases of vibrations change by more
    than a radian on the way to the right stiffness. So it starts from gears that explain smoothed
    motion (`first_gears`). Stiffness, damping and play are free at first, then rotors' inertias.

    **Arguments** of a problem with rigid gears, as of `search`, and

    - `joints`: whose links move apart from their rotors, from 1.

    **Returns** the minimum of rotors and links apart.

    **Raises** `ValueError` for joints that the robot does not have.
    """
    n = problem.joints
    if any(not 1 <= joint <= n for joint in joints) or len(set(joints)) < len(joints):
        raise ValueError(
            f"transmission: expected different joints from 1 to {n}, got {tuple(joints)}"
        )
    links = [joint - 1 for joint in joints]
    progress("maximum likelihood: gears of smoothed motion")
    wide, start = with_gears(problem, start, links, first_gears(problem, start.point.k, links))
    minimum: Minimum | None = None
    for free, most_steps in _STAGES:
        scale, part = wide.scale.copy(), wide.layout.part(GEARS)
        scale[part] *= np.repeat(np.array(free, float), len(links))
        stage = dataclasses.replace(wide, scale=scale)
        minimum = search(stage, *start, progress, most_steps=most_steps)
        start = SearchStart(minimum.point, minimum.torque_noise, minimum.position_noise)
    assert minimum is not None
    return minimum


@dataclasses.dataclass(frozen=True)
class GearFit:
    """Result of `fit_with_gears`: coefficients of links and rotors together, and gears."""

    fit: jc.LikelihoodFit
    gears: Transmission


def fit_with_gears(
    estimator: jc.MaximumLikelihood,
    network: CSLC,
    recording: jc.Recording,
    joints: Sequence[int],
    progress: Callable[[str], None] = lambda words: None,
) -> GearFit:
    """Fit coefficients, and the gears of some joints.

    **Arguments** as of `MaximumLikelihood.fit`, and

    - `joints`: whose rotor and link move apart, from 1.

    **Raises** as it, and `ValueError` for joints that the robot does not have.
    """
    every = 1 if estimator.every == "auto" else estimator.every
    problem, start = estimator.start(network, [recording], None, every)
    minimum = transmission_search(problem, start, joints, progress)
    fit = likelihood_fit(network, minimum, estimator.errors, every=every)
    border = border_errors(minimum, estimator.errors)
    point, part = minimum.point, minimum.point.layout.part(GEARS)
    values, errors = map(TransmissionParameters.of, (point.values(GEARS), border.error[part]))
    gears = Transmission(
        joints=tuple(joints),
        compliance=values.compliance,
        compliance_error=errors.compliance,
        lag=values.lag,
        lag_error=errors.lag,
        play=values.play,
        play_error=errors.play,
        rotor_inertia=values.rotor_inertia,
        rotor_inertia_error=errors.rotor_inertia,
        link_position=point.q[:, problem.joints :],
    )
    return GearFit(fit, gears)
