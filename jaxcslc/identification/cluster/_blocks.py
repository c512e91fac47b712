import dataclasses
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

from ...manipulator import Manipulator, Mimic
from ...motion import Patterns, Recording, iterate_recording, load_recording
from ...network import CSLC, RigidBodyTables, derive
from .._settings import Settings
from ..solver import JointFactors, factors_of_stream, pattern_factors


# Rows of a file that are read at once.
_ROWS = 1 << 16
# Samples from which on a recording is factorised in pieces.
_LONG = 1 << 17


@dataclasses.dataclass(frozen=True)
class Derivation:
    """How to derive a network again: what travels to another process in its place.

    A network's tables are megabytes, and deriving them takes a second once in a process.

    **Attributes**

    - `robot`, `lengths`, `evaluator`: arguments of `derive`.
    - `mimics`: the laws of joints that follow others, in which equal robots may differ.
    - `link`: that carries a payload with coefficients of its own, or None.
    - `slopes`: of static friction, as nested tuples, or None.
    """

    robot: Manipulator
    mimics: tuple[Mimic, ...]
    lengths: str | tuple[str, ...]
    evaluator: str
    link: int | None
    slopes: tuple[tuple[float, ...], ...] | tuple[float, ...] | None

    @classmethod
    def of(cls, network: CSLC) -> "Derivation":
        """Of a network."""
        slopes = network.static_slopes
        return cls(
            robot=network.robot,
            mimics=() if network.robot.source is None else network.robot.source.mimics,
            lengths=network.algebra.lengths,
            evaluator="tables" if isinstance(network.rigid_body, RigidBodyTables) else "recursive",
            link=None if network.payload is None else network.carrying_link,
            slopes=None if slopes is None else _nested(np.asarray(slopes)),
        )


@lru_cache(maxsize=16)
def derived(derivation: Derivation) -> CSLC:
    """The network of a derivation, derived once in a process."""
    lengths, evaluator = cast(Any, derivation.lengths), cast(Any, derivation.evaluator)
    network = derive(derivation.robot, lengths=lengths, evaluator=evaluator)
    if derivation.link is not None:
        network = network.with_payload(derivation.link)
    if derivation.slopes is not None:
        network = network.with_static_slopes(np.array(derivation.slopes))
    return network


def _nested(values: np.ndarray) -> tuple[float, ...] | tuple[tuple[float, ...], ...]:
    if values.ndim == 1:
        return tuple(values.tolist())
    return tuple(tuple(row) for row in values.tolist())


@dataclasses.dataclass(frozen=True)
class Work:
    """What is done with every file.

    **Attributes**

    - `derivation`: of the network.
    - `settings`: of preparation and fit; None uses velocities and accelerations of the files as
      they are, a part of a file at a time.
    - `read`: a function from a path to a recording, or None for `load_recording`.
    """

    derivation: Derivation
    settings: Settings | None
    read: Callable[[Path], Recording] | None = None


def block_factors(path: str, work: Work) -> JointFactors:
    """The factors of the equations of one file, in float64: what a worker of a cluster computes."""
    with jax.enable_x64(True):  # a worker's process is the cluster's: nobody has set it up
        return _block_factors(path, work)


def _block_factors(path: str, work: Work) -> JointFactors:
    network = derived(work.derivation)
    if work.settings is None:
        return factors_of_stream(network, _patterns_as_recorded(path, network), workers=1)
    recording = load_recording(path) if work.read is None else work.read(Path(path))
    patterns, solver = work.settings.patterns(recording), work.settings.solver
    if solver.cutoff is not None:
        return solver.equations(network, patterns).factors()
    if patterns.samples >= _LONG:
        return factors_of_stream(network, [patterns], workers=1)
    return jax.tree.map(np.asarray, pattern_factors(network, patterns))


def _patterns_as_recorded(path: str, network: CSLC) -> Iterator[Patterns]:
    for chunk in iterate_recording(path, _ROWS, joints=network.output_names):
        if chunk.velocity is None or chunk.acceleration is None:
            raise ValueError(
                f"{path}: has no velocities and accelerations; expected both, or settings that"
                " say how to compute them"
            )
        everything = np.ones(chunk.position.shape, bool)
        motion = chunk.position, chunk.velocity, chunk.acceleration
        yield Patterns(chunk.time, *motion, chunk.torque, everything, everything)
