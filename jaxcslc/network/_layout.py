from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Array, Int, Shaped

from ..derivation import Coefficient
from .terms import LOAD, AbstractTerm


@dataclass(frozen=True, eq=False)  # one object for the same terms
class Layout:
    """Which entries of `k` are which coefficients: `network.layout`, the only place that knows.

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
    >>> layout.size, layout.inertial, layout.of("dry")
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
        return self.of("rigid_body")

    @property
    def payload(self) -> slice:
        """The payload's ten; empty, at the end, without a payload."""
        return self.of("payload") if "payload" in self.kinds else slice(self.size, self.size)

    @property
    def unloaded(self) -> slice:
        """Everything but the payload: the coefficients of the same robot without one."""
        return slice(0, self.payload.start)

    def of(self, term: AbstractTerm | str) -> slice:
        """The coefficients of a term, or of the term of a kind.

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
                selected[self.of(name)] = True
                continue
            mask = np.array([name in (c.name, c.group) for c in self.coefficients], bool)
            if not mask.any():
                raise ValueError(
                    f"{name!r} is no coefficient and no group; expected some of"
                    f" {', '.join(self.groups)}, and names, {self.names[0]} to {self.names[-1]}"
                )
            selected |= mask
        return np.flatnonzero(selected)

    def split(
        self, k: Shaped[Array | np.ndarray, "*batch coefficients"]
    ) -> tuple[Shaped[Array | np.ndarray, "*batch _"], ...]:
        """The coefficients of each term, in the order of `k`."""
        return tuple(k[..., part] for part in self.slices)


def layout_of(terms: Iterable[AbstractTerm]) -> Layout:
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
