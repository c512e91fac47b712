"""Torque errors by recording and joint, and warnings of a fit."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from .._environment import array_namespace, require
from .._text_table import number_text, text_table
from ..friction import has_states
from ..least_squares import (
    MEANINGLESS_CONDITION,
    Identification,
    friction_averaged_at_rest,
    torque_of,
    traced,
)
from ..network import CSLC, AbstractLinearNetwork
from ..recordings import Patterns, Recording


Numbers = Array | np.ndarray


class ErrorTable(eqx.Module):
    """Torque errors of several coefficient vectors on the same patterns (Fig. 7.6-3).

    **Attributes**

    - `names`: of the vectors.
    - `mean_modulus`: (vectors, n), mean |error| of each joint over the unmasked samples, those in
      `Patterns.mask` [N m].
    - `rms`: (vectors, n), root mean square of the same errors [N m].
    - `epsilon`: (vectors,), mean error cost: half the root mean square over the joints of one
      pattern's errors, averaged over patterns (7.5) [N m]. Joints outside the mask of a pattern
      are excluded from its mean.
    - `rms_all_samples`: (vectors, n), root mean square error over all samples, masked ones
      included [N m].
    - `share_judged`: (n,) unmasked samples of each joint over all samples, from 0 to 1.
    - `unit`: of all errors; for a robot with joints of both kinds `"N m or N"`, joint by joint.
    - `kind`, `labels`: what the outputs are called, `"joint"` or `"equation"`, and their numbers or
      names; numbers if omitted.

    `print` shows the thesis's table, which `rows()` returns as data, and RMS errors below it.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> error, all_samples = jnp.array([[0.25]]), jnp.array([[0.75]])
    >>> print(
    ...     jc.ErrorTable(
    ...         ("fit",), mean_modulus=error, rms=error, epsilon=jnp.array([0.125]),
    ...         rms_all_samples=all_samples, share_judged=jnp.array([0.5]),
    ...     )
    ... )
    [N m]       fit
    mean |e1|  0.25
    mean ε     0.125
    <BLANKLINE>
    RMS [N m]   fit
    joint 1    0.25
    """

    names: tuple[str, ...] = eqx.field(static=True)
    mean_modulus: Float[Numbers, "vectors joints"]
    rms: Float[Numbers, "vectors joints"]
    epsilon: Float[Numbers, " vectors"]
    rms_all_samples: Float[Numbers, "vectors joints"]
    share_judged: Float[Numbers, " joints"]
    unit: str = eqx.field(static=True, default="N m")
    kind: str = eqx.field(static=True, default="joint")
    labels: tuple[str, ...] = eqx.field(static=True, default=())

    def rows(self) -> list[dict[str, float | str]]:
        """Return one row per joint and one for ε, or one per equation.

        There is one column per coefficient vector.
        """
        rows: list[dict[str, float | str]] = []
        for joint in range(self.mean_modulus.shape[1]):
            values = np.asarray(self.mean_modulus[:, joint]).tolist()
            label = self._label(joint)
            space = "" if label.isdigit() else " "
            rows.append(
                {"": f"mean |e{space}{label}|", **dict(zip(self.names, values, strict=True))}
            )
        if self.kind == "joint":  # equations of other systems have units of their own
            mean = np.asarray(self.epsilon).tolist()
            rows.append({"": "mean ε", **dict(zip(self.names, mean, strict=True))})
        return rows

    def _label(self, joint: int) -> str:
        return self.labels[joint] if self.labels else str(joint + 1)

    def to_pandas(self) -> Any:
        """`rows()` as a `pandas.DataFrame`, a column for each coefficient vector [N m]."""
        pandas = require("pandas", "tables")

        rows = self.rows()
        return pandas.DataFrame(
            {name: [row[name] for row in rows] for name in self.names},
            index=pandas.Index([row[""] for row in rows], name="error"),
        )

    def __str__(self) -> str:
        errors = text_table(
            [f"[{self.unit}]" if self.unit else "error", *self.names],
            [[str(row[""]), *(f"{row[name]:.4g}" for name in self.names)] for row in self.rows()],
        )
        unit = f" [{self.unit}]" if self.unit else ""
        labels = [self._label(joint) for joint in range(len(self.share_judged))]
        cells = [
            [f"{self.kind} {label}" if label.isdigit() else label, *(f"{x:.4g}" for x in rms)]
            for label, rms in zip(labels, np.asarray(self.rms).T, strict=True)
        ]
        return f"{errors}\n\n{text_table([f'RMS{unit}', *self.names], cells)}"


def compare(
    network: AbstractLinearNetwork,
    patterns: Patterns,
    vectors: Mapping[str, Float[Numbers, " k"]],
) -> ErrorTable:
    """Compares how well several coefficient vectors predict the torque of the same patterns.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion and torque; pairs outside `patterns.mask` are excluded.
    - `vectors`: (p,) coefficients by name.

    **Returns** an `ErrorTable`.

    >>> import numpy as np, jaxcslc as jc
    >>> network, k = jc.derive(jc.examples.pendulum()), np.array([0.5, 0.3, -0.1, 0.2, 0.05])
    >>> patterns = jc.examples.swing(network, k)
    >>> float(jc.compare(network, patterns, {"true": k}).epsilon[0].round(9))
    0.0
    """
    names = tuple(vectors)
    listed = [torque_errors(network, patterns, vectors[name]) for name in names]
    xp = array_namespace(*listed)
    errors, mask = xp.stack(listed), xp.asarray(patterns.mask, bool)
    mean_modulus, rms, epsilon = _over_judged(errors, mask)
    return ErrorTable(
        names,
        mean_modulus,
        rms,
        epsilon,
        rms_all_samples=xp.sqrt(xp.mean(errors**2, axis=1)),
        share_judged=xp.mean(mask, axis=0, dtype=errors.dtype),
        unit=" or ".join(sorted({*network.output_units} - {""}, key=len, reverse=True)),
        kind=network.output_kind,
        labels=network.output_labels,
    )


def _over_judged(
    errors: Float[Numbers, "vectors samples joints"], mask: Bool[Numbers, "samples joints"]
) -> tuple[
    Float[Numbers, "vectors joints"], Float[Numbers, "vectors joints"], Float[Numbers, " vectors"]
]:
    xp = array_namespace(errors, mask)
    judged = xp.broadcast_to(mask, errors.shape)
    kept = xp.where(judged, errors, 0.0)
    per_joint = xp.maximum(xp.sum(judged, axis=1), 1)
    per_pattern = xp.sum(judged, axis=2)
    cost = 0.5 * xp.sqrt(xp.sum(kept**2, axis=2) / xp.maximum(per_pattern, 1))
    some = per_pattern > 0
    return (
        xp.sum(xp.abs(kept), axis=1) / per_joint,
        xp.sqrt(xp.sum(kept**2, axis=1) / per_joint),
        xp.sum(xp.where(some, cost, 0.0), axis=1) / xp.maximum(xp.sum(some, axis=1), 1),
    )


def predicted_torque(
    network: AbstractLinearNetwork, patterns: Patterns, k: Float[Numbers, " k"]
) -> Float[Numbers, "samples joints"]:
    """Compute the torque that coefficients predict along a motion.

    The network's torque; of joints that stand still, with the mean of the friction of the motion
    before and of that after (`friction_averaged_at_rest`).

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: motion in order of time.
    - `k`: (p,) coefficients.

    **Returns** torques (samples, n) [N m or N].

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.report import predicted_torque
    >>> robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(robot.with_friction("dry"), lengths="numeric")
    >>> qd = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0])[:, None]
    >>> zeros, pairs = 0 * qd, np.ones(qd.shape, bool)
    >>> patterns = jc.Patterns(np.arange(8.0), zeros, qd, zeros, zeros, pairs, pairs)
    >>> predicted_torque(network, patterns, np.array([0.5, 2.0]))[:, 0].tolist()
    [2.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0]
    """
    if not (isinstance(network, CSLC) and network.layout.friction.size):
        return _torque(network, patterns, k)

    def of_samples(qd: Any, rows: Any) -> Any:
        of_rows = jax.tree.map(lambda values: values[rows], patterns)
        return _torque(network, dataclasses.replace(of_rows, qd=qd), k)

    states = has_states(network)  # they are along all of the motion
    return friction_averaged_at_rest(of_samples, patterns.qd, sample_by_sample=not states)


def _torque(
    network: AbstractLinearNetwork, patterns: Patterns, k: Float[Numbers, " k"]
) -> Float[Numbers, "samples joints"]:
    if traced((network, patterns, k)):
        return network.torque(k, patterns.q, patterns.qd, patterns.qdd)
    return torque_of(network, patterns, k)


def torque_errors(
    network: AbstractLinearNetwork, patterns: Patterns, k: Float[Numbers, " k"]
) -> Float[Numbers, "samples joints"]:
    """Measured minus predicted torque of every pair (samples, n) [N m]."""
    predicted = predicted_torque(network, patterns, k)
    return array_namespace(predicted).asarray(patterns.torque) - predicted


def fit_warnings(
    network: AbstractLinearNetwork, recording: Recording, fit: Identification, errors: ErrorTable
) -> Iterator[str]:
    """Warnings about a fit, its training recording and how it explains the recorded torque.

    **Arguments**

    - `network`: n joints.
    - `recording`: of n joints, that was fitted.
    - `fit`: to that recording.
    - `errors`: of the fit, on that recording.

    **Returns** one sentence for a meaningless condition number, and one for each joint that does
    not move, whose torque is constant, or of whose torque's variance the fit explains less than
    half, as with a wrong unit.
    """
    yield from condition_warning(fit)
    names = network.output_names
    for joint in np.flatnonzero(np.ptp(recording.position, axis=0) == 0):
        yield (
            f"{names[joint]} does not move: coefficients that only its motion shows are not"
            " determined"
        )
    deviation = np.std(recording.torque, axis=0)
    rows = zip(names, np.asarray(errors.rms[0]), deviation, network.output_units, strict=True)
    for name, rms, size, unit in rows:
        if size == 0:
            yield f"{name}: the measured torque is constant"
        elif rms > np.sqrt(0.5) * size:
            yield (
                f"{name}: training RMS {rms:.3g} {unit}, torque standard deviation"
                f" {size:.3g} {unit}: the model explains less than half of the variance; check"
                " units (rad, N m) and the signs of positions and torques"
            )


def condition_warning(fit: Identification) -> Iterator[str]:
    """Return a sentence about a condition number that makes every coefficient meaningless."""
    if not bool(fit.meaningful):
        yield (
            f"condition number {number_text(float(fit.condition), 2)} exceeds"
            f" {MEANINGLESS_CONDITION:.0g}: no coefficient is well determined, whatever its"
            " standard error; use a motion that excites more, or fewer terms"
        )
