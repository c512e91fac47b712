import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._held_out import RelativeError
from ._noise_excitation import NoiseExcitation
from ._noise_order import NoiseOrders


@dataclasses.dataclass(frozen=True)
class SpacingTrial:
    """A spacing of positions, judged on motion that was not fitted.

    **Attributes**

    - `every`: positions are unknown at every so many samples.
    - `relative`: misfit of coefficients from a fit with this spacing over that from a fit with
      positions at every sample, both at the largest spacing that was tried.

    >>> from jaxcslc.identification import SpacingTrial
    >>> trial = SpacingTrial(3, RelativeError(-0.1, 0.02, 8))
    >>> f"every {trial.every}: {trial.relative}"
    'every 3: -9.5 % ± 2 %'
    """

    every: int
    relative: RelativeError


def best_spacing(trials: Sequence[SpacingTrial]) -> int:
    """The spacing with the least misfit, of those that are better than 1 by more than chance.

    >>> two = SpacingTrial(2, RelativeError(-0.2, 0.03, 8))
    >>> trials = [two, SpacingTrial(3, RelativeError(-0.3, 0.5, 8))]
    >>> best_spacing(trials), best_spacing(trials[1:]), best_spacing([])
    (2, 1, 1)
    """
    chance = 0.05 / max(len(trials), 1)
    better = [trial for trial in trials if trial.relative.beyond_chance(chance)]
    return min(better, key=lambda trial: trial.relative.change).every if better else 1


@dataclasses.dataclass(frozen=True)
class OrderChoice:
    """Whether torque noise has the spectrum that its orders support, judged beside white noise.

    **Attributes**

    - `order`: of the autoregression.
    - `drifting`: joints, from 1, whose noise would have a memory without an end: the model lacks
      something slow, and making that white takes out gravity, too.
    - `trial`: misfit of motion left out over that with white noise; None if it was not judged.

    >>> OrderChoice(1, (), RelativeError(0.4, 0.05, 8)).line
    'noise order 1, not used: misfit of motion left out +49 % ± 5 % beside white noise'
    >>> OrderChoice(1, (2, 3), None).line
    'noise order 1, not used: noise of joints 2, 3 would drift'
    """

    order: int
    drifting: tuple[int, ...]
    trial: RelativeError | None

    @property
    def used(self) -> bool:
        """Unless noise drifts, or motion left out is predicted worse by more than chance."""
        if self.drifting:
            return False
        return self.trial is None or not self.trial.reversed.beyond_chance()

    @property
    def line(self) -> str:
        """It in words."""
        words = f"noise order {self.order}{_used(self.used) or ', not used'}"
        if self.drifting:
            joints = ", ".join(map(str, self.drifting))
            return f"{words}: noise of joint{'s' * (len(self.drifting) > 1)} {joints} would drift"
        if self.trial is None:
            return f"{words}: too little motion to be judged"
        return f"{words}: misfit of motion left out {self.trial} beside white noise"

    def document(self) -> dict[str, Any]:
        """It as plain data."""
        trial = self.trial
        return {
            "order": self.order,
            "drifting": list(self.drifting),
            "change": None if trial is None else trial.change,
            "change_error": None if trial is None else trial.change_error,
        }


@dataclasses.dataclass(frozen=True, eq=False)
class ModelSelection:
    """What maximum likelihood selected of its own model, and what else it tried.

    **Attributes**

    - `every`: positions are unknown at every so many samples; `noise_order`: of torque noise.
    - `excess`: by joint, noise of positions over what readings explain, with `every` 1; None if
      `every` was set.
    - `trials`: of spacings above 1; none where readings explain the noise of positions.
    - `orders`: of torque noise, compared; None if `noise_order` was set.
    - `noisy`: spacings that were left for a larger one, since noise of accelerations excited.
    - `order_choice`: whether such a spectrum is used; None if `orders` support none.

    >>> import numpy as np
    >>> from jaxcslc.identification import ModelSelection, NoiseOrders
    >>> orders = NoiseOrders(np.array([[0.0, 0.0], [7.0, -31.0], [14.0, -25.0]]))
    >>> for line in ModelSelection(1, 1, (1.0, 1.02), (), orders).lines:
    ...     print(line)
    every 1, used: noise of positions is 1, 1.02 times what readings explain
    noise order 1, used: criterion (Bayes) over that of white noise 7, -31
    noise order 2: criterion (Bayes) over that of white noise 14, -25
    """

    every: int
    noise_order: int
    excess: tuple[float, ...] | None
    trials: tuple[SpacingTrial, ...]
    orders: NoiseOrders | None
    noisy: tuple[NoiseExcitation, ...] = ()
    order_choice: OrderChoice | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """What was tried and what each was worth, a line each, joint by joint."""
        lines: list[str] = []
        if self.excess is not None:
            values = ", ".join(f"{value:.3g}" for value in self.excess)
            lines.append(
                f"every 1{_used(self.every == 1)}: noise of positions is {values} times what"
                " readings explain"
            )
        lines += [
            f"every {trial.every}{_used(self.every == trial.every)}: misfit of motion left out"
            f" {trial.relative} beside every 1"
            for trial in self.trials
        ]
        lines += [noise.line for noise in self.noisy]
        if self.noisy:
            lines.append(f"every {self.every}, used: motion excites")
        if self.orders is not None:
            for order, criterion in enumerate(self.orders.criterion[1:], start=1):
                values = ", ".join(f"{value:.4g}" for value in criterion)
                lines.append(
                    f"noise order {order}{_used(self.noise_order == order)}: criterion (Bayes) over"
                    f" that of white noise {values}"
                )
        if self.order_choice is not None:
            lines.append(self.order_choice.line)
        return tuple(lines)

    def document(self) -> dict[str, Any]:
        """It as plain data."""
        return {
            "every": self.every,
            "noise_order": self.noise_order,
            "excess_position_noise": None if self.excess is None else list(self.excess),
            "spacings": [
                {
                    "every": trial.every,
                    "change": trial.relative.change,
                    "change_error": trial.relative.change_error,
                }
                for trial in self.trials
            ],
            "excited_by_noise": [noise.document() for noise in self.noisy],
            "noise_criterion": None
            if self.orders is None
            else np.asarray(self.orders.criterion).tolist(),
            "order_choice": None if self.order_choice is None else self.order_choice.document(),
            "lines": list(self.lines),
        }


def _used(used: bool) -> str:
    return ", used" if used else ""
