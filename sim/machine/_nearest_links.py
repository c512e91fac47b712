"""Links whose dynamics are nearest to given coefficients."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import least_squares

from jaxcslc.derivation import constant_values, derive_algebra
from jaxcslc.manipulator import LinkInertia, LinkParameters, Manipulator
from sim.machine._bodies import MachineError, possible_links


# Parameters of a link with principal axes, in the order of the last axis of `parameters`.
PARAMETERS = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "motor")
_MOST_FACTORS = 3  # as in m*rx*ry


@dataclass(frozen=True, eq=False)
class CoefficientMap:
    """Map from link parameters to the inertial coefficients of the dynamics, with its derivative.

    What `CSLC.coefficients_from` computes, for links whose principal axes are the frame's
    (Eqn. 2.3-20), in NumPy: an optimiser evaluates it hundreds of times.
    """

    names: tuple[str, ...]
    """Of the coefficients: `kM1` to `kG5` for the PUMA 560."""

    matrix: Float[np.ndarray, "coefficients terms"]
    """Factor of each product of parameters in each coefficient; it includes lengths and gravity."""

    factors: Int[np.ndarray, "terms 3"]
    """Which parameters each product multiplies; one past the last parameter stands for 1."""

    @classmethod
    def of(cls, robot: Manipulator) -> "CoefficientMap":
        coefficients = derive_algebra(robot, "symbolic").coefficients
        constants = constant_values(robot)
        terms = list({addend.term: None for c in coefficients for addend in c.addends})
        matrix = np.zeros((len(coefficients), len(terms)))
        for row, coefficient in zip(matrix, coefficients, strict=True):
            for addend in coefficient.addends:
                factor = float(addend.factor)
                for name, power in addend.constants:
                    factor *= constants[name] ** power
                row[terms.index(addend.term)] += factor
        width = len(PARAMETERS)
        factors = np.full((len(terms), _MOST_FACTORS), robot.joint_count * width)
        for row, term in zip(factors, terms, strict=True):
            row[: len(term.factors)] = [
                term.link * width + PARAMETERS.index(factor) for factor in term.factors
            ]
        return cls(tuple(c.name for c in coefficients), matrix, factors)

    def values(self, parameters: Float[np.ndarray, "links 8"]) -> Float[np.ndarray, " k"]:
        """Coefficients of links whose parameters are rows of `PARAMETERS`."""
        return self.matrix @ np.prod(self._factor_values(parameters), axis=1)

    def jacobian(self, parameters: Float[np.ndarray, "links 8"]) -> Float[np.ndarray, "k links 8"]:
        """Derivative of each coefficient in each parameter."""
        values = self._factor_values(parameters)
        of_terms = np.zeros((len(self.factors), parameters.size + 1))
        for slot in range(_MOST_FACTORS):  # the product rule
            others = np.prod(np.delete(values, slot, axis=1), axis=1)
            np.add.at(of_terms, (np.arange(len(values)), self.factors[:, slot]), others)
        return (self.matrix @ of_terms[:, :-1]).reshape(-1, *parameters.shape)

    def _factor_values(
        self, parameters: Float[np.ndarray, "links 8"]
    ) -> Float[np.ndarray, "terms 3"]:
        return np.append(parameters, 1.0)[self.factors]


def parameters_of(links: Sequence[LinkParameters]) -> Float[np.ndarray, "links 8"]:
    """Links as rows of `PARAMETERS`, without the products of inertia."""
    return np.array(
        [
            [
                float(link.mass),
                *np.asarray(link.centre_of_gravity, dtype=np.float64),
                *np.diag(np.asarray(link.inertia, dtype=np.float64)),
                float(link.motor_inertia),
            ]
            for link in links
        ]
    )


def links_of(parameters: Float[np.ndarray, "links 8"]) -> tuple[LinkParameters, ...]:
    """Rows of `PARAMETERS` as links."""
    return tuple(
        LinkParameters(float(row[0]), row[1:4].copy(), np.diag(row[4:7]), float(row[7]))
        for row in parameters
    )


# Regularisation: a parameter that the coefficients do not determine keeps its nominal value. The
# residual of a parameter is this many units of weighted difference (N m, for torque sensitivities)
# at half its range from the nominal value, or at its size where the range is unbounded. For the
# thesis's PUMA 560s the distance increases by less than 1 part in 1,000.
_PREFERENCE = 1e-3
_TOLERANCE = 1e-14
_SMALLEST_SCALE = 1e-3  # of a mass or moment that is about zero


def nearest_links(
    robot: Manipulator,
    coefficients: Float[np.ndarray, " coefficients"],
    weight: Float[np.ndarray, " weights"],
    *,
    least: float = 0.5,
    shift: float = 0.1,
) -> tuple[LinkParameters, ...]:
    """Links of the physically possible machine whose coefficients are nearest to `coefficients`.

    Coefficients that were identified one by one need not belong to any machine: some are fixed
    multiples of others, and bodies obey inequalities. The result minimises
    |weight · (their coefficients − `coefficients`)|₂ among those that are

    - bodies: positive mass, and a spread of mass that is not negative in any direction,
      ∫ x xᵀ dm = tr(I)/2 − I ≥ 0. With principal axes along the frame's that is three bounds a
      link, and exact (Traversaro, Brossette, Escande and Nori 2016; Wensing, Kim and Slotine 2018);
    - of the robot's kind: principal axes, zeros and equal moments as `robot.inertia` has them, so
      that the robot's network holds for them exactly;
    - close to the robot's nominal links: masses and motor inertias from `least` to
      1/`least` times theirs, spreads of mass no less than `least` times theirs, centres of gravity
      within `shift` of theirs in each direction. M(q) is then positive definite
      everywhere, its smallest eigenvalue no less than the smallest motor inertia.

    Spread along a joint's axis belongs to either neighbour (see `possible_links`); what the
    nominal links lack of it is moved to them first. Parameters that the coefficients do not
    determine keep their nominal values. The problem is not convex (products such as
    m rx ry depend on the first moments); for the PUMA 560 every start led to the same links within
    the default limits, but with a `shift` of a metre the search may end a few percent short of the
    nearest.

    **Arguments**

    - `robot`: the chain, whose links have principal axes and values.
    - `coefficients`: of mass and gravity, in the order of `jaxcslc.derive(robot)`; no friction.
    - `weight`: weight of each difference, such as the output sensitivity [N m a unit] (7.6).
    - `least`, `shift`: largest deviation from the nominal links, as above; `shift` in m.

    **Returns** the links, one a joint. Deterministic.

    **Raises** `MachineError`: the robot has no links or a full inertia tensor, a number is not
    finite or out of range, or there are not as many as the robot has coefficients.

    >>> import dataclasses
    >>> import numpy as np
    >>> import jaxcslc
    >>> from sim import nearest_links
    >>> robot = jaxcslc.Manipulator.from_modified_dh([(0, 0, 0, 0)], inertia="principal")
    >>> rod = jaxcslc.LinkParameters(1.0, np.array([0.2, 0, 0]), np.diag([0.0, 0.01, 0.01]), 0.1)
    >>> robot = dataclasses.replace(robot, links=(rod,))
    >>> [k.expression for k in jaxcslc.derive(robot).coefficients[:1]]
    ['Izz1 + m1*rx1^2 + m1*ry1^2 + Im1']
    >>> (link,) = nearest_links(robot, np.array([-1.0]), np.array([1.0]))
    >>> float(link.mass), float(link.centre_of_gravity[0]), float(link.motor_inertia)
    (0.5, 0.1, 0.05)
    """
    nominal = _nominal_links(robot)
    if not 0 < least <= 1:
        raise MachineError(f"least is {least}; expected more than 0 and at most 1")
    if not 0 <= shift < np.inf:
        raise MachineError(f"shift is {shift} m; expected zero or more")
    mapping = CoefficientMap.of(robot)
    k = _checked_values(mapping, "coefficients", coefficients)
    w = _checked_values(mapping, "weight", weight)
    if not (w >= 0).all():
        i = int(np.argmin(w))
        raise MachineError(f"weight of {mapping.names[i]} is {w[i]}; expected zero or more")

    space = _SearchSpace.of(robot, parameters_of(nominal), least, shift)

    def residual(z: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " residuals"]:
        change = w * (mapping.values(space.parameters(z)) - k)
        return np.concatenate([change, _PREFERENCE * (z - space.nominal)])

    def jacobian(z: Float[np.ndarray, " variables"]) -> Float[np.ndarray, "residuals variables"]:
        slope = mapping.jacobian(space.parameters(z)).reshape(len(k), -1) @ space.basis
        return np.concatenate([w[:, None] * slope, _PREFERENCE * np.eye(len(z))])

    solution = least_squares(
        residual,
        space.nominal,
        jacobian,
        bounds=(space.low, space.high),
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=_TOLERANCE,
        max_nfev=3000,
    )
    return links_of(space.parameters(np.clip(solution.x, space.low, space.high)))


@dataclass(frozen=True, eq=False)
class _SearchSpace:
    """The variables z of the search, scaled: parameters are `start + basis @ z`, flattened."""

    start: Float[np.ndarray, " parameters"]
    basis: Float[np.ndarray, "parameters variables"]
    nominal: Float[np.ndarray, " variables"]
    """The robot's nominal links."""
    low: Float[np.ndarray, " variables"]
    high: Float[np.ndarray, " variables"]

    @classmethod
    def of(
        cls, robot: Manipulator, nominal: Float[np.ndarray, "links 8"], least: float, shift: float
    ) -> "_SearchSpace":
        start = np.zeros(nominal.shape)
        columns: list[Float[np.ndarray, " parameters"]] = []
        bounds: list[tuple[float, float, float]] = []

        def add_variable(
            entries: Float[np.ndarray, "links 8"], low: float, at: float, high: float
        ) -> None:
            """Adds a variable: the parameters that it changes, its nominal value, its bounds."""
            if low < high:
                between = (high - low) / 2 if np.isfinite(high) else max(abs(at), _SMALLEST_SCALE)
                columns.append(between * entries.ravel())
                bounds.append((low / between, at / between, high / between))
            else:
                start[...] += at * entries

        for i, (inertia, values) in enumerate(zip(robot.inertia, nominal, strict=True)):
            for j in (0, 7):  # a mass or a motor inertia of zero stays zero
                entries = np.zeros(nominal.shape)
                entries[i, j] = 1.0
                add_variable(entries, least * values[j], values[j], values[j] / least)
            for j in (1, 2, 3):
                entries = np.zeros(nominal.shape)
                entries[i, j] = 1.0
                free = shift if PARAMETERS[j] not in inertia.zero and values[0] > 0 else 0.0
                add_variable(entries, values[j] - free, values[j], values[j] + free)
            spread = values[4:7].sum() / 2 - values[4:7]
            for axes in _spreads(inertia):
                entries = np.zeros(nominal.shape)
                entries[i, 4:7] = len(axes)  # spread along x is part of Iyy and Izz
                entries[i, [4 + axis for axis in axes]] -= 1.0
                at = max(float(np.mean(spread[list(axes)])), 0.0)
                vanishes = any(
                    PARAMETERS[j] in inertia.zero for j in (4, 5, 6) if entries[i, j] > 0
                )
                add_variable(entries, least * at, at, at if vanishes else np.inf)
        low, at, high = (np.array(column) for column in zip(*bounds, strict=True))
        return cls(start.ravel(), np.array(columns).T, at, low, high)

    def parameters(self, z: Float[np.ndarray, " variables"]) -> Float[np.ndarray, "links 8"]:
        return (self.start + self.basis @ z).reshape(-1, len(PARAMETERS))


