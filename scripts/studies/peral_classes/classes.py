"""Classes of network, and random patterns to train them with (thesis 8.2.2)."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
from jaxcslc.manipulator import LinkParameters
from jaxcslc.systems import system_patterns
from jaxcslc.training import (
    HARD_LIMITER,
    LINEAR_COMBINER,
    AdaptiveNetwork,
    Examples,
    RadialBasis,
    examples,
    fully_connected,
    inverse_dynamics,
    linear_combiner,
)
from scripts.studies.systems.example import Example, recording_of
from scripts.studies.systems.examples.lorenz import LORENZ
from scripts.studies.systems.examples.vehicle import VEHICLE


Drawn = tuple[Any, np.ndarray, np.ndarray | None]
Draw = Callable[[np.random.Generator, AdaptiveNetwork, int], Drawn]


@dataclasses.dataclass(frozen=True)
class NetworkClass:
    """A network and how its patterns are drawn.

    - `build`: makes the network.
    - `draw`: from random numbers, the network and a number of patterns to patterns, their targets
      without noise, and the weights that meet these, if any do.
    - `patterns`: of a training.
    - `reach`: starting weights are drawn from ± this.
    - `tuned`: whether the indicator's settings were selected on it.
    """

    name: str
    build: Callable[[], AdaptiveNetwork]
    draw: Draw
    patterns: int
    reach: float
    tuned: bool = False


@dataclasses.dataclass(frozen=True)
class Problem:
    """Trainings of one class at one noise, a seed each.

    - `examples`: with a leading axis of seeds.
    - `starts`: starting weights.
    - `optima`: weights that meet the targets without noise, if any do.
    - `deviation`: root mean square over outputs of the targets' standard deviation, by seed.
    """

    name: str
    noise: float
    network: AdaptiveNetwork
    examples: Examples
    starts: Float[Array, "seeds weights"]
    optima: Float[Array, "seeds weights"] | None
    deviation: Float[np.ndarray, " seeds"]

    @property
    def linear(self) -> bool:
        """Return whether outputs are linear in the weights, so that there is a direct solve."""
        return self.network.linear and self.network.activation == LINEAR_COMBINER

    def of_seed(self, index: int) -> Examples:
        """The patterns of one seed."""
        return jax.tree.map(lambda x: x[index], self.examples)


def independent(inputs: int) -> Draw:
    """Standard normal inputs, and random weights of the same network."""

    def draw(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
        return _answered(rng, network, rng.standard_normal((count, inputs)))

    return draw


def correlated(inputs: int, correlation: float) -> Draw:
    """Normal inputs of which neighbours are correlated."""
    distance = np.abs(np.subtract.outer(np.arange(inputs), np.arange(inputs)))
    factor = np.linalg.cholesky(correlation**distance)

    def draw(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
        return _answered(rng, network, rng.standard_normal((count, inputs)) @ factor.T)

    return draw


def _answered(rng: np.random.Generator, network: AdaptiveNetwork, inputs: np.ndarray) -> Drawn:
    weights = rng.standard_normal(network.size)
    return inputs, np.asarray(network.outputs(jnp.asarray(weights), jnp.asarray(inputs))), weights


def separable(inputs: int) -> Draw:
    """Normal inputs that lie at some distance from a random hyperplane."""

    def draw(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
        weights = rng.standard_normal(network.size)
        normal = weights[:-1] / np.linalg.norm(weights[:-1])
        x = rng.standard_normal((count, inputs))
        distance = x @ normal + 0.2 * weights[-1]
        x = x + 0.2 * np.where(distance >= 0.0, 1.0, -1.0)[:, None] * normal
        return x, np.where(distance >= 0.0, 1.0, 0.0)[:, None], None

    return draw


def radial_basis(per_axis: int) -> AdaptiveNetwork:
    """Gaussians on a square grid over [-1, 1]², and a linear combiner."""
    axis = np.linspace(-1.0, 1.0, per_axis)
    centres = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    widths = np.full(len(centres), axis[1] - axis[0])
    basis = RadialBasis(jnp.asarray(centres), jnp.asarray(widths))
    return fully_connected([2, 1], "linear combiner", preprocess=basis)


def surface(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
    """A sum of two random waves over [-1, 1]², which no radial basis meets exactly."""
    del network
    x = rng.uniform(-1.0, 1.0, (count, 2))
    frequency, phase = rng.uniform(1.0, 3.0, (2, 2)), rng.uniform(0.0, 2.0 * np.pi, 2)
    return x, np.sum(np.sin(x @ frequency + phase), axis=1, keepdims=True), None


def arm(robot: jc.Manipulator) -> AdaptiveNetwork:
    """The CSLC of an arm."""
    return inverse_dynamics(jc.derive(robot))


def planar(joints: int) -> jc.Manipulator:
    """Links of 0.4 m in a vertical plane."""
    rows = [("-pi/2" if i == 0 else 0, 0 if i == 0 else 0.4, 0, 0) for i in range(joints)]
    return jc.Manipulator.from_modified_dh(rows, name=f"planar {joints}R")


def elbow() -> jc.Manipulator:
    """A vertical axis, shoulder and elbow."""
    rows = [(0, 0, 0, 0), ("-pi/2", 0, 0, 0), (0, 0.4, 0.1, 0)]
    return jc.Manipulator.from_modified_dh(rows, name="elbow 3R")


def random_motion(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
    """Independent positions, velocities and accelerations, and random bodies that can exist."""
    cslc = network.preprocess.network  # pyright: ignore[reportFunctionMemberAccess]
    joints = cslc.joint_count
    scales = (2.5, 1.5, 3.0)
    motion = tuple(rng.uniform(-scale, scale, (count, joints)) for scale in scales)
    links = tuple(_body(rng, 5.0 * 0.7**joint) for joint in range(joints))
    friction = {name: rng.uniform(0.2, 2.0, joints).tolist() for name in ("viscous", "dry")}
    k = cslc.coefficients_from(links, **friction)
    return motion, np.asarray(network.outputs(k, motion)), np.asarray(k)


def simulated_motion(example: Example) -> Draw:
    """Samples of a recording of a system without noise, and the system's true constants."""

    def draw(rng: np.random.Generator, network: AdaptiveNetwork, count: int) -> Drawn:
        (columns,) = example.simulate([int(rng.integers(1 << 30))], True)
        patterns = system_patterns(
            example.system, recording_of(columns), example.settings.preparation
        )
        some = rng.choice(patterns.samples, count, replace=False)
        motion = tuple(np.asarray(x)[some] for x in (patterns.q, patterns.qd, patterns.qdd))
        k = example.coefficients
        return motion, np.asarray(network.outputs(jnp.asarray(k), motion)), k

    return draw


