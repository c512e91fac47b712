"""Demanded torque and what the gears pass on of it, within sampling intervals (Fig. 7.4-1)."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from matplotlib.figure import Figure

import sim
from jaxcslc.control import AbstractController, Reference
from scripts.studies.figures import COLOURS, MEASURED, new_figure


# Looks at the machine between two updates of its demand.
_LOOKS = 10


class DemandHold(AbstractController):
    """A controller that is looked at more often than it updates its demand.

    Between updates the demand is constant, as the drives of 7.4 have it. The state is the
    controller's, the demand and the number of samples.

    **Attributes**

    - `controller`: what computes the demand.
    - `every`: samples from one update to the next.
    """

    controller: AbstractController
    every: int = eqx.field(static=True)

    @property
    def array_generic(self) -> bool:
        """Return what the controller returns."""
        return self.controller.array_generic

    def begin(self, q: Any) -> Any:
        """The controller's state, no demand, no sample."""
        count = np.zeros((*q.shape[:-1], 1), int)
        return self.controller.begin(q), 0.0 * q, q.__array_namespace__().asarray(count)

    def step(
        self,
        state: Any,
        reference: Reference,
        q: Any,
        interval: float | Array,
        qd: Any | None = None,
    ) -> tuple[Any, Any]:
        """Return what `AbstractController.step` returns."""
        before, demand, count = state
        xp = q.__array_namespace__()
        due = count % self.every == 0
        torque, after = self.controller.step(before, reference, q, self.every * interval, qd)
        demand = xp.where(due, torque, demand)
        after = jax.tree.map(lambda new, old: xp.where(due, new, old), after, before)
        return demand, (after, demand, count + 1)


class AppliedTorque(NamedTuple):
    """A stretch of one joint's demand and of the torque behind its gears.

    - `time`: (looks,) [s]; `updates`: (samples,) when the demand changes [s].
    - `demanded`: (looks,), constant between updates; `transmitted`: (looks,), from rotor to link:
      the demand less what the rotor's inertia and friction take [N m].
    """

    time: Float[np.ndarray, " looks"]
    updates: Float[np.ndarray, " samples"]
    demanded: Float[np.ndarray, " looks"]
    transmitted: Float[np.ndarray, " looks"]


def applied_torque(
    machine: sim.Machine, *, joint: int = 2, middle: float = 0.4, samples: int = 16
) -> AppliedTorque:
    """Demand and transmitted torque of a joint in the comparison trajectory.

    **Arguments**

    - `machine`: with compliant gears.
    - `joint`: counted from 1.
    - `middle`: of the stretch [s]; the trajectory is simulated up to its end only.
    - `samples`: intervals of the recording that the stretch has.
    """
    compared = sim.comparison()
    interval = compared.sample_interval / _LOOKS
    first = round(middle / compared.sample_interval) - samples // 2
    closely = dataclasses.replace(
        compared,
        controller=DemandHold(compared.controller, _LOOKS),
        samples=(first + samples) * _LOOKS + 1,
        sample_interval=interval,
    )
    recording, truth = sim.simulate(dataclasses.replace(machine, timing_jitter=0.0), closely)
    stretch = slice(first * _LOOKS, None)
    column = joint - 1
    return AppliedTorque(
        truth.time[stretch],
        truth.time[stretch][::_LOOKS],
        recording.torque[stretch, column],
        truth.transmitted[stretch, column],
    )


def applied_torque_picture(
    applied: AppliedTorque, *, title: str | None = None, unit: str = "N m"
) -> Figure:
    """Demanded torque in steps, and the torque behind the gears (Fig. 7.4-1).

    **Arguments**

    - `applied`: the stretch.

    **Returns** a matplotlib figure; vertical lines are where the demand is updated and the encoders
    are read.
    """
    figure = new_figure(6.4, 4.6)
    panels = figure.subplots(2, 1, sharex=True)
    ms = 1e3 * (applied.time - applied.time[0])
    rows = (
        ("demanded", applied.demanded, "steps-post", COLOURS[0]),
        ("behind the gears", applied.transmitted, "default", COLOURS[1]),
    )
    span = 1.15 * max(float(np.ptp(values)) for _, values, _, _ in rows)
    for axes, (name, values, style, colour) in zip(panels, rows, strict=True):
        for update in 1e3 * (applied.updates - applied.time[0]):
            axes.axvline(update, color=MEASURED, lw=0.6, zorder=0.5)
        axes.plot(ms, values, color=colour, lw=1.6, drawstyle=style)
        middle = 0.5 * float(values.max() + values.min())
        axes.set_ylim(middle - 0.5 * span, middle + 0.5 * span)  # one scale, two offsets
        axes.set_ylabel(f"{name}\n[{unit}]")
        axes.margins(x=0.0)
    panels[-1].set_xlabel(f"time from {applied.time[0]:.3f} s [ms]")
    figure.align_ylabels(list(panels))
    if title:
        figure.suptitle(title)
    return figure
