from collections.abc import Sequence

from ..motion import Patterns
from ..network import CSLC
from .solver import Errors, Held, Identification, JointWeights, Known, Loss, checked, fit_patterns


def relearn(
    network: CSLC,
    patterns: Patterns,
    known: Known,
    *,
    groups: Sequence[str] = ("viscous", "dry"),
    cutoff: float | None = None,
    joint_weights: JointWeights = "equal",
    loss: Loss = "squared",
    errors: Errors = "independent",
    rcond: float | None = None,
    throw: bool = True,
) -> Identification:
    """Fits some of the coefficients and holds the others at what is known of them (thesis 5.2.4).

    After a change of friction alone, as by cleaning bearings, friction alone needs to be learnt
    again: from a recording far too short for all coefficients, over which a fit of all would
    spread its errors. What the held coefficients k_h explain is taken off the torque,

        regressor_f @ k_f = torque - regressor_h @ k_h,

    at the level of factors: nothing but the fitted columns is solved for.

    **Arguments**

    - `known`: an `Identification` of the same network, or its (p,) coefficients. Its last
      coefficients may be missing if they are all fitted, as for a payload.
    - `groups`: what to fit, words that are some `Coefficient.group` (`"viscous"`, `"dry"`,
      `"static"`, `"payload"`, ...) or names of single coefficients.
    - the others: as for `least_squares`. Joint weights of `"residual"` also weigh errors of the
      held coefficients, which are part of the residual.

    **Returns** an `Identification` of all p coefficients. The held ones are as before, standard
    errors included. Errors of the others are those of this recording's noise and, if `known` is
    an `Identification`, what the held ones' errors do to them; the two are independent if the
    recordings are. Vectors count as exact. `rank`, `condition` and `undetermined` are of the
    fitted part; `freedom` is the less of the two fits'. Where the patterns leave a choice, the
    change from `known` is the least one, as that of a joint which stands still. A combination
    that `known` left undetermined is held at the one that it chose. Jit and vmap as for
    `least_squares`.

    **Raises**

    - `ValueError`: for groups that are none and for another network's coefficients; or as
      `least_squares`.
    - `RuntimeError`: as `least_squares`.

    >>> import jax.numpy as jnp, numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.linspace(0, 0.3, 30)[:, None]
    >>> q, qd, qdd, everything = np.sin(t), np.cos(t), -np.sin(t), np.ones(t.shape, bool)
    >>> before = jnp.array([0.5, 0.3, -0.1, 0.2, 0.05])
    >>> cleaned = before.at[-2:].set(jnp.array([0.1, 0.04]))
    >>> torque = network.torque(cleaned, q, qd, qdd)
    >>> patterns = jc.Patterns(t[:, 0], q, qd, qdd, torque, everything, everything)
    >>> bool(jnp.allclose(jc.relearn(network, patterns, before).k, cleaned))
    True
    """
    return checked(
        fit_patterns(
            network,
            patterns,
            cutoff=cutoff,
            joint_weights=joint_weights,
            loss=loss,
            errors=errors,
            rcond=rcond,
            held=Held.of(network, known, groups),
        ),
        throw,
    )