def _spreads(inertia: LinkInertia) -> list[tuple[int, ...]]:
    """Axes whose spreads of mass are one variable, since the moments about them are equal."""
    same = [{axis} for axis in range(3)]
    for pair in inertia.equal:
        first, second = (PARAMETERS.index(moment) - 4 for moment in pair)
        joined = same[first] | same[second]
        for axis in joined:
            same[axis] = joined
    return sorted({tuple(sorted(axes)) for axes in same})


def _nominal_links(robot: Manipulator) -> tuple[LinkParameters, ...]:
    if robot.links is None:
        raise MachineError(f"robot {robot.name!r} has no link parameters; expected nominal values")
    for i, (inertia, link) in enumerate(zip(robot.inertia, robot.links, strict=True), start=1):
        tensor = np.asarray(link.inertia, dtype=np.float64)
        if inertia.form != "principal" or np.count_nonzero(tensor - np.diag(np.diag(tensor))):
            raise MachineError(
                f"robot {robot.name!r}: link {i} has a full inertia tensor;"
                " expected principal axes along the frame's"
            )
    return possible_links(robot, robot.links)


def _checked_values(
    mapping: CoefficientMap, name: str, values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " coefficients"]:
    values = np.asarray(values, dtype=np.float64)
    names = mapping.names
    if values.shape != (len(names),):
        raise MachineError(
            f"{name} has {len(values)} values; expected {len(names)}, {names[0]} to {names[-1]}"
        )
    if not np.isfinite(values).all():
        i = int(np.argmin(np.isfinite(values)))
        raise MachineError(f"{name}: {names[i]} is {values[i]}; expected a finite number")
    return values
