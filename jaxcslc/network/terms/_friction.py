from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...derivation import Coefficient
from ...manipulator import STATIC_SLOPE, Coupling, Manipulator


Samples = Float[Array, "..."]
# Each word's parts, with the letters of their names and what they are called in tables.
_PARTS: dict[str, tuple[tuple[str, str, str], ...]] = {
    "viscous": (("", "kv", "viscous friction of joint {}"),),
    "asymmetric_viscous": (
        ("+", "kvp", "viscous friction of joint {}, forwards"),
        ("-", "kvn", "viscous friction of joint {}, backwards"),
    ),
    "dry": (("", "kd", "dry friction of joint {}"),),
    "asymmetric_dry": (
        ("+", "kdp", "dry friction of joint {}, forwards"),
        ("-", "kdn", "dry friction of joint {}, backwards"),
    ),
    "static": (("", "ks", "static friction of joint {} beyond dry"),),
    "root": (("", "kr", "friction of joint {} with the root of its speed"),),
    "offset": (("", "ko", "torque offset of joint {}"),),
    "spring": (("", "ke", "stiffness of joint {}"),),
}
_COUPLED = {
    "coupled_inertia": ("kcm", "inertia"),
    "coupled_viscous": ("kcv", "viscous friction"),
    "coupled_dry": ("kcd", "dry friction"),
}
_UNITS = {
    "viscous": ("N m s/rad", "N s/m"),
    "dry": ("N m", "N"),
    "static": ("N m", "N"),
    "root": ("N m (s/rad)^0.5", "N (s/m)^0.5"),
    "offset": ("N m", "N"),
    "spring": ("N m/rad", "N/m"),
    "inertia": ("kg m²", "kg"),
}
# Friction opposes motion. The rest may have either sign: static friction is what is left of it
# beyond dry friction, and a root beside a line only bends it.
_EITHER_SIGN = ("offset", "static", "root")


@dataclass(frozen=True)
class FrictionTerm:
    """A group of a network's coefficients that come after the inertial ones, and where they act.

    **Attributes**

    - `word`: of the friction model, or `"coupled_inertia"`, `"coupled_viscous"`, `"coupled_dry"`.
    - `part`: `"+"` and `"-"` for the two directions of an asymmetric word, else `""`.
    - `joints`: the joint whose torque each input enters, from 0.
    - `places`: for each input, which of the group's coefficients it is multiplied by.
    - `names`: of the coefficients.
    - `pairs`: of coupled joints, each with its inputs one after the other.
    """

    word: str
    part: str
    joints: tuple[int, ...]
    places: tuple[int, ...]
    names: tuple[str, ...]
    pairs: tuple[Coupling, ...] = ()

    @property
    def size(self) -> int:
        """How many coefficients it has."""
        return len(self.names)


@lru_cache(maxsize=64)
def friction_terms(robot: Manipulator) -> tuple[FrictionTerm, ...]:
    """The groups of coefficients of the robot's friction model, in the order of `k`."""
    terms: list[FrictionTerm] = []
    for word in robot.friction_terms:
        own = [j for j, words in enumerate(robot.friction_per_joint) if word in words]
        terms += [
            FrictionTerm(
                word, part, tuple(own), tuple(range(len(own))), tuple(f"{name}{j + 1}" for j in own)
            )
            for part, name, _ in _PARTS[word]
        ]
    if robot.coupled:
        ends = tuple(joint - 1 for pair in robot.coupled for joint in (pair.first, pair.second))
        places = tuple(index for index, _ in enumerate(robot.coupled) for _ in range(2))
        terms += [
            FrictionTerm(
                word,
                "",
                ends,
                places,
                tuple(f"{name}{pair.first}_{pair.second}" for pair in robot.coupled),
                robot.coupled,
            )
            for word, (name, _) in _COUPLED.items()
        ]
    return tuple(terms)


@lru_cache(maxsize=64)
def friction_coefficients(robot: Manipulator) -> tuple[Coefficient, ...]:
    """What each coefficient of the robot's friction model is (thesis 5.1.4, 8.2.1)."""
    found: list[Coefficient] = []
    for term in friction_terms(robot):
        if term.pairs:
            what = _COUPLED[term.word][1]
            said = [
                f"{what} that joints {pair.first} and {pair.second} share" for pair in term.pairs
            ]
            kinds = [robot.joints[pair.first - 1].kind for pair in term.pairs]
        else:
            text = next(text for part, _, text in _PARTS[term.word] if part == term.part)
            said = [text.format(joint + 1) for joint in term.joints]
            kinds = [robot.joints[joint].kind for joint in term.joints]
        unit = _UNITS[term.word.rpartition("_")[2]]
        found += [
            Coefficient(
                name, term.word, words, unit[kind == "P"], positive=term.word not in _EITHER_SIGN
            )
            for name, words, kind in zip(term.names, said, kinds, strict=True)
        ]
    return tuple(found)


def static_slopes(robot: Manipulator) -> tuple[float, ...] | None:
    """The robot's slopes of static friction, or a guess; None where no joint has any."""
    if "static" not in robot.friction_terms:
        return None
    return robot.static_slopes or (STATIC_SLOPE,) * robot.joint_count


