"""Laws of single joints (Eqns. 2.5-3, 2.5-4), one row of a table each, and their terms.

`JOINT_LAWS` has friction, torque offset and spring by the names that a robot's friction model has.
A new law is a row here, and its name in `FRICTION_TERMS` of `jaxcslc.manipulator`. `CoupledTerm`
has the laws of two joints that share a motor's shaft.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxcslc.derivation import Coefficient
from jaxcslc.manipulator import STATIC_SLOPE, Coupling, Manipulator, RobotError

from ._input_term import JAX_FUNCTIONS, AbstractFunctions, AbstractInputTerm
from ._term import Coefficients, Joints, Regressor, content_hash


LOAD, DIRECTIONAL_LOAD = "load", "directional_load"
"""The kinds of friction that grows with the load, in a robot's friction model."""


Formula = Callable[[AbstractFunctions, Any, Any, Any], tuple[Any, ...]]


def _by_direction(functions: AbstractFunctions, x: Any) -> tuple[Any, ...]:
    return functions.positive(x), functions.negative(x)


def _directional_load(
    functions: AbstractFunctions, q: Any, qd: Any, torque: Any
) -> tuple[Any, ...]:
    del q
    sign = functions.sign(qd)
    power = sign * torque
    return sign * functions.positive(power), -sign * functions.negative(power)


class LawProperties(NamedTuple):
    """A row of the table of joint laws: names, meaning, units and formula.

    **Attributes**

    - `kind`: the kind, as in a robot's friction model, and the group of the coefficients.
    - `symbols`: letters that names of coefficients begin with, one for each input.
    - `descriptions`: of the coefficient of each symbol, with `{}` for the number of the joint.
    - `units`: of revolute and of prismatic joints.
    - `formula`: from functions, position, velocity and a number that the law needs to what each
      coefficient is multiplied by.
    - `needs`: that number: `"slope"`, `"torque"` of links and motors, or empty.
    - `positive`: whether coefficients are positive by construction: friction opposes motion.
    - `part`: the sum of the equation of motion that it belongs to, `"friction"` or `"spring"`;
      `"load"` for what is no part of F(qd), since it has position and acceleration.
    - `directions`: of the inputs, as `("forwards", "backwards")`; empty for one input.
    """

    kind: str
    symbols: tuple[str, ...]
    descriptions: tuple[str, ...]
    units: tuple[str, str]
    formula: Formula
    needs: str = ""
    positive: bool = True
    part: str = "friction"
    directions: tuple[str, ...] = ()


_TORQUE, _BOTH_WAYS = ("N m", "N"), ("forwards", "backwards")
_VISCOUS, _DRY = "viscous friction of joint {}", "Coulomb friction of joint {}"
_LOADED = "friction of joint {} in proportion to its load"

# Beside viscous friction, those with the root and the square of the speed bend the line, and static
# friction is what is left beyond dry: their coefficients may have either sign.
_ROWS = (
    # Friction in proportion to velocity (Eqn. 2.5-3), and for either direction (Fig. 8.2-2).
    LawProperties(
        "viscous", ("kv",), (_VISCOUS,), ("N m s/rad", "N s/m"), lambda f, q, qd, _: (qd,)
    ),
    LawProperties(
        "asymmetric_viscous",
        ("kvp", "kvn"),
        tuple(f"{_VISCOUS}, {way}" for way in _BOTH_WAYS),
        ("N m s/rad", "N s/m"),
        lambda f, q, qd, _: _by_direction(f, qd),
        directions=_BOTH_WAYS,
    ),
    # Coulomb friction, in proportion to the sign of velocity (Eqn. 2.5-3).
    LawProperties("dry", ("kd",), (_DRY,), _TORQUE, lambda f, q, qd, _: (f.sign(qd),)),
    LawProperties(
        "asymmetric_dry",
        ("kdp", "kdn"),
        tuple(f"{_DRY}, {way}" for way in _BOTH_WAYS),
        _TORQUE,
        lambda f, q, qd, _: _by_direction(f, f.sign(qd)),
        directions=_BOTH_WAYS,
    ),
    # Static friction beyond dry friction, sign(qd) exp(-slope |qd|) (Eqn. 2.5-4, Fig. 8.2-1).
    LawProperties(
        "static",
        ("ks",),
        ("static friction of joint {} beyond Coulomb",),
        _TORQUE,
        lambda f, q, qd, slope: (f.sign(qd) * f.exp(-(f.absolute(qd) * slope)),),
        needs="slope",
        positive=False,
    ),
    LawProperties(
        "root",
        ("kr",),
        ("friction of joint {} with the root of its speed",),
        ("N m (s/rad)^0.5", "N (s/m)^0.5"),
        lambda f, q, qd, _: (f.sign(qd) * f.sqrt(f.absolute(qd)),),
        positive=False,
    ),
    # Fans, seals in oil, fluid in hoses.
    LawProperties(
        "quadratic",
        ("kq",),
        ("friction of joint {} with the square of its speed",),
        ("N m (s/rad)^2", "N (s/m)^2"),
        lambda f, q, qd, _: (qd * f.absolute(qd),),
        positive=False,
    ),
    LawProperties(
        "offset",
        ("ko",),
        ("torque offset of joint {}",),
        _TORQUE,
        lambda f, q, qd, _: (f.constant(1.0, qd),),
        positive=False,
    ),
    LawProperties(
        "spring",
        ("ke",),
        ("stiffness of joint {}",),
        ("N m/rad", "N/m"),
        lambda f, q, qd, _: (q,),
        part="spring",
    ),
    # Coulomb friction that grows with the load of the gears, alike or different for motion with the
    # rigid torque, which drives, and motion against it, which brakes.
    LawProperties(
        LOAD,
        ("kl",),
        (_LOADED,),
        ("1", "1"),
        lambda f, q, qd, torque: (f.sign(qd) * f.absolute(torque),),
        needs="torque",
        part=LOAD,
    ),
    LawProperties(
        DIRECTIONAL_LOAD,
        ("kld", "klb"),
        (f"{_LOADED}, where it drives it", f"{_LOADED}, where it brakes it"),
        ("1", "1"),
        _directional_load,
        needs="torque",
        part=LOAD,
        directions=("driving", "braking"),
    ),
)


