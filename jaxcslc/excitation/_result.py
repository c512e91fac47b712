import dataclasses

import numpy as np
from jaxtyping import Float

from ..network import CSLC
from ._criteria import EXPLANATIONS
from ._families import AbstractFamily, Parameters
from ._feasibility import Use
from ._information import Prediction, time_grid
from ._limits import Limits
from ._noise import Noise


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """A motion to record, with what it uses of limits and what it is predicted to bring.

    **Attributes**

    - `network`: whose coefficients it is for.
    - `family`, `parameters`: of the motion.
    - `limits`, `use`: what joints must not exceed, and how much of it is used.
    - `noise`: of the recording chain.
    - `prediction`: standard errors after the motion.
    - `criterion`, `value`: what was minimised, and what was reached.
    - `wanted`: names of the coefficients that it is for.
    - `scale`: by which the motion was shrunk at the end to keep all limits.
    - `notes`: sentences on assumptions.
    """

    network: CSLC
    family: AbstractFamily
    parameters: Parameters
    limits: Limits
    use: Use
    noise: Noise
    prediction: Prediction
    criterion: str
    value: float
    wanted: tuple[str, ...]
    scale: float
    notes: tuple[str, ...] = ()

    def sampled(
        self, rate: float | None = None
    ) -> tuple[Float[np.ndarray, " samples"], tuple[Float[np.ndarray, "samples joints"], ...]]:
        """Times, and `q`, `qd`, `qdd` then; by default at the recording's rate [Hz]."""
        time, _ = time_grid(self.family.duration, 1.0 / (rate or self.noise.rate))
        motion = self.family.motion(np.asarray(self.parameters, float), time)
        return time, tuple(np.asarray(x) for x in motion)

    def seconds_for(self, relative: float) -> float:
        """How long this motion must be repeated for standard errors of this part of the sizes of
        all wanted coefficients [s]; infinite where it determines one not at all."""
        indices = [self.network.names.index(name) for name in self.wanted]
        if not self.prediction.determined[indices].all():
            return np.inf
        worst = float(np.max(self.prediction.relative_error[indices]))
        return self.family.duration * max(worst / relative, 1e-12) ** 2

    def __str__(self) -> str:
        lines = [
            f"{self.network.name}: {self.family.duration:g} s, {self.family.description}",
            f"{self.criterion} ({EXPLANATIONS[self.criterion]}): {self.value:.4g}",
            f"condition number {self.prediction.condition:.4g}, of columns of unit length"
            f" {self.prediction.scaled_condition:.4g}",
            *self._errors(),
            str(self.use),
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the wanted coefficients that neither the motion nor what is known determines."""
        open_ = ~self.prediction.determined
        return tuple(name for name in self.wanted if open_[self.network.names.index(name)])

    def _errors(self) -> list[str]:
        names = [name for name in self.wanted if name not in self.undetermined]
        indices = [self.network.names.index(name) for name in names]
        relative = 100 * self.prediction.relative_error[indices]
        lines: list[str] = []
        if names:
            lines.append(
                f"predicted standard errors over sizes: median {np.median(relative):.3g} %,"
                f" largest {np.max(relative):.3g} % ({names[int(np.argmax(relative))]})"
            )
        if self.undetermined:
            lines.append(f"not determined by this motion: {', '.join(self.undetermined)}")
        return lines