def friction_inputs(
    terms: Sequence[FrictionTerm],
    slopes: Sequence[Any],
    q: Sequence[Samples],
    qd: Sequence[Samples],
    qdd: Sequence[Samples],
) -> list[list[Samples]]:
    """What each term's coefficients multiply, one array for each of its `joints`.

    Motion and slopes are sequences with an entry a joint (Eqns. 2.5-1, 2.5-3, 2.5-4,
    Figs. 8.2-1, 8.2-2).
    """
    return [_inputs(term, slopes, q, qd, qdd) for term in terms]


def _inputs(
    term: FrictionTerm,
    slopes: Sequence[Any],
    q: Sequence[Samples],
    qd: Sequence[Samples],
    qdd: Sequence[Samples],
) -> list[Samples]:
    if term.pairs:
        return [value for pair in term.pairs for value in _coupled_inputs(term.word, pair, qd, qdd)]
    return [_own_input(term, j, slopes, q, qd) for j in term.joints]


def _own_input(
    term: FrictionTerm, j: int, slopes: Sequence[Any], q: Sequence[Samples], qd: Sequence[Samples]
) -> Samples:
    match term.word:
        case "viscous" | "asymmetric_viscous":
            value = qd[j]
        case "dry" | "asymmetric_dry":
            value = jnp.sign(qd[j])
        case "static":
            value = jnp.sign(qd[j]) * jnp.exp(-slopes[j] * jnp.abs(qd[j]))
        case "root":
            # The root of 0 has no derivative: 1 stands in for a speed that the sign takes away.
            speed = jnp.abs(qd[j])
            value = jnp.sign(qd[j]) * jnp.sqrt(jnp.where(speed > 0, speed, 1.0))
        case "spring":
            value = q[j]
        case _:
            value = jnp.ones_like(qd[j])
    if not term.part:
        return value
    return jnp.maximum(value, 0.0) if term.part == "+" else jnp.minimum(value, 0.0)


def _coupled_inputs(
    word: str, pair: Coupling, qd: Sequence[Samples], qdd: Sequence[Samples]
) -> tuple[Samples, Samples]:
    """Of either joint, what the shaft's share adds to its own terms.

    The shaft's inertia and viscous friction enter joint i's torque by its own motion too; that
    part is not told from the joint's own motor and friction, and is left to them.
    """
    i, j, ratio = pair.first - 1, pair.second - 1, pair.ratio
    if word == "coupled_dry":
        sign = jnp.sign(qd[i] + ratio * qd[j])
        return sign, ratio * sign
    motion = qdd if word == "coupled_inertia" else qd
    return ratio * motion[j], ratio * motion[i]


def friction_torque(
    terms: Sequence[FrictionTerm],
    inputs: Sequence[Sequence[Samples]],
    k: Float[Array, " coefficients"],
    zero: Samples,
    joints: int,
) -> Float[Array, "*batch joints"]:
    """The torque of terms; `k` holds the coefficients of these alone."""
    total = [zero] * joints
    start = 0
    for term, values in zip(terms, inputs, strict=True):
        for j, place, value in zip(term.joints, term.places, values, strict=True):
            total[j] = total[j] + k[start + place] * value
        start += term.size
    return jnp.stack(total, axis=-1)


def friction_rows(
    terms: Sequence[FrictionTerm], inputs: Sequence[Sequence[Samples]], start: int
) -> dict[tuple[int, int], Samples]:
    """The entries of the regressor that are ever non-zero: {(joint, coefficient): array}.

    `start` is the place of the first of the terms' coefficients in `k`.
    """
    rows: dict[tuple[int, int], Samples] = {}
    for term, values in zip(terms, inputs, strict=True):
        for j, place, value in zip(term.joints, term.places, values, strict=True):
            rows[j, start + place] = value
        start += term.size
    return rows


def friction_regressor(
    terms: Sequence[FrictionTerm], inputs: Sequence[Sequence[Samples]], zero: Samples, joints: int
) -> Float[Array, "*batch joints coefficients"]:
    """The columns of the regressor that belong to terms, side by side."""
    blocks: list[Array] = []
    for term, values in zip(terms, inputs, strict=True):
        if term.pairs:
            rows = friction_rows([term], [values], 0)
            blocks.append(
                jnp.stack(
                    [
                        jnp.stack([rows.get((j, p), zero) for p in range(term.size)], axis=-1)
                        for j in range(joints)
                    ],
                    axis=-2,
                )
            )
        else:
            # One row of the identity a coefficient: a product costs less than many small arrays.
            x = jnp.stack(values, axis=-1)[..., None, :]
            shape = (*zero.shape, joints, term.size)
            eye = jnp.asarray(np.eye(joints)[:, list(term.joints)], x.dtype)
            blocks.append(jnp.broadcast_to(x, shape) * jnp.broadcast_to(eye, shape))
    return jnp.concatenate(blocks, axis=-1)


def coupling_matrix(pair: Coupling, joints: int) -> Float[np.ndarray, "joints joints"]:
    """What a pair's shared inertia is multiplied by in the mass matrix."""
    matrix = np.zeros((joints, joints))
    i, j = pair.first - 1, pair.second - 1
    matrix[i, j] = matrix[j, i] = pair.ratio
    return matrix
