from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxcslc.derivation import constant_values, derive_algebra
from jaxcslc.manipulator import LinkParameters, Manipulator


# Parameters of a link with principal axes, in the order of the last axis of `parameters`.
PARAMETERS = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "motor")
_MOST_FACTORS = 3  # as in m*rx*ry


@dataclass(frozen=True, eq=False)
class CoefficientMap:
    """From link parameters to the inertial coefficients of the dynamics, with its derivative.

    What `CSLC.coefficients_from` computes, for links whose principal axes are the frame's
    (Eqn. 2.3-20), in NumPy: an optimiser evaluates it hundreds of times.
    """

    names: tuple[str, ...]
    """Of the coefficients: `kM1` to `kG5` for the PUMA 560."""

    matrix: Float[np.ndarray, "coefficients terms"]
    """Factor of each product of parameters in each coefficient; it includes lengths and gravity."""

    factors: Int[np.ndarray, "terms 3"]
    """Which parameters each product multiplies; one past the last parameter stands for 1."""

    @classmethod
    def of(cls, robot: Manipulator) -> "CoefficientMap":
        coefficients = derive_algebra(robot, "symbolic").coefficients
        constants = constant_values(robot)
        terms = list({addend.term: None for c in coefficients for addend in c.addends})
        matrix = np.zeros((len(coefficients), len(terms)))
        for row, coefficient in zip(matrix, coefficients, strict=True):
            for addend in coefficient.addends:
                factor = float(addend.factor)
                for name, power in addend.constants:
                    factor *= constants[name] ** power
                row[terms.index(addend.term)] += factor
        width = len(PARAMETERS)
        factors = np.full((len(terms), _MOST_FACTORS), robot.joint_count * width)
        for row, term in zip(factors, terms, strict=True):
            row[: len(term.factors)] = [
                term.link * width + PARAMETERS.index(factor) for factor in term.factors
            ]
        return cls(tuple(c.name for c in coefficients), matrix, factors)

    def values(self, parameters: Float[np.ndarray, "links 8"]) -> Float[np.ndarray, " k"]:
        """Coefficients of links whose parameters are rows of `PARAMETERS`."""
        return self.matrix @ np.prod(self._factor_values(parameters), axis=1)

    def jacobian(self, parameters: Float[np.ndarray, "links 8"]) -> Float[np.ndarray, "k links 8"]:
        """Derivative of each coefficient in each parameter."""
        values = self._factor_values(parameters)
        of_terms = np.zeros((len(self.factors), parameters.size + 1))
        for slot in range(_MOST_FACTORS):  # the product rule
            others = np.prod(np.delete(values, slot, axis=1), axis=1)
            np.add.at(of_terms, (np.arange(len(values)), self.factors[:, slot]), others)
        return (self.matrix @ of_terms[:, :-1]).reshape(-1, *parameters.shape)

    def _factor_values(
        self, parameters: Float[np.ndarray, "links 8"]
    ) -> Float[np.ndarray, "terms 3"]:
        return np.append(parameters, 1.0)[self.factors]


def parameters_of(links: Sequence[LinkParameters]) -> Float[np.ndarray, "links 8"]:
    """Links as rows of `PARAMETERS`, without the products of inertia."""
    return np.array(
        [
            [
                float(link.mass),
                *np.asarray(link.centre_of_gravity, dtype=np.float64),
                *np.diag(np.asarray(link.inertia, dtype=np.float64)),
                float(link.motor_inertia),
            ]
            for link in links
        ]
    )


def links_of(parameters: Float[np.ndarray, "links 8"]) -> tuple[LinkParameters, ...]:
    """Rows of `PARAMETERS` as links."""
    return tuple(
        LinkParameters(float(row[0]), row[1:4].copy(), np.diag(row[4:7]), float(row[7]))
        for row in parameters
    )
