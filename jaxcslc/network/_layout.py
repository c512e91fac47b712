"""Layout of `k`: the assignment of its entries, and their values for known link parameters."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int, Shaped

from ..derivation import Algebra, Coefficient, InertialTerm, constant_values
from ..manipulator import LinkParameters
from .terms import LOAD, AbstractInputTerm, AbstractManipulatorTerm, AbstractTerm


# Known numbers that differ by rounding only: relative, and of those that are 0 [kg or m].
_ALIKE, _NOTHING = 1e-9, 1e-12
_AXES = {"x": 0, "y": 1, "z": 2}


_NO_BODY = LinkParameters(0.0, np.zeros(3), np.zeros((3, 3)))


def coefficient_values(
    algebra: Algebra,
    terms: Sequence[AbstractManipulatorTerm],
    links: Sequence[LinkParameters],
    friction: Mapping[str, Any],
    payload: LinkParameters | None,
) -> Float[Array, " coefficients"]:
    """Every coefficient of a sum of terms: see `CSLC.coefficients_from`.

    - `friction`: values by `AbstractInputTerm.keyword`.
    - `payload`: the body; None for an empty gripper.

    Numbers are computed in NumPy: JAX would compile a program for every sum of a few of them.
    """
    n = algebra.robot.joint_count
    if len(links) != n:
        raise ValueError(f"links: expected {n} entries, one a joint, got {len(links)}")
    links, payload = _as_numpy(list(links)), _as_numpy(payload)
    _check_known(algebra, links)
    _check_keywords([term for term in terms if isinstance(term, AbstractInputTerm)], friction)
    parts: list[Any] = []
    for term in terms:
        if isinstance(term, AbstractInputTerm):
            parts.append(_input_values(term, friction))
        elif term.kind == "payload":
            parts.append(_expression_values(term.coefficients, [payload or _NO_BODY] * n, {}))
        else:
            constants = constant_values(algebra.robot) if algebra.lengths != "numeric" else {}
            parts.append(_expression_values(term.coefficients, links, constants))
    if any(isinstance(part, Tracer) for part in parts):
        return jnp.concatenate([jnp.asarray(part, jnp.result_type(float)) for part in parts])
    return jnp.asarray(np.concatenate(parts), jnp.result_type(float))


def _check_known(algebra: Algebra, links: Sequence[LinkParameters]) -> None:
    """**Raises** `ValueError` for links that differ from what the algebra has as numbers."""
    for number, (link, inertia) in enumerate(zip(links, algebra.robot.inertia, strict=True), 1):
        pairs = ((link.mass, inertia.mass), (link.centre_of_gravity, inertia.centre))
        for name, (value, known) in zip(("mass", "centre of gravity"), pairs, strict=True):
            if known is None or isinstance(value, Tracer):
                continue
            if not np.allclose(value, known, rtol=_ALIKE, atol=_NOTHING):
                raise ValueError(
                    f"links: link {number} has {name} {np.asarray(value).tolist()}; the network has"
                    f" the known number {np.asarray(known).tolist()}"
                )


def _as_numpy(values: Any) -> Any:
    """Return the pytree with NumPy arrays, unless JAX is tracing it."""
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values)):
        return values
    return jax.tree.map(np.asarray, values)


def _expression_values(
    coefficients: Sequence[Coefficient],
    links: Sequence[LinkParameters],
    constants: Mapping[str, float],
) -> Float[Array | np.ndarray, " coefficients"]:
    """The expressions of inertial coefficients for these links and named constants."""
    products: dict[InertialTerm, Any] = {}
    values: list[Any] = []
    for coefficient in coefficients:
        total: Any = np.float64(0.0)
        for addend in coefficient.addends:
            if addend.term not in products:
                products[addend.term] = _product(addend.term, links)
            factor = float(addend.factor)
            for name, power in addend.constants:
                factor *= constants[name] ** power
            total = total + factor * products[addend.term]
        values.append(total)
    traced = any(isinstance(value, Tracer) for value in values)
    return jnp.stack(values) if traced else np.array(values, np.float64)


def _product(term: InertialTerm, links: Sequence[LinkParameters]) -> Any:
    """Compute one product of link parameters."""
    link = links[term.link]
    value: Any = np.float64(1.0)
    for factor in term.factors:
        if factor == "motor":
            value = value * link.motor_inertia
        elif factor == "m":
            value = value * link.mass
        elif factor[0] == "r":
            value = value * link.centre_of_gravity[_AXES[factor[1]]]
        else:
            tensor = link.inertia if term.central else link.inertia_at_frame
            value = value * tensor[_AXES[factor[1]], _AXES[factor[2]]]
    return value


def _as_array(values: Any) -> Any:
    """An array of JAX where JAX is tracing, and one of NumPy where there are numbers."""
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))
    return jnp.asarray(values) if traced else np.asarray(values, np.float64)


def _check_keywords(terms: Sequence[AbstractInputTerm], values: Mapping[str, Any]) -> None:
    """**Raises** `ValueError` for values, not None, that no term has."""
    keywords = tuple(dict.fromkeys(term.keyword for term in terms))
    for keyword, value in values.items():
        if value is not None and keyword not in keywords:
            raise ValueError(
                f"{keyword}: the network has no such friction term; it has"
                f" {', '.join(keywords) or 'none'}"
            )


def _input_values(term: AbstractInputTerm, values: Mapping[str, Any]) -> Any:
    """The coefficients of a term, from values by keyword; zeros where there are none.

    **Raises** `ValueError` for a wrong shape, and for numbers, not 0, of joints without the term.
    """
    keyword, shape = term.keyword, term.value_shape
    array = values.get(keyword)
    array = np.zeros(shape) if array is None else _as_array(array)
    if array.shape != shape:
        raise ValueError(
            f"{keyword}: expected {' by '.join(map(str, shape))} values, {term.value_meaning},"
            f" got {array.shape}"
        )
    if not isinstance(array, Tracer):
        for joint in sorted(set(range(shape[0])) - set(term.value_index[0])):
            if np.any(np.asarray(array[joint]) != 0):
                raise ValueError(f"{keyword}: joint {joint + 1} has no such friction term")
    return array[tuple(np.array(index) for index in term.value_index)]


@dataclass(frozen=True, eq=False)  # one object for the same terms
class Layout:
    """Assignment of the entries of `k` to terms and coefficients (`network.layout`).

    No other object knows it.

    The terms of a network follow each other in `k`, the rigid body's coefficients first and those
    of a payload last.

    **Attributes**

    - `kinds`: of the terms, in the order of `k`.
    - `slices`: of each term's coefficients.
    - `coefficients`: in the order of `k`.
    - `friction`: (f,) indices of what belongs to friction, torque offsets included. Springs and
      the inertia that coupled joints share do not.

    >>> import jaxcslc as jc
    >>> layout = jc.derive(jc.puma560()).layout
    >>> layout.size, layout.inertial, layout.term_slice("dry")
    (43, slice(0, 31, None), slice(37, 43, None))
    >>> layout.indices("dry", "kM3").tolist()
    [2, 37, 38, 39, 40, 41, 42]
    """

    kinds: tuple[str, ...]
    slices: tuple[slice, ...]
    coefficients: tuple[Coefficient, ...]
    friction: Int[np.ndarray, " friction"]

    @property
    def size(self) -> int:
        """Number of coefficients, p."""
        return len(self.coefficients)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(coefficient.name for coefficient in self.coefficients)

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of coefficients, in the order in which they begin."""
        return tuple(dict.fromkeys(coefficient.group for coefficient in self.coefficients))

    @property
    def inertial(self) -> slice:
        """The inertial coefficients of the robot, without a payload's."""
        return self.term_slice("rigid_body")

    @property
    def payload(self) -> slice:
        """The payload's ten; empty, at the end, without a payload."""
        return (
            self.term_slice("payload") if "payload" in self.kinds else slice(self.size, self.size)
        )

    @property
    def unloaded(self) -> slice:
        """Coefficients of the same robot without a payload."""
        return slice(0, self.payload.start)

    def term_slice(self, term: AbstractTerm | str) -> slice:
        """Return the coefficients of a term, or of the term of a kind.

        **Raises** `ValueError` if there is no such term.
        """
        kind = term if isinstance(term, str) else term.kind
        if kind not in self.kinds:
            raise ValueError(f"the network has no term {kind!r}; it has {', '.join(self.kinds)}")
        return self.slices[self.kinds.index(kind)]

    def indices(self, *selection: str) -> Int[np.ndarray, " _"]:
        """Indices of coefficients by name, group or kind of term, in ascending order.

        **Raises** `ValueError` for a name that is none of them.
        """
        selected = np.zeros(self.size, bool)
        for name in selection:
            if name in self.kinds:
                selected[self.term_slice(name)] = True
                continue
            mask = np.array([name in (c.name, c.group) for c in self.coefficients], bool)
            if not mask.any():
                raise ValueError(
                    f"{name!r} is neither a coefficient nor a group; expected some of"
                    f" {', '.join(self.groups)}, or names from {self.names[0]} to {self.names[-1]}"
                )
            selected |= mask
        return np.flatnonzero(selected)

    def split(
        self, k: Shaped[Array | np.ndarray, "*batch coefficients"]
    ) -> tuple[Shaped[Array | np.ndarray, "*batch _"], ...]:
        """Return the coefficients of each term, in the order of `k`."""
        return tuple(k[..., part] for part in self.slices)


def term_layout(terms: Iterable[AbstractTerm]) -> Layout:
    """The layout of a sum of terms."""
    return _layout(tuple((term.kind, term.parts, term.coefficients) for term in terms))


@lru_cache(maxsize=64)
def _layout(terms: tuple[tuple[str, tuple[str, ...], tuple[Coefficient, ...]], ...]) -> Layout:
    ends = np.cumsum([len(coefficients) for _, _, coefficients in terms]).tolist()
    slices = tuple(slice(a, b) for a, b in zip([0, *ends], ends, strict=False))
    friction = [
        np.arange(part.start, part.stop)
        for (_, parts, _), part in zip(terms, slices, strict=True)
        if {"friction", LOAD} & {*parts}
    ]
    indices = np.concatenate([np.zeros(0, int), *friction])
    indices.flags.writeable = False
    return Layout(
        tuple(kind for kind, _, _ in terms),
        slices,
        tuple(coefficient for _, _, coefficients in terms for coefficient in coefficients),
        indices,
    )
