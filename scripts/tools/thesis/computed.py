"""Numbers of the thesis page that follow from the code at once."""

import functools
import inspect
import math
import re
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.recordings import DEFAULT_THRESHOLD_FRACTION
from jaxcslc.training import (
    LINEAR_COMBINER,
    AdaptiveNetwork,
    Layer,
    Links,
    Preprocessed,
    Subnetwork,
    fully_connected,
    inverse_dynamics,
    network_order,
    order_per_output,
)
from scripts.studies.training.peral_operations import COUNTED_FORMULAS, counted


_SECONDS_A_DAY = 86_400
_BASE_TIME = 0.1  # s, of which the training periods are prime multiples
_FRICTION = ("viscous", "dry")


@functools.cache
def network() -> jc.CSLC:
    """The PUMA 560's, with symbolic lengths."""
    return jc.derive(jc.puma560())


def count(subnetwork: str, what: str) -> int:
    """Inputs, links, nodes or coefficients of a subnetwork."""
    return network().counts[subnetwork][what]


def expanded_terms() -> list[int]:
    """Products of parameters and inputs in an element of the mass matrix: fewest and most."""
    table, coefficients = network().algebra.mass, network().coefficients
    sizes = dict.fromkeys(table.columns, 0)
    for linked in table.links:
        for index, _ in linked.weights:
            products = re.split(r" [+-] ", coefficients[index].expression)
            sizes[table.columns[linked.column]] += len(products)
    return [min(sizes.values()), max(sizes.values())]


def dh_parameters() -> list[int]:
    """Four a joint, and the lengths that are not zero."""
    robot = jc.puma560()
    return [4 * len(robot.joints), len(robot.length_values())]


def example_orders() -> list[int]:
    """Return the orders of the outputs of Fig. 4.2-1, whose nodes have 2, 3, 3, 2 and 2, 3 links,
    and of it.
    """
    hidden = [[0, 1], [0, 1, 2], [0, 1, 2], [1, 2]]
    outputs = [[0, 1], [0, 2, 3]]
    layers: list[Layer] = []
    first = 0
    for inputs, sources in ((3, hidden), (len(hidden), outputs)):
        node = [i for i, several in enumerate(sources) for _ in several]
        source = [i for several in sources for i in several]
        weights = list(range(first, first + len(node)))
        layers.append(Layer(Links(inputs, len(sources), source, node, weights)))
        first += len(node)
    example = AdaptiveNetwork(
        (Subnetwork("example", tuple(layers)),),
        Preprocessed(3),
        LINEAR_COMBINER,
        tuple(f"w{i}" for i in range(first)),
    )
    return [*order_per_output(example), network_order(example)]


def inputs_and_outputs() -> list[int]:
    """Positions, velocities and accelerations; torques."""
    joints = network().joint_count
    return [3 * joints, joints]


def weights() -> list[int]:
    """Coefficients of each subnetwork, and of all."""
    sizes = [count(name, "coefficients") for name in ("mass", "gravity", *_FRICTION)]
    return [*sizes, network().size]


def order() -> int:
    """Return the order of the network."""
    return network().order


def least_patterns() -> int:
    """Return how many patterns determine all coefficients."""
    return network().least_patterns


def order_of_joint_2() -> list[int]:
    """Mass and velocity, gravity, and friction coefficients that its torque depends on."""
    algebra, joint = network().algebra, 1
    tables = {"mass": algebra.mass, "velocity": algebra.velocity, "gravity": algebra.gravity}
    reach: dict[str, set[int]] = {}
    for name, table in tables.items():
        depends = (lambda column: joint in column) if name == "mass" else (lambda c: c[0] == joint)
        reach[name] = {
            index
            for linked in table.links
            if depends(table.columns[linked.column])
            for index, _ in linked.weights
        }
    rigid = reach["mass"] | reach["velocity"]
    friction = sum(count(name, "coefficients") for name in _FRICTION) // network().joint_count
    return [len(rigid), len(reach["gravity"]), friction]


