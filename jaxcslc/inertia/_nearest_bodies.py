from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..manipulator import LinkParameters
from ..network import CSLC
from ._bodies import bodies_of, body_map, ties
from ._coefficient_metric import Fitted, whitening
from ._nearest_body import in_units_of
from ._principal_programme import BodyChart, nearest_in_charts
from ._prior_bodies import Prior, balls, prior_of


@dataclass(frozen=True, eq=False)
class NearestBodies:
    """Which bodies, motor inertias and friction come nearest to a fit, as a programme.

    `k = of_bodies · (bodies + fixed) + of_others @ others`; `others` are motor inertias, then all
    coefficients that are not inertial, in units of `scales`.
    """

    network: CSLC
    k: Float[np.ndarray, " coefficients"]
    white: Float[np.ndarray, "rank coefficients"]
    """Turns changes of coefficients into standard errors."""
    fixed: Float[np.ndarray, "links 10"]
    prior: Prior
    of_bodies: Float[np.ndarray, "coefficients links 10"]
    of_others: Float[np.ndarray, "coefficients others"]
    others: Float[np.ndarray, " others"]
    """What to keep to where the data say nothing."""
    bounded: Float[np.ndarray, " others"]
    """1 for what cannot be negative."""
    scales: Float[np.ndarray, " others"]
    weight: float

    @classmethod
    def of(
        cls,
        network: CSLC,
        fit: Fitted,
        prior: Sequence[LinkParameters] | None,
        fixed: Sequence[LinkParameters | None] | None,
        weight: float,
        drive: bool,
    ) -> "NearestBodies":
        robot, p = network.robot, network.size
        k = np.asarray(fit.k, float)
        if k.shape != (p,):
            raise ValueError(f"fit: expected {p} coefficients, got an array of shape {k.shape}")
        held = np.zeros((robot.joint_count, 10))
        for i, body in enumerate(fixed or ()):
            if body is not None:
                held[i] = bodies_of([body])[0]
        bodies, motors = body_map(network.algebra)
        inertial, driven = len(bodies), [drive and inertia.motor for inertia in robot.inertia]
        of_bodies = np.zeros((p, *bodies.shape[1:]))
        of_bodies[:inertial] = bodies

        known = prior if prior is not None else robot.links
        if known is None:
            ball = balls(robot, _mass(fit, np.einsum("ple,le->p", of_bodies, _unit_balls(network))))
            before = prior_of(robot, ball, ball, 0.0 * held)
        else:
            masses = [float(link.mass) for link in known if float(link.mass) > 0]
            before = prior_of(robot, known, balls(robot, float(np.mean(masses or [1.0]))), held)

        errors = np.sqrt(np.maximum(np.diag(np.asarray(fit.covariance, float)), 0.0))[inertial:]
        sizes = np.maximum(np.abs(k[inertial:]), errors)
        scales = np.concatenate([before.motor_scales[driven], np.where(sizes > 0, sizes, 1.0)])
        positive = np.array([c.positive for c in network.coefficients[inertial:]], bool)
        start = np.where(positive, np.maximum(k[inertial:], 0.0), k[inertial:])
        of_others = np.zeros((p, len(scales)))
        of_others[:inertial, : sum(driven)] = motors[:, driven]
        of_others[inertial:, sum(driven) :] = np.eye(p - inertial)
        of_others *= scales
        sizes = [of_bodies[:, i] @ in_units_of(body) for i, body in enumerate(before.bodies)]
        typical = np.linalg.norm(np.concatenate([*sizes, of_others], axis=1), axis=1)
        return cls(
            network,
            k,
            whitening(fit, np.where(typical > 0, typical, 1.0)),
            held,
            before,
            of_bodies,
            of_others,
            np.concatenate([before.motors[driven], start]) / scales,
            np.concatenate([np.ones(sum(driven)), 1.0 * positive]),
            scales,
            weight,
        )

    def found(
        self, least: float
    ) -> tuple[Float[np.ndarray, "links 10"], Float[np.ndarray, " others"], bool] | None:
        """Bodies without what is fixed to them, `others` in their units, and whether the solver
        says that it is the optimum; None if it found nothing.

        Full tensors make a convex programme. Principal axes do not, and have a search of their
        own.
        """
        if all(inertia.form == "full" for inertia in self.network.robot.inertia):
            solution = self._convex(least)
        else:
            solution = self._in_charts(least)
        if solution is None:
            return None
        bodies, others, exactly = solution
        others = np.where(self.bounded > 0, np.maximum(others, 0.0), others) * self.scales
        return bodies, others, exactly

    def _convex(self, least: float) -> tuple[np.ndarray, np.ndarray, bool] | None:
        from ._semidefinite import semidefinite_least_squares

        count = len(self.prior.bodies)
        units = [in_units_of(body) for body in self.prior.bodies]
        columns = [self.of_bodies[:, i] @ unit for i, unit in enumerate(units)]
        matrix = self.white @ np.concatenate([*columns, self.of_others], axis=1)
        held = np.einsum("ple,le->p", self.of_bodies, self.fixed)
        wanted = np.concatenate([np.tile(np.eye(4).ravel(), count), self.others])
        rows: list[np.ndarray] = []
        values: list[float] = []
        for i, (inertia, unit) in enumerate(zip(self.network.robot.inertia, units, strict=True)):
            for form in ties(inertia):
                row = np.zeros(matrix.shape[1])
                row[16 * i : 16 * (i + 1)] = form @ unit
                size = np.linalg.norm(row)
                rows.append(row / size)
                values.append(float(-form @ self.fixed[i] / size))
        found, exactly = semidefinite_least_squares(
            np.concatenate([matrix, self.weight * np.eye(matrix.shape[1])]),
            np.concatenate([self.white @ (self.k - held), self.weight * wanted]),
            np.array(rows).reshape(-1, matrix.shape[1]),
            np.array(values),
            bodies=count,
            bounded=self.bounded,
            least=least,
        )
        if found is None:
            return None
        bodies = np.stack([unit @ found[16 * i : 16 * (i + 1)] for i, unit in enumerate(units)])
        return bodies, found[16 * count :], exactly

    def _in_charts(self, least: float) -> tuple[np.ndarray, np.ndarray, bool]:
        if np.any(self.fixed):
            raise ValueError("fixed: bodies can be fixed to links with full inertia tensors only")
        return nearest_in_charts(
            [
                BodyChart.of(inertia, body, least)
                for inertia, body in zip(self.network.robot.inertia, self.prior.bodies, strict=True)
            ],
            np.einsum("rp,ple->rle", self.white, self.of_bodies),
            self.white @ self.of_others,
            self.white @ self.k,
            self.others,
            self.bounded,
            self.weight,
        )


def _unit_balls(network: CSLC) -> Float[np.ndarray, "links 10"]:
    return bodies_of(balls(network.robot, 1.0))


def _mass(fit: Fitted, of_mass: Float[np.ndarray, " coefficients"]) -> float:
    """The mass of equal bodies that explains the coefficients best, whatever the friction."""
    inertial = of_mass != 0
    white = whitening(fit, np.full(len(of_mass), max(float(np.abs(of_mass).max()), 1e-12)))
    columns = np.concatenate([of_mass[:, None], np.eye(len(of_mass))[:, ~inertial]], axis=1)
    found = float(np.linalg.lstsq(white @ columns, white @ np.asarray(fit.k, float))[0][0])
    return min(max(found, 0.1), 1000.0) if np.isfinite(found) and found > 0 else 1.0
