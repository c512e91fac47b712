"""Simulated motion of a recording's arm, under its controller or with a correction.

Steps are those of `_simulation`.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..least_squares import Settings
from ..network import CSLC
from ..recordings import Derivatives, Recording, uniform_interval
from ._prediction import applied_torque
from ._simulation import State, held_step


# Simulated motion further off than the joint's span, and than this, is lost [rad or m].
_NEAR = 0.1


class AbstractSimulatedMotion(eqx.Module):
    """Simulator of the arm of a recording, for motion that is free of the encoders' noise.

    To add one, subclass this and implement `simulate`.
    """

    @abc.abstractmethod
    def simulate(
        self,
        network: CSLC,
        k: Float[np.ndarray, " coefficients"],
        recording: Recording,
        settings: Settings,
    ) -> Derivatives:
        """Positions, velocities and accelerations at the samples of a recording.

        Accelerations are the means over the two intervals that meet at a sample, as torques
        aligned by `"mean"` are.

        **Arguments**

        - `network`: n joints, p coefficients; `k`: (p,), those of bodies that can exist.
        - `recording`: sampled uniformly.
        - `settings`: by which torques are aligned.

        **Returns** `q`, `qd`, `qdd`, (samples, n) each.

        **Raises** `ValueError`: a recording that cannot be simulated so.
        """


class ControlledMotion(AbstractSimulatedMotion):
    """The arm under its controller, which follows the reference that it followed then.

    What is recorded has no part in it: such motion is independent of all noise (Janot, Vandanjon
    and Gautier 2014). It begins at rest, at the first recorded position, as controllers do. Where
    the controller is not known, another one of about its bandwidth may stand for it, such as
    `jaxcslc.control.PID`: motion is then a little further from that of the recording.

    **Attributes**

    - `controller`: with `begin(q)` and `step(state, reference, q, interval)` as those of
      `jaxcslc.control` have them; it gets positions (1, n) and returns the torque that is held
      until the next sample.
    - `reference`: of the controller, a pytree of arrays (samples, n) such as a
      `jaxcslc.control.Reference`; the controller gets a row of each at a time, (1, n).

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.control import PID, Reference
    >>> from jaxcslc.instruments import ControlledMotion
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(500)[:, None] * 0.002
    >>> reference = Reference(1.0 - np.cos(t), np.sin(t), np.cos(t))
    >>> pid = PID(1, position_gain=2000.0, velocity_gain=100.0)
    >>> recording = jc.Recording(t[:, 0], reference.q, reference.q)
    >>> motion = ControlledMotion(pid, reference)
    >>> q, qd, qdd = motion.simulate(network, np.array([0.5, 0.1]), recording, jc.Settings())
    >>> bool(np.max(np.abs(q - reference.q)) < 1e-3)
    True
    """

    controller: Any
    reference: Any

    def simulate(
        self,
        network: CSLC,
        k: Float[np.ndarray, " coefficients"],
        recording: Recording,
        settings: Settings,
    ) -> Derivatives:
        """Simulate the arm under its controller; see `AbstractSimulatedMotion.simulate`."""
        interval = uniform_interval(recording.time)
        for values in jax.tree.leaves(self.reference):
            if np.shape(values)[:1] != (recording.samples,):
                raise ValueError(
                    f"the reference has an array of shape {np.shape(values)}; expected a first"
                    f" axis of {recording.samples} samples, those of the recording"
                )
        del settings
        first = recording.position[:1]
        path = _controlled(
            network,
            jnp.asarray(k),
            first,
            np.zeros_like(first),
            self.controller,
            self.reference,
            interval,
        )
        q, qd, _ = (np.asarray(values)[:, 0] for values in path)
        return q, qd, _at_samples(np.diff(qd, axis=0) / interval)


class CorrectedMotion(AbstractSimulatedMotion):
    """The arm under the recorded torques, and a correction towards the recorded positions.

    For recordings of which neither controller nor reference is known: an observer of positions
    and velocities without a lag where the model is right. Without the correction the arm would
    drift away; a slow one lets little noise of positions pass, and no derivative of them is taken.
    Torque noise passes as it is: motion is nearly free of the encoders' noise, and not of the
    drives'. Such instruments are right where torques are demands, or precise.

    **Attributes**

    - `bandwidth`: of the correction, critically damped [Hz]: errors of the model below it are
      corrected, noise of positions above it stays out.

    **Raises** `ValueError`: a bandwidth that is not a positive number.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.instruments import CorrectedMotion
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm.with_friction("viscous"), lengths="numeric")
    >>> t = np.arange(800)[:, None] * 0.002
    >>> torque = 0.5 * -4 * np.sin(2 * t) + 0.2 * 2 * np.cos(2 * t)
    >>> recording = jc.Recording(t[:, 0], np.sin(2 * t), torque)
    >>> wrong = np.array([0.52, 0.2])
    >>> q, qd, qdd = CorrectedMotion().simulate(network, wrong, recording, jc.Settings())
    >>> bool(np.max(np.abs(q - np.sin(2 * t))) < 1e-3)
    True
    """

    bandwidth: float = 2.0

    def __check_init__(self) -> None:
        if not 0.0 < self.bandwidth < np.inf:
            raise ValueError(f"bandwidth is {self.bandwidth} Hz; expected a positive number")

    def simulate(
        self,
        network: CSLC,
        k: Float[np.ndarray, " coefficients"],
        recording: Recording,
        settings: Settings,
    ) -> Derivatives:
        """Simulate the arm with the correction; see `AbstractSimulatedMotion.simulate`."""
        interval = uniform_interval(recording.time)
        q, qd, _ = settings.preparation.derivatives(recording)
        middle = recording.time[:-1, None] + 0.5 * interval
        held = settings.preparation.torque_alignment != "sample"
        torque = applied_torque(recording, settings, middle, held=held)
        kept = float(np.exp(-2.0 * np.pi * self.bandwidth * interval))
        path = _corrected(
            network, jnp.asarray(k), q[:1], qd[:1], recording.position, torque, kept, interval
        )
        q, qd, change = (np.asarray(values)[:, 0] for values in path)
        return q, qd, _at_samples(change[1:] / interval)


@eqx.filter_jit
def _controlled(
    network: CSLC,
    k: Array,
    q: Float[Array | np.ndarray, "starts joints"],
    qd: Float[Array | np.ndarray, "starts joints"],
    controller: Any,
    reference: Any,
    interval: float,
) -> State:
    """States at all samples, (samples, starts, n) each."""
    advance = held_step(network, k, interval)

    def through(carry: tuple[State, Any], row: Any) -> tuple[tuple[State, Any], State]:
        state, memory = carry
        desired = jax.tree.map(lambda values: jnp.broadcast_to(values, q.shape), row)
        torque, memory = controller.step(memory, desired, state[0], interval)
        return (advance(state, torque), memory), state

    start = jnp.asarray(q), jnp.asarray(qd), jnp.zeros_like(qd)
    memory = jax.tree.map(jnp.asarray, controller.begin(start[0]))
    _, path = jax.lax.scan(through, (start, memory), jax.tree.map(jnp.asarray, reference))
    return path


@eqx.filter_jit
def _corrected(
    network: CSLC,
    k: Array,
    q: Float[Array | np.ndarray, "starts joints"],
    qd: Float[Array | np.ndarray, "starts joints"],
    position: Float[Array | np.ndarray, "samples joints"],
    torque: Float[Array | np.ndarray, "intervals starts joints"],
    kept: float,
    interval: float,
) -> tuple[Array, Array, Array]:
    """Positions and velocities at all samples, and changes of velocity by torques in the interval
    before each, (samples, starts, n) each.

    Gains of a critically damped observer: both its poles are at `kept`, the part of an error that
    a sample leaves.
    """
    advance = held_step(network, k, interval)
    of_position, of_velocity = 1.0 - kept**2, (1.0 - kept) ** 2 / interval

    def through(state: State, row: tuple[Array, Array]) -> tuple[State, tuple[Array, ...]]:
        force, reading = row
        before, (q, qd, contact) = state[1], advance(state, force)
        error = reading - q
        after = q + of_position * error, qd + of_velocity * error
        return (*after, contact), (*after, qd - before)

    start = jnp.asarray(q), jnp.asarray(qd), jnp.zeros_like(qd)
    rows = jnp.asarray(torque), jnp.asarray(position)[1:, None]
    _, path = jax.lax.scan(through, start, rows)
    q, qd, change = (
        jnp.concatenate([initial[None], then]) for initial, then in zip(start, path, strict=True)
    )
    return q, qd, change


def _at_samples(
    acceleration: Float[np.ndarray, "intervals joints"],
) -> Float[np.ndarray, "samples joints"]:
    """Means of the intervals that meet at each sample; the first and the last have one."""
    ends = acceleration[:1], acceleration[-1:]
    return np.concatenate([ends[0], 0.5 * (acceleration[1:] + acceleration[:-1]), ends[1]])


def simulated_derivatives(
    motion: AbstractSimulatedMotion,
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    recording: Recording,
    settings: Settings,
) -> Derivatives:
    """Simulated motion that follows that of a recording.

    **Raises**

    - `ValueError`: as `AbstractSimulatedMotion.simulate`.
    - `RuntimeError`: motion that has left the recorded one behind.
    """
    q, qd, qdd = motion.simulate(network, k, recording, settings)
    span = np.ptp(recording.position, axis=0)
    off = np.abs(q - recording.position)
    wrong = ~(off <= np.maximum(span, _NEAR))
    if wrong.any():
        sample, joint = np.argwhere(wrong)[0]
        raise RuntimeError(
            f"the simulated arm does not follow the recording: joint {joint + 1} is"
            f" {off[sample, joint]:.3g} off at {recording.time[sample]:.4g} s, more than"
            " the joint's span; expected the recording's controller and reference, a correction of"
            " more bandwidth, or a better start"
        )
    return q, qd, qdd
