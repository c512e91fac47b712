from collections.abc import Sequence

from ..motion import Patterns
from ..network import AbstractLinearNetwork
from .solver import Fixed, Identification, LeastSquares, Previous


def reidentify(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    previous: Previous,
    *,
    groups: Sequence[str] = ("viscous", "dry"),
    solver: LeastSquares | None = None,
    throw: bool = True,
) -> Identification:
    """Fits some coefficients and keeps the others at their previous values (thesis 5.2.4).

    A change of friction alone, as by cleaning bearings, needs friction alone to be re-identified:
    from a recording far too short for all coefficients, over which a fit of all would spread its
    errors. The torque of the fixed coefficients k_f is taken off the measured torque,

        regressor_free @ k_free = torque - regressor_f @ k_f,

    at the level of factors: only the free columns are solved for.

    **Arguments**

    - `previous`: an `Identification` of the same network, or its (p,) coefficients. Its last
      coefficients may be missing if they are all fitted, as for a payload.
    - `groups`: what to fit, any `Coefficient.group` (`"viscous"`, `"dry"`, `"static"`,
      `"payload"`, ...) or names of single coefficients.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None. Joint weights of
      `"residual"` also weigh errors of the fixed coefficients, which are part of the residual.
    - `throw`: as of `LeastSquares.fit`.

    **Returns** an `Identification` of all p coefficients. The fixed ones are as before, standard
    errors included. Errors of the others are those of this recording's noise and, if `previous` is
    an `Identification`, what errors of the fixed coefficients do to them; the two are independent
    if the recordings are. Vectors count as exact. `rank`, `condition` and `undetermined` are of
    the fitted part; `degrees_of_freedom` is the smaller of the two fits'. Where the patterns leave
    a choice, the change from `previous` is the least one, as for a joint that stands still. A
    combination that `previous` left undetermined keeps the value that it had. Jit and vmap as for
    `LeastSquares.fit`.

    **Raises**

    - `ValueError`: for groups that are none and for another network's coefficients; or as
      `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.linspace(0, 0.3, 30)[:, None]
    >>> q, qd, qdd, mask = np.sin(t), np.cos(t), -np.sin(t), np.ones(t.shape, bool)
    >>> before = jnp.array([0.5, 0.3, -0.1, 0.2, 0.05])
    >>> cleaned = before.at[-2:].set(jnp.array([0.1, 0.04]))
    >>> torque = network.torque(cleaned, q, qd, qdd)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, mask, mask)
    >>> bool(jnp.allclose(jc.reidentify(network, patterns, before).k, cleaned))
    True
    """
    fixed = Fixed.except_for(network, previous, groups)
    return (solver or LeastSquares()).fit(network, patterns, fixed, throw)
