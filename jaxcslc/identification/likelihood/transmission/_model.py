import dataclasses

import numpy as np
from jaxtyping import Float, Int


# Noise of torque that links have and motors have not, as a part of the motors': equations of gears
# are not quite exact, which also keeps a search from following a wrong spring.
_LINK_NOISE = 0.1


@dataclasses.dataclass(frozen=True)
class TransmissionModel:
    """Which links move apart from their rotors, and how.

    **Attributes**

    - `joints`: n.
    - `links`: (f,) which links move apart, from 0.
    - `least`: (4 f,) bounds of `TransmissionParameters`.
    """

    joints: int
    links: Int[np.ndarray, " links"]
    least: Float[np.ndarray, " parameters"]

    def bounded(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """Within bounds."""
        return np.maximum(values, self.least)

    def levels(
        self,
        torque_noise: Float[np.ndarray, "recordings series"],
    ) -> Float[np.ndarray, "recordings series"]:
        """Noise levels, those of gears' equations by the motors' [N m or N]."""
        result = torque_noise.copy()
        result[:, self.joints :] = _LINK_NOISE * torque_noise[:, self.links]
        return result