class JointLaw(eqx.Module):
    """A law of a joint's torque by its own position and velocity: friction, offset, spring.

    **Attributes**

    - `properties`: its row of the table.
    - `slopes`: (n,) of static friction, of each joint that has a torque [s/rad or s/m]: a leaf that
      transformations see, since torque is not linear in it. Joints without static friction do not
      use theirs. None for other laws.
    """

    properties: LawProperties = eqx.field(static=True)
    slopes: Float[Array | np.ndarray, "..."] | None = None

    def inputs(self, functions: AbstractFunctions, q: Any, qd: Any) -> tuple[Any, ...]:
        """Return the factors of a joint's coefficients, one value per symbol.

        - `functions`: those that are not plain operators.
        - `q`, `qd`: position and velocity of a joint, of which `slopes` is the entry here.
        """
        return self.properties.formula(functions, q, qd, self.slopes)

    def with_slopes(self, slopes: Any) -> "JointLaw":
        """Return the law with other slopes, (n,); numbers become a NumPy array.

        **Raises** `ValueError` for a wrong number of slopes, and for numbers not above 0.
        """
        values = slopes if isinstance(slopes, Array) else np.array(slopes, float)
        if isinstance(values, np.ndarray) and not np.all((values > 0) & (values < np.inf)):
            raise ValueError(f"static slopes: expected numbers above 0, got {values.tolist()}")
        if self.slopes is not None and values.shape != self.slopes.shape:
            raise ValueError(
                f"static slopes: expected {self.slopes.shape[-1]}, one a joint, got {values.shape}"
            )
        return JointLaw(self.properties, values)

    def __hash__(self) -> int:
        return content_hash(self.properties, self.slopes)


JOINT_LAWS = {row.kind: JointLaw(row) for row in _ROWS}
"""The law of each kind of `jaxcslc.manipulator.FRICTION_TERMS`; that of static friction has no
slopes here."""