def _body(rng: np.random.Generator, mass: float) -> LinkParameters:
    """Eight point masses and a motor."""
    masses = rng.dirichlet(np.ones(8)) * mass
    points = rng.uniform([0.0, -0.2, -0.2], [0.4, 0.2, 0.2], (8, 3))
    centre = masses @ points / mass
    arms = points - centre
    second = (masses[:, None] * arms).T @ arms
    tensor = np.trace(second) * np.eye(3) - second
    return LinkParameters(mass, centre, (tensor + tensor.T) / 2.0, rng.uniform(0.05, 0.5))


CLASSES: dict[str, NetworkClass] = {
    one.name: one
    for one in (
        NetworkClass(
            "linear",
            lambda: fully_connected([10, 2], "linear combiner"),
            independent(10), 200, 0.5, tuned=True,
        ),
        NetworkClass(
            "linear, correlated inputs",
            lambda: fully_connected([10, 2], "linear combiner"),
            correlated(10, 0.9), 200, 0.5,
        ),
        NetworkClass(
            "sigmoid",
            lambda: fully_connected([10, 3], "hyperbolic tangent"),
            independent(10), 200, 0.5, tuned=True,
        ),
        NetworkClass(
            "logistic, correlated inputs",
            lambda: fully_connected([10, 3], "logistic"),
            correlated(10, 0.9), 200, 0.5,
        ),
        NetworkClass(
            "sigmoid, two layers",
            lambda: fully_connected([4, 6, 2], ["hyperbolic tangent", "linear combiner"]),
            independent(4), 200, 0.5,
        ),
        NetworkClass(
            "hard limiter",
            lambda: fully_connected([10, 1], "hard limiter"),
            separable(10), 200, 0.5,
        ),
        NetworkClass("radial basis", lambda: radial_basis(4), surface, 200, 0.5),
        NetworkClass("CSLC, 2 joints", lambda: arm(planar(2)), random_motion, 200, 0.1, tuned=True),
        NetworkClass("CSLC, 3 joints", lambda: arm(elbow()), random_motion, 200, 0.1),
        NetworkClass("CSLC, 6 joints", lambda: arm(jc.puma560()), random_motion, 200, 0.1),
        NetworkClass("CSLC, 7 joints", lambda: arm(jc.panda()), random_motion, 300, 0.1),
        *(
            NetworkClass(
                f"system, {example.name}",
                lambda example=example: linear_combiner(example.system.network),
                simulated_motion(example), 200, 0.1,
            )
            for example in (LORENZ, VEHICLE)
        ),
    )
}  # fmt: skip


def problem(kind: NetworkClass, noise: float, seeds: range) -> Problem:
    """Patterns and starts of several seeds.

    **Arguments**

    - `noise`: standard deviation of what is added to targets, in parts of the targets' own; none
      to those of a hard limiter.
    """
    network = kind.build()
    low, high = network.activation.low, network.activation.high
    sets: list[Examples] = []
    starts: list[np.ndarray] = []
    optima: list[np.ndarray] = []
    deviations: list[float] = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 2])
        patterns, clean, optimum = kind.draw(rng, network, kind.patterns)
        spread = clean.std(axis=0)
        targets = clean + noise * spread * rng.standard_normal(clean.shape)
        targets = clean if network.activation == HARD_LIMITER else targets
        patterns = jax.tree.map(jnp.asarray, patterns)
        sets.append(examples(network, patterns, jnp.asarray(np.clip(targets, low, high))))
        starts.append(rng.uniform(-kind.reach, kind.reach, network.size))
        optima += [] if optimum is None else [optimum]
        deviations.append(float(np.sqrt(np.mean(spread**2))))
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *sets)
    return Problem(
        kind.name,
        noise,
        network,
        stacked,
        jnp.asarray(np.stack(starts)),
        jnp.asarray(np.stack(optima)) if optima else None,
        np.array(deviations),
    )
