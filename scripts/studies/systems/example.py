"""What an example consists of: a simulator that is the truth, and a system to identify."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.systems import System, SystemRecording
from scripts.studies.systems.signals import Columns, with_noise


@dataclasses.dataclass(frozen=True, eq=False)
class Example:
    """A system, its recordings, and the constants that they were simulated with.

    **Attributes**

    - `name`: in lower case, without spaces.
    - `source`: how the system is described, and who computes its motion.
    - `description`: makes the system.
    - `truth`: values of all unknown constants.
    - `simulate`: noiseless columns of recordings by their seeds, of training or of validation.
    - `noise`: standard deviations of measurement noise, by column.
    - `settings`: of the identification.
    - `recorded`: variables that a simulation of the identified system takes from the recording
      although the equations contain their derivatives.
    """

    name: str
    source: str
    description: Callable[[], System]
    truth: Mapping[str, float]
    simulate: Callable[[Sequence[int], bool], list[Columns]]
    noise: Mapping[str, float]
    settings: jc.Settings
    recorded: tuple[str, ...] = ()

    @cached_property
    def system(self) -> System:
        """The description."""
        return self.description()

    @cached_property
    def coefficients(self) -> Float[np.ndarray, " coefficients"]:
        """Return those that the true constants make."""
        unknown = {constant.name: self.truth[constant.name] for constant in self.system.unknown}
        return np.asarray(self.system.separation.values(unknown))

    @cached_property
    def nonlinear(self) -> Float[np.ndarray, " constants"]:
        """True values of the constants that are searched."""
        return np.array([self.truth[constant.name] for constant in self.system.nonlinear])

    def recordings(
        self, seeds: Sequence[int], *, validation: bool = False, motions: int | None = None
    ) -> list[SystemRecording]:
        """Recordings with noise, one a seed; those of validation have other inputs and noise.

        - `motions`: how many different ones there are; as many as recordings if None. The noise is
          another in each.
        """
        of_motion = [seed if motions is None else seed % motions for seed in seeds]
        different = sorted(set(of_motion))
        simulated = dict(zip(different, self.simulate(different, validation), strict=True))
        return [
            recording_of(with_noise(simulated[motion], self.noise, 2 * seed + validation))
            for seed, motion in zip(seeds, of_motion, strict=True)
        ]


def recording_of(columns: Columns) -> SystemRecording:
    """Columns as a recording."""
    named = {name: values for name, values in columns.items() if name != "time"}
    return SystemRecording(columns["time"], named)