class AbstractJointTerm(AbstractInputTerm):
    """A law of the joints that have it, with coefficients of each joint's own.

    The coefficients are those of the first symbol, joint by joint, then those of the next.

    **Attributes**

    - `law`: the formula; `kind`: of the law.
    - `joints`: those that have it, from 0; `joint_count`: how many have torques: all that follow
      none.
    - `robot_joints`: which of the robot's they are; `robot_joint_count`: n.
    """

    law: eqx.AbstractVar[JointLaw]
    joints: eqx.AbstractVar[tuple[int, ...]]
    robot_joints: eqx.AbstractVar[tuple[int, ...]]
    robot_joint_count: eqx.AbstractVar[int]

    @abc.abstractmethod
    def _needed(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> Sequence[Any]:
        """Return what the law needs in addition to motion, one value per joint."""

    @abc.abstractmethod
    def _needed_of_all(self, q: Joints, qd: Joints, qdd: Joints) -> Joints | None:
        """Return the same of all joints as one array, (..., n)."""

    @property
    def keyword(self) -> str:
        return self.kind

    @property
    def parts(self) -> tuple[str, ...]:
        return (self.law.properties.part,)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return self.joints * len(self.law.properties.symbols)

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(range(self.size))

    @property
    def value_shape(self) -> tuple[int, ...]:
        directions = self.law.properties.directions
        return (self.robot_joint_count, *([len(directions)] if directions else ()))

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        directions = range(len(self.law.properties.directions))
        if not directions:
            return (self.robot_joints,)
        columns = tuple(column for column in directions for _ in self.joints)
        return self.robot_joints * len(directions), columns

    @property
    def value_meaning(self) -> str:
        directions = self.law.properties.directions
        return f"{' and '.join(directions)} of each joint" if directions else "one a joint"

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        needed, formula = self._needed(functions, q, qd, qdd), self.law.properties.formula
        values = [formula(functions, q[j], qd[j], needed[j]) for j in self.joints]
        return [value for of_symbol in zip(*values, strict=True) for value in of_symbol]

    def regressor(self, q: Joints, qd: Joints, qdd: Joints) -> Regressor:
        values = [x[..., np.array(self.joints)] for x in self._of_all_joints(q, qd, qdd)]
        return self._regressor(jnp.concatenate(values, axis=-1))

    def torque(self, k: Coefficients, q: Joints, qd: Joints, qdd: Joints) -> Joints:
        # Arrays of all joints: apart, they would be joined again at a third of the speed.
        values = self._of_all_joints(q, qd, qdd)
        of_joints = k.reshape(len(values), -1)
        if len(self.joints) < self.joint_count:
            zeros = jnp.zeros((len(values), self.joint_count), k.dtype)
            of_joints = zeros.at[:, np.array(self.joints)].set(of_joints)
        first, *others = (
            x * jnp.broadcast_to(row, x.shape) for x, row in zip(values, of_joints, strict=True)
        )
        return sum(others, first)

    def _of_all_joints(self, q: Joints, qd: Joints, qdd: Joints) -> tuple[Joints, ...]:
        needed = self._needed_of_all(q, qd, qdd)
        return self.law.properties.formula(JAX_FUNCTIONS, q, qd, needed)


class JointTerm(AbstractJointTerm):
    """A law of joints by their own motion: friction, torque offset, spring."""

    law: JointLaw
    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)
    robot_joints: tuple[int, ...] = eqx.field(static=True)
    robot_joint_count: int = eqx.field(static=True)

    @classmethod
    def of(cls, law: JointLaw, robot: Manipulator) -> "JointTerm":
        """Return the term of the robot's joints whose friction model names the law's kind.

        Static friction without slopes has the robot's, or `STATIC_SLOPE` if it has none.
        """
        if law.properties.needs == "slope" and law.slopes is None:
            slopes = np.array(robot.static_slopes or (STATIC_SLOPE,) * robot.joint_count, float)
            law = law.with_slopes(slopes[list(robot.independent_joints)])
        return cls(law=law, **joint_fields(law, robot))

    def with_slopes(self, slopes: Any) -> "JointTerm":
        """Return the term with other slopes: see `JointLaw.with_slopes`."""
        return dataclasses.replace(self, law=self.law.with_slopes(slopes))

    def _needed(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> Sequence[Any]:
        del q, qdd
        slopes = self.law.slopes
        if slopes is None:
            return [None] * self.joint_count
        return [functions.constant(slopes[j], qd[j]) for j in range(self.joint_count)]

    def _needed_of_all(self, q: Joints, qd: Joints, qdd: Joints) -> Joints | None:
        del q, qdd
        slopes = self.law.slopes
        return None if slopes is None else jnp.broadcast_to(jnp.asarray(slopes, qd.dtype), qd.shape)


def joint_fields(law: JointLaw, robot: Manipulator) -> dict[str, Any]:
    """Return the static fields of a term of the joints whose friction model names a law's kind."""
    kind, independent = law.properties.kind, robot.independent_joints
    has = [kind in robot.friction_per_joint[joint] for joint in independent]
    joints = tuple(i for i, one in enumerate(has) if one)
    robot_joints = tuple(independent[i] for i in joints)
    prismatic = tuple(robot.joints[joint].kind == "P" for joint in robot_joints)
    return {
        "kind": kind,
        "coefficients": _coefficients(law.properties, robot_joints, prismatic),
        "joints": joints,
        "joint_count": len(independent),
        "robot_joints": robot_joints,
        "robot_joint_count": robot.joint_count,
    }


@lru_cache(maxsize=256)  # coefficients are compared by identity
def _coefficients(
    law: LawProperties, joints: tuple[int, ...], prismatic: tuple[bool, ...]
) -> tuple[Coefficient, ...]:
    return tuple(
        Coefficient(
            f"{symbol}{joint + 1}",
            law.kind,
            description.format(joint + 1),
            law.units[slides],
            law.positive,
        )
        for symbol, description in zip(law.symbols, law.descriptions, strict=True)
        for joint, slides in zip(joints, prismatic, strict=True)
    )


# Of each kind: the letters of its coefficients' names, what they are, units for revolute and
# prismatic joints, and the sum of the equation of motion that it belongs to.
_KINDS = {
    "coupled_inertia": ("kcm", "inertia", ("kg m²", "kg"), "mass"),
    "coupled_viscous": ("kcv", "viscous friction", ("N m s/rad", "N s/m"), "friction"),
    "coupled_dry": ("kcd", "dry friction", ("N m", "N"), "friction"),
}


class CoupledTerm(AbstractInputTerm):
    """Torque that two joints share of a motor's shaft: inertia, viscous or Coulomb friction.

    The shaft of a pair turns by `q[first] + ratio * q[second]`.

    **Attributes**

    - `kind`: `"coupled_inertia"`, `"coupled_viscous"` or `"coupled_dry"`.
    - `pairs`: of joints that have torques, with one coefficient each; `joint_count`: how many.
    """

    kind: str = eqx.field(static=True)
    coefficients: tuple[Coefficient, ...] = eqx.field(static=True)
    pairs: tuple[Coupling, ...] = eqx.field(static=True)
    joint_count: int = eqx.field(static=True)

    @classmethod
    def from_robot(cls, robot: Manipulator) -> list["CoupledTerm"]:
        """Return one term of each kind, or none without coupled joints.

        **Raises** `RobotError` for a joint that follows another.
        """
        if not robot.coupled:
            return []
        prismatic = tuple(robot.joints[pair.first - 1].kind == "P" for pair in robot.coupled)
        number = {joint: i for i, joint in enumerate(robot.independent_joints)}
        for joint in (joint for pair in robot.coupled for joint in (pair.first, pair.second)):
            if joint - 1 not in number:
                raise RobotError(
                    f"coupled: joint {joint} ({robot.joint_names[joint - 1]}) follows another and"
                    " has no motor; expected joints that follow none"
                )
        pairs = tuple(
            Coupling(number[pair.first - 1] + 1, number[pair.second - 1] + 1, pair.ratio)
            for pair in robot.coupled
        )
        return [
            cls(
                kind=kind,
                coefficients=_coupled_coefficients(kind, robot.coupled, prismatic),
                pairs=pairs,
                joint_count=len(number),
            )
            for kind in _KINDS
        ]

    @property
    def keyword(self) -> str:
        return "coupled"

    @property
    def parts(self) -> tuple[str, ...]:
        return (_KINDS[self.kind][-1],)

    @property
    def input_joints(self) -> tuple[int, ...]:
        return tuple(joint - 1 for pair in self.pairs for joint in (pair.first, pair.second))

    @property
    def input_indices(self) -> tuple[int, ...]:
        return tuple(index for index in range(self.size) for _ in range(2))

    @property
    def value_shape(self) -> tuple[int, ...]:
        return (len(self.pairs), len(_KINDS))

    @property
    def value_index(self) -> tuple[tuple[int, ...], ...]:
        return tuple(range(self.size)), (list(_KINDS).index(self.kind),) * self.size

    @property
    def value_meaning(self) -> str:
        return "inertia, viscous and dry of each pair"

    def inputs(
        self, functions: AbstractFunctions, q: Sequence[Any], qd: Sequence[Any], qdd: Sequence[Any]
    ) -> list[Any]:
        """Return the shaft's additional inputs of both joints of each pair.

        The shaft's inertia and viscous friction enter joint i's torque by its own motion too; that
        part cannot be told from the joint's own motor and friction, and is left to them.
        """
        del q
        values: list[Any] = []
        for pair in self.pairs:
            i, j, ratio = pair.first - 1, pair.second - 1, float(pair.ratio)
            if self.kind == "coupled_dry":
                sign = functions.sign(qd[i] + ratio * qd[j])
                values += [sign, ratio * sign]
            else:
                motion = qdd if self.kind == "coupled_inertia" else qd
                values += [ratio * motion[j], ratio * motion[i]]
        return values


# Made once for some pairs: coefficients are compared by identity.
@lru_cache(maxsize=256)
def _coupled_coefficients(
    kind: str, pairs: tuple[Coupling, ...], prismatic: tuple[bool, ...]
) -> tuple[Coefficient, ...]:
    letters, quantity, units, _ = _KINDS[kind]
    return tuple(
        Coefficient(
            f"{letters}{pair.first}_{pair.second}",
            kind,
            f"{quantity} that joints {pair.first} and {pair.second} share",
            units[slides],
            positive=True,
        )
        for pair, slides in zip(pairs, prismatic, strict=True)
    )