def ultrasound_patterns() -> list[int]:
    """Return the numbers of patterns: in all, for training, and for training of each kind."""
    options = inspect.signature(sim.ultrasound).parameters
    per_kind = options["training_per_kind"].default
    kinds = sim.ultrasound(patterns=10, training_per_kind=1).kinds
    return [options["patterns"].default, per_kind * len(kinds), per_kind]


def operations_formula(rule: str) -> str:
    """Return the operations per pattern in an epoch of a two-layer network, as a formula."""
    return COUNTED_FORMULAS[rule]


def ultrasound_operations() -> list[int]:
    """Return the operations of both rules on the 25+1 to 10 network."""
    return list(counted(fully_connected([25, 10], "hyperbolic tangent")).values())


def cslc_operations() -> list[int]:
    """Return the operations of both rules on the PUMA 560's CSLC."""
    return list(counted(inverse_dynamics(network())).values())


def encoder_counts() -> list[float]:
    """Return the encoder counts at the joints [mrad]."""
    return [1e3 * count for count in sim.puma560().encoder_resolution]


def linearity_measurements() -> list[int]:
    """All, and those that the line is fitted to."""
    masses = inspect.signature(sim.motor_linearity).parameters["masses"].default
    return [len(masses), len(masses) - 1]


def sampling_interval() -> float:
    """Return the sampling interval of the training trajectory [ms]."""
    return 1e3 * sim.training().sample_interval


def training_amplitudes() -> list[float]:
    """Return the amplitudes of the training torques [N m]."""
    return _numbers(cast(Any, sim.training().controller).amplitude)


def training_periods() -> list[float]:
    """Return the periods of the training torques [s]."""
    return _numbers(cast(Any, sim.training().controller).period)


def training_span() -> float:
    """The least common multiple of the periods [days]."""
    tenths = [round(period / _BASE_TIME) for period in training_periods()]
    return math.lcm(*tenths) * _BASE_TIME / _SECONDS_A_DAY


def training_patterns() -> list[float]:
    """Samples of the training trajectory, and their number over the network's order."""
    samples = sim.training().samples
    return [samples, samples / order()]


def comparison_gains(kind: str) -> list[float]:
    """Return the comparison gains of the controller of the comparison trajectory."""
    return _numbers(getattr(sim.comparison().controller, kind))


def threshold_fraction() -> float:
    """The default of `jc.prepare`."""
    return DEFAULT_THRESHOLD_FRACTION


def positive_coefficients() -> str:
    """Names of the rigid-body coefficients that are positive by construction."""
    rigid = network().coefficients[network().layout.inertial]
    return ", ".join(coefficient.name for coefficient in rigid if coefficient.positive)


def numeric_lengths() -> list[int]:
    """Mass and gravity coefficients with symbolic and with numeric lengths."""
    numeric = jc.derive(jc.puma560(), lengths="numeric")
    friction = sum(count(name, "coefficients") for name in _FRICTION)
    return [network().size - friction, numeric.size - friction]


def printed_variations() -> list[float]:
    """Largest difference of the two machines' coefficients in Appendix B times PUMA A's
    sensitivity, of mass and of gravity coefficients [N m]."""
    a, b = sim.thesis_coefficients("A"), sim.thesis_coefficients("B")
    mass = np.abs(a.mass - b.mass) * a.mass_sensitivity
    gravity = np.abs(a.gravity - b.gravity) * a.gravity_sensitivity
    return [float(mass.max()), float(gravity.max())]


def subnetwork(name: str) -> list[int]:
    """Inputs, links, and places of its matrix of weights without a link."""
    inputs, links, nodes = (count(name, what) for what in ("inputs", "links", "nodes"))
    return [inputs, links, inputs * nodes - links]


def velocity_subnetwork() -> list[int]:
    """Inputs, links, and coefficients."""
    return [count("velocity", what) for what in ("inputs", "links", "coefficients")]


def gravity_subnetwork() -> list[int]:
    """Inputs and coefficients."""
    return [count("gravity", what) for what in ("inputs", "coefficients")]


def _numbers(values: Sequence[float]) -> list[float]:
    return [float(value) for value in np.asarray(values)]
