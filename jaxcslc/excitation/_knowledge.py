import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from ..identification.prior import information_rows
from ..identification.solver import Identification
from ..network import CSLC
from ._information import Square


@dataclasses.dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of a robot's coefficients before a motion is designed.

    **Attributes**

    - `k`: (p,) coefficients: sizes, and the model by which torques are foreseen.
    - `information`: (p, p) the inverse of their covariance, 0 where nothing is known; None if
      nothing is known of any.
    - `standard_error`: (p,) of `k`; infinite where nothing is known.
    - `is_model`: whether `k` is a model of the robot; False where sizes alone are guessed.

    >>> import jaxcslc as jc
    >>> from jaxcslc.excitation import Knowledge
    >>> knowledge = Knowledge.of_robot(jc.derive(jc.puma560()))
    >>> knowledge.is_model, knowledge.information
    (True, None)
    """

    k: Float[np.ndarray, " coefficients"]
    information: Square | None
    standard_error: Float[np.ndarray, " coefficients"]
    is_model: bool = True

    @classmethod
    def of_robot(cls, network: CSLC) -> "Knowledge":
        """The coefficients of the robot's own links and friction; of robots whose file has no
        masses, no model."""
        robot = network.robot
        unknown = np.full(network.size, np.inf)
        if robot.links is None:
            return cls(np.zeros(network.size), None, unknown, is_model=False)
        values = {"viscous": robot.viscous, "dry": robot.dry}
        friction: dict[str, Any] = {
            kind: value
            for kind, value in values.items()
            if value is not None and kind in network.layout.kinds
        }
        k = np.asarray(network.coefficients_from(robot.links, **friction))
        return cls(k, None, unknown)

    @classmethod
    def of_fit(cls, network: CSLC, fit: Identification) -> "Knowledge":
        """Of an earlier identification of the same network.

        **Raises**

        - `ValueError`: it is of another network.
        """
        if fit.names != network.names:
            raise ValueError(
                f"prior identification: has coefficients {fit.names[0]} to {fit.names[-1]};"
                f" {network.name!r} has {network.names[0]} to {network.names[-1]}"
            )
        k = np.asarray(fit.k, float)
        rows = information_rows(fit, k)
        # Correlations are those for independent errors, standard errors those that the fit reports.
        independent = np.diag(np.asarray(fit.independent_covariance))
        variance = np.diag(np.asarray(fit.covariance))
        counted = (independent > 0.0) & (variance > 0.0)
        ratio = np.divide(variance, independent, out=np.ones_like(variance), where=counted)
        rows = rows / np.sqrt(ratio)
        return cls(k, rows.T @ rows, np.asarray(fit.standard_error))

    def with_payload(self, network: CSLC, mass: float) -> "Knowledge":
        """The same, and of a payload only about how heavy it is: for torques, not as a prior.

        **Arguments**

        - `network`: with a payload, `network.with_payload()`.
        - `mass`: of the payload, a point at the origin of the frame that carries it [kg].

        **Raises**

        - `ValueError`: the network has no payload or other coefficients beside it; a negative mass.

        >>> import jaxcslc as jc
        >>> from jaxcslc.excitation import Knowledge
        >>> network = jc.derive(jc.puma560())
        >>> loaded = network.with_payload()
        >>> knowledge = Knowledge.of_robot(network).with_payload(loaded, 2.0)
        >>> dict(zip(loaded.names, knowledge.k.tolist()))["pm"]
        2.0
        """
        layout = network.layout
        added = layout.size - len(self.k)
        if layout.payload != slice(len(self.k), layout.size) or not added:
            raise ValueError(
                f"payload: expected a network with {len(self.k)} coefficients and a payload's ten,"
                f" got {layout.size} coefficients"
            )
        if not 0.0 <= mass < np.inf:
            raise ValueError(f"payload: mass is {mass}; expected 0 kg or more")
        k = np.pad(self.k, (0, added))
        k[layout.names.index("pm")] = mass
        information = None if self.information is None else np.pad(self.information, (0, added))
        error = np.pad(self.standard_error, (0, added), constant_values=np.inf)
        return Knowledge(k, information, error, self.is_model)

    def after(
        self, covariance: Square, k: Float[Array | np.ndarray, " coefficients"] | None = None
    ):
        """The knowledge once coefficients have a covariance (p, p), as a `Prediction` has it."""
        error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        unit = np.where(error > 0.0, error, 1.0)
        inverse = np.linalg.inv(covariance / np.outer(unit, unit)) / np.outer(unit, unit)
        return Knowledge(
            self.k if k is None else np.asarray(k, float), inverse, error, self.is_model
        )
