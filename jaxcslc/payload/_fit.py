"""Fit of a payload to patterns: ten parameters, mass, centre, tensor, and their errors."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Array, Bool, Float, Int

from ..bodies import body_of, link_of, nearest_body
from ..least_squares import Identification, LeastSquares, Previous, reidentify
from ..manipulator import LinkParameters
from ..network import CSLC, PAYLOAD
from ..recordings import Patterns


PHYSICAL = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Quantities that `PayloadFit.physical` lists: mass, centre of gravity, inertia tensor there."""

_UNITS = (*["kg"], *["m"] * 3, *["kg m²"] * 6)
# Entries of a Jacobian below this part of the largest are zero.
_NEGLIGIBLE = 1e-12


class PayloadFit(eqx.Module):
    """Result of a fit with a payload, in the frame of the link that carries it.

    **Attributes**

    - `fit`: all coefficients, the arm's and then the payload's ten.
    - `possible`: the body that can exist nearest to the estimate, in standard errors; None if
      none was found.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric").with_payload()
    >>> k = np.zeros(network.size)
    >>> k[network.layout.payload] = 0.01, 0.01, 0.02, 0, 0, 0, 0.1, 0, 0, 1
    >>> patterns = jc.examples.swing(network, k, samples=500)
    >>> fit = jc.fit_payload(network, patterns, previous=np.zeros(network.layout.unloaded.stop))
    >>> print(fit.unidentifiable[0])
    pIxx: nothing in the patterns depends on it
    >>> round(float(fit.parameters[6]), 6)  # first moment along x
    0.1
    """

    fit: Identification
    possible: LinkParameters | None

    @property
    def _indices(self) -> Int[np.ndarray, "10"]:
        """Indices of the payload's coefficients among those of the fit."""
        return np.array([self.fit.names.index(name) for name in PAYLOAD])

    @property
    def parameters(self) -> Float[Array, "10"]:
        """Inertia about the frame's origin, first moments and mass [kg m², kg m, kg].

        In the order of `jaxcslc.derivation.BODY`.
        """
        return self.fit.k[self._indices]

    @property
    def covariance(self) -> Float[Array, "10 10"]:
        """Covariance of `parameters`."""
        return self.fit.covariance[np.ix_(self._indices, self._indices)]

    @property
    def standard_error(self) -> Float[Array, "10"]:
        """Standard error of `parameters`; infinite where the motion does not determine them."""
        return self.fit.standard_error[self._indices]

    @property
    def determined(self) -> Bool[Array, "10"]:
        """True for each of `parameters` that the motion determines by itself."""
        return self.fit.determined[self._indices]

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Sentences about what the motion does not determine of the payload."""
        return tuple(
            sentence
            for sentence in self.fit.unidentifiable
            if any(name in PAYLOAD for name in sentence.partition(":")[0].split(", "))
        )

    @property
    def mass(self) -> Float[Array, ""]:
        """Mass [kg]."""
        return self.physical[0]

    @property
    def centre_of_gravity(self) -> Float[Array, "3"]:
        """Centre of gravity, (3,) [m]."""
        return self.physical[1:4]

    @property
    def inertia(self) -> Float[Array, "3 3"]:
        """Inertia tensor at the centre of gravity, (3, 3) [kg m²]."""
        xx, yy, zz, xy, xz, yz = self.physical[4:]
        return jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def physical(self) -> Float[Array, "10"]:
        """Mass, centre of gravity and the tensor there, as `PHYSICAL` lists them."""
        return _physical(self.parameters)

    @property
    def physical_covariance(self) -> Float[Array, "10 10"]:
        """Covariance of `physical`, to first order in the errors (delta method)."""
        slope = _slope(self.parameters)
        return slope @ self.covariance @ slope.T

    @property
    def physical_error(self) -> Float[Array, "10"]:
        """Standard deviation of each of `physical`; infinite where undetermined."""
        slope = jnp.abs(_slope(self.parameters))
        enters = slope > _NEGLIGIBLE * jnp.max(slope, axis=1, keepdims=True)
        open_ = jnp.any(enters & ~self.determined[None, :], axis=1)
        error = jnp.sqrt(jnp.diag(self.physical_covariance))
        # Of a mass of which nothing is known, least squares makes zero, and of the rest NaN.
        return jnp.where(open_ | jnp.isnan(error), jnp.inf, error)

    def confidence_interval(self, level: float = 0.95) -> Float[np.ndarray, "10 2"]:
        """Lower and upper end for each of `parameters`, from Student's t.

        **Raises** `ValueError` for a level that is not between 0 and 1.
        """
        return self.fit.confidence_interval(level)[self._indices]

    def physical_interval(self, level: float = 0.95) -> Float[np.ndarray, "10 2"]:
        """Return the confidence interval of each of `physical`, to first order.

        Trust those of centre and tensor as long as the mass is known to some 20 %.

        **Raises** as `confidence_interval`.
        """
        if not 0.0 < level < 1.0:
            raise ValueError(f"level is {level}; expected more than 0 and less than 1")
        quantile = scipy.special.stdtrit(float(self.fit.degrees_of_freedom), 0.5 + 0.5 * level)
        half = float(quantile) * np.asarray(self.physical_error)
        value = np.asarray(self.physical)
        return np.stack([value - half, value + half], axis=-1)

    def rows(self, level: float = 0.95) -> list[dict[str, Any]]:
        """Return one row per entry of `physical`: name, unit, value, error, interval, possible.

        What is not determined has no value (NaN), and an interval without ends.
        """
        error = np.asarray(self.physical_error)
        known = np.isfinite(error)
        with np.errstate(invalid="ignore"):  # infinite centre less infinite error
            interval = np.where(known[:, None], self.physical_interval(level), [-np.inf, np.inf])
        nearest = np.full(10, np.nan)
        if self.possible is not None:
            nearest = np.asarray(_physical(jnp.asarray(body_of(self.possible))))
        value = np.where(known, np.asarray(self.physical), np.nan)
        columns = np.column_stack([value, error, interval, nearest]).tolist()
        keys = ("name", "unit", "value", "standard_error", "low", "high", "possible")
        return [
            dict(zip(keys, (name, unit, *row), strict=True))
            for name, unit, row in zip(PHYSICAL, _UNITS, columns, strict=True)
        ]

    def document(self, level: float = 0.95) -> dict[str, Any]:
        """Return the whole fit as plain data, `rows` by name."""
        return {
            "parameters": dict(zip(PAYLOAD, np.asarray(self.parameters).tolist(), strict=True)),
            "covariance": np.asarray(self.covariance).tolist(),
            "level": level,
            "physical": {row.pop("name"): row for row in self.rows(level)},
            "unidentifiable": list(self.unidentifiable),
        }

    def __repr__(self) -> str:
        value, error = np.asarray(self.physical), np.asarray(self.physical_error)
        centre = ", ".join(
            f"{1e3 * r:.3g} ± {1e3 * e:.2g}" for r, e in zip(value[1:4], error[1:4], strict=True)
        )
        return f"PayloadFit({value[0]:.4g} ± {error[0]:.2g} kg, centre [{centre}] mm)"


@jax.jit
def _physical(body: Float[Array, "10"]) -> Float[Array, "10"]:
    mass, moment = body[9], body[6:9]
    centre = moment / mass
    x, y, z = moment
    shift = jnp.stack([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])
    return jnp.concatenate([mass[None], centre, body[:6] - shift / mass])


_slope = jax.jit(jax.jacfwd(_physical))


def fit_payload(
    network: CSLC,
    loaded: Patterns,
    unloaded: Patterns | None = None,
    previous: Previous | None = None,
    *,
    solver: LeastSquares | None = None,
    throw: bool = True,
) -> PayloadFit:
    """Fit the ten inertial parameters of a payload to patterns of the loaded arm (thesis 8.2.4).

    A payload and the link that carries it are one rigid body: a recording of the loaded arm alone
    cannot tell them apart. What the arm weighs without it must come from elsewhere, so one of two
    more things is needed:

    - `unloaded`, a recording of the arm without it: the coefficients of both are fitted to both
      recordings together. Payload columns of the unloaded one are zero.
    - `previous`, an earlier identification of the arm, whose coefficients stay fixed
      (`reidentify(..., groups=("payload",))`). If it is an `Identification`, its uncertainty
      counts: the payload's covariance includes what errors of the arm's coefficients do to it.

    The payload is in the frame of the link that carries it, the last one unless the network says
    otherwise (`with_payload`). Friction that changes with the load, and an arm whose friction has
    changed since it was identified, are taken for payload as far as they look like one.

    **Arguments**

    - `network`: of the arm, with or without payload.
    - `loaded`, `unloaded`: patterns (samples, n).
    - `previous`: an `Identification` of the arm, or its coefficients, which then count as exact.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.
    - `throw`: as of `LeastSquares.fit`.

    **Returns** a `PayloadFit`. Runs on the host; with `unloaded` it keeps the equations of both
    recordings in memory.

    **Raises**

    - `ValueError`: unless one of `unloaded` and `previous` is passed; for another network's
      coefficients; or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot).with_payload()
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, payload=body)
    >>> k = np.asarray(k)
    >>> patterns, arm = jc.examples.swing(network, k), k[network.layout.unloaded]
    >>> fit = jc.fit_payload(network, patterns, previous=arm)
    >>> round(float(fit.mass), 6), np.round(fit.centre_of_gravity, 6).tolist()
    (1.5, [0.02, 0.0, 0.1])
    """
    if unloaded is not None and previous is not None:
        raise ValueError("fit_payload: got both unloaded and previous; expected one of them")
    if unloaded is None and previous is None:
        raise ValueError(
            "fit_payload: a loaded recording alone cannot tell payload and last link apart;"
            " expected one of unloaded and previous"
        )
    whole = network.with_payload() if network.payload is None else network
    solver = solver or LeastSquares()
    if previous is not None:
        fit = reidentify(whole, loaded, previous, groups=("payload",), solver=solver, throw=throw)
    else:
        assert unloaded is not None
        payload = whole.layout.indices("payload").tolist()
        alone = solver.equations(whole, unloaded).without(payload)
        both = solver.equations(whole, loaded).followed_by(alone, loaded.samples)
        fit = solver.fit_equations(both, loaded.samples + unloaded.samples, throw=throw)
    columns = whole.layout.payload
    covariance = np.asarray(fit.independent_covariance)[columns, columns]
    body: np.ndarray | None = np.asarray(fit.k)[columns]
    if np.isfinite(covariance).all() and np.isfinite(body).all():
        body = nearest_body(body, covariance, np.asarray(fit.undetermined)[:, columns])
    else:
        body = None
    return PayloadFit(fit, None if body is None else link_of(body))
