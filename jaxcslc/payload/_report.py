"""Identification of a payload: the fit to patterns, that of recordings, and its report."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._display import html_of, html_rows, html_table
from .._text_table import text_table
from ..bodies import body_of, link_of, nearest_body
from ..identification import recording_named
from ..least_squares import (
    Identification,
    LeastSquares,
    Previous,
    Settings,
    reidentify,
    settings_document,
)
from ..manipulator import TENSOR_ENTRIES, LinkParameters, Manipulator, seen_from
from ..network import CSLC, PAYLOAD
from ..recordings import Patterns, Recording
from ..report import ErrorTable, all_or_nothing, compare, write_csv, write_json
from ..selection import choose_settings


PHYSICAL = ("m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
"""Quantities that `PayloadFit.physical` lists: mass, centre of gravity, inertia tensor there."""

_UNITS = (*["kg"], *["m"] * 3, *["kg m²"] * 6)
# Entries of a Jacobian below this part of the largest are zero.
_NEGLIGIBLE = 1e-12


class PayloadFit(eqx.Module):
    """Result of a fit with a payload, in the frame of the link that carries it.

    **Attributes**

    - `fit`: all coefficients, the arm's and then the payload's ten.
    - `possible`: the body that can exist nearest to the estimate, in standard errors; None if
      none was found.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric").with_payload()
    >>> k = np.zeros(network.size)
    >>> k[network.layout.payload] = 0.01, 0.01, 0.02, 0, 0, 0, 0.1, 0, 0, 1
    >>> patterns = jc.examples.swing(network, k, samples=500)
    >>> fit = jc.fit_payload(network, patterns, previous=np.zeros(network.layout.unloaded.stop))
    >>> print(fit.unidentifiable[0])
    pIxx: nothing in the patterns depends on it
    >>> round(float(fit.parameters[6]), 6)  # first moment along x
    0.1
    """

    fit: Identification
    possible: LinkParameters | None

    @property
    def _indices(self) -> Int[np.ndarray, "10"]:
        """Indices of the payload's coefficients among those of the fit."""
        return np.array([self.fit.names.index(name) for name in PAYLOAD])

    @property
    def parameters(self) -> Float[Array, "10"]:
        """Inertia about the frame's origin, first moments and mass [kg m², kg m, kg].

        In the order of `jaxcslc.derivation.BODY`.
        """
        return self.fit.k[self._indices]

    @property
    def covariance(self) -> Float[Array, "10 10"]:
        """Covariance of `parameters`."""
        return self.fit.covariance[np.ix_(self._indices, self._indices)]

    @property
    def standard_error(self) -> Float[Array, "10"]:
        """Standard error of `parameters`; infinite where the motion does not determine them."""
        return self.fit.standard_error[self._indices]

    @property
    def determined(self) -> Bool[Array, "10"]:
        """True for each of `parameters` that the motion determines by itself."""
        return self.fit.determined[self._indices]

    @property
    def unidentifiable(self) -> tuple[str, ...]:
        """Sentences about what the motion does not determine of the payload."""
        return tuple(
            sentence
            for sentence in self.fit.unidentifiable
            if any(name in PAYLOAD for name in sentence.partition(":")[0].split(", "))
        )

    @property
    def mass(self) -> Float[Array, ""]:
        """Mass [kg]."""
        return self.physical[0]

    @property
    def centre_of_gravity(self) -> Float[Array, "3"]:
        """Centre of gravity, (3,) [m]."""
        return self.physical[1:4]

    @property
    def inertia(self) -> Float[Array, "3 3"]:
        """Inertia tensor at the centre of gravity, (3, 3) [kg m²]."""
        xx, yy, zz, xy, xz, yz = self.physical[4:]
        return jnp.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def physical(self) -> Float[Array, "10"]:
        """Mass, centre of gravity and the tensor there, as `PHYSICAL` lists them."""
        return _physical(self.parameters)

    @property
    def physical_covariance(self) -> Float[Array, "10 10"]:
        """Covariance of `physical`, to first order in the errors (delta method)."""
        slope = _slope(self.parameters)
        return slope @ self.covariance @ slope.T

    @property
    def physical_error(self) -> Float[Array, "10"]:
        """Standard deviation of each of `physical`; infinite where undetermined."""
        slope = jnp.abs(_slope(self.parameters))
        enters = slope > _NEGLIGIBLE * jnp.max(slope, axis=1, keepdims=True)
        open_ = jnp.any(enters & ~self.determined[None, :], axis=1)
        error = jnp.sqrt(jnp.diag(self.physical_covariance))
        # Of a mass of which nothing is known, least squares makes zero, and of the rest NaN.
        return jnp.where(open_ | jnp.isnan(error), jnp.inf, error)

    def confidence_interval(self, level: float = 0.95) -> Float[np.ndarray, "10 2"]:
        """Lower and upper end for each of `parameters`, from Student's t.

        **Raises** `ValueError` for a level that is not between 0 and 1.
        """
        return self.fit.confidence_interval(level)[self._indices]

    def physical_interval(self, level: float = 0.95) -> Float[np.ndarray, "10 2"]:
        """Return the confidence interval of each of `physical`, to first order.

        Trust those of centre and tensor as long as the mass is known to some 20 %.

        **Raises** as `confidence_interval`.
        """
        return self.fit.interval_of(self.physical, self.physical_error, level)

    def rows(self, level: float = 0.95) -> list[dict[str, Any]]:
        """Return one row per entry of `physical`: name, unit, value, error, interval, possible.

        What is not determined has no value (NaN), and an interval without ends.
        """
        error = np.asarray(self.physical_error)
        known = np.isfinite(error)
        with np.errstate(invalid="ignore"):  # infinite centre less infinite error
            interval = np.where(known[:, None], self.physical_interval(level), [-np.inf, np.inf])
        nearest = np.full(10, np.nan)
        if self.possible is not None:
            nearest = np.asarray(_physical(jnp.asarray(body_of(self.possible))))
        value = np.where(known, np.asarray(self.physical), np.nan)
        columns = np.column_stack([value, error, interval, nearest]).tolist()
        keys = ("name", "unit", "value", "standard_error", "low", "high", "possible")
        return [
            dict(zip(keys, (name, unit, *row), strict=True))
            for name, unit, row in zip(PHYSICAL, _UNITS, columns, strict=True)
        ]

    def document(self, level: float = 0.95) -> dict[str, Any]:
        """Return the whole fit as plain data, `rows` by name."""
        return {
            "parameters": dict(zip(PAYLOAD, np.asarray(self.parameters).tolist(), strict=True)),
            "covariance": np.asarray(self.covariance).tolist(),
            "level": level,
            "physical": {row.pop("name"): row for row in self.rows(level)},
            "unidentifiable": list(self.unidentifiable),
        }

    def __repr__(self) -> str:
        value, error = np.asarray(self.physical), np.asarray(self.physical_error)
        centre = ", ".join(
            f"{1e3 * r:.3g} ± {1e3 * e:.2g}" for r, e in zip(value[1:4], error[1:4], strict=True)
        )
        return f"PayloadFit({value[0]:.4g} ± {error[0]:.2g} kg, centre [{centre}] mm)"

    def _repr_html_(self) -> str:
        """Return a table of mass, centre of gravity and inertia, for notebooks."""
        return html_rows(repr(self), self.rows())


@jax.jit
def _physical(body: Float[Array, "10"]) -> Float[Array, "10"]:
    mass, moment = body[9], body[6:9]
    centre = moment / mass
    x, y, z = moment
    shift = jnp.stack([y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z])
    return jnp.concatenate([mass[None], centre, body[:6] - shift / mass])


_slope = jax.jit(jax.jacfwd(_physical))


def fit_payload(
    network: CSLC,
    loaded: Patterns,
    unloaded: Patterns | None = None,
    previous: Previous | None = None,
    *,
    solver: LeastSquares | None = None,
) -> PayloadFit:
    """Fit the ten inertial parameters of a payload to patterns of the loaded arm (thesis 8.2.4).

    A payload and the link that carries it are one rigid body: a recording of the loaded arm alone
    cannot tell them apart. What the arm weighs without it must come from elsewhere, so one of two
    more things is needed:

    - `unloaded`, a recording of the arm without it: the coefficients of both are fitted to both
      recordings together. Payload columns of the unloaded one are zero.
    - `previous`, an earlier identification of the arm, whose coefficients stay fixed
      (`reidentify(..., groups=("payload",))`). If it is an `Identification`, its uncertainty
      counts: the payload's covariance includes what errors of the arm's coefficients do to it.

    The payload is in the frame of the link that carries it, the last one unless the network says
    otherwise (`with_payload`). Friction that changes with the load, and an arm whose friction has
    changed since it was identified, are taken for payload as far as they look like one.

    **Arguments**

    - `network`: of the arm, with or without payload.
    - `loaded`, `unloaded`: patterns (samples, n).
    - `previous`: an `Identification` of the arm, or its coefficients, which then count as exact.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None.

    **Returns** a `PayloadFit`. Runs on the host; with `unloaded` it keeps the equations of both
    recordings in memory.

    **Raises**

    - `ValueError`: unless one of `unloaded` and `previous` is passed; for another network's
      coefficients; or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot).with_payload()
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, payload=body)
    >>> k = np.asarray(k)
    >>> patterns, arm = jc.examples.swing(network, k), k[network.layout.unloaded]
    >>> fit = jc.fit_payload(network, patterns, previous=arm)
    >>> round(float(fit.mass), 6), np.round(fit.centre_of_gravity, 6).tolist()
    (1.5, [0.02, 0.0, 0.1])
    """
    if unloaded is not None and previous is not None:
        raise ValueError("fit_payload: got both unloaded and previous; expected one of them")
    if unloaded is None and previous is None:
        raise ValueError(
            "fit_payload: a loaded recording alone cannot tell payload and last link apart;"
            " expected one of unloaded and previous"
        )
    whole = network.with_payload() if network.payload is None else network
    solver = solver or LeastSquares()
    if previous is not None:
        fit = reidentify(whole, loaded, previous, groups=("payload",), solver=solver)
    else:
        assert unloaded is not None
        payload = whole.layout.indices("payload").tolist()
        alone = solver.equations(whole, unloaded).without(payload)
        both = solver.equations(whole, loaded).followed_by(alone, loaded.samples)
        fit = solver.fit_equations(both, loaded.samples + unloaded.samples)
    columns = whole.layout.payload
    covariance = np.asarray(fit.independent_covariance)[columns, columns]
    undetermined = np.asarray(fit.undetermined)[:, columns]
    body = nearest_body(np.asarray(fit.k)[columns], covariance, undetermined)
    return PayloadFit(fit, None if body is None else link_of(body))


@dataclasses.dataclass(frozen=True, eq=False)
class PayloadReport:
    """The result of `identify_payload`: mass, centre of gravity and inertia of a payload.

    `print` shows what `jaxcslc payload` prints; `save` writes what it writes.

    **Attributes**

    - `network`: with the payload's ten coefficients.
    - `settings`: of preparation and fit.
    - `fit`: the `PayloadFit`, with uncertainty and the nearest body that can exist.
    - `patterns`: of the loaded recording.
    - `errors`: torque errors over them, `"with"` and `"without"` the payload's coefficients.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.puma560()).with_payload()
    >>> k = np.ones(network.size)
    >>> recording = jc.examples.swing_recording(network, k, samples=500)
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> report.errors.names
    ('with', 'without')
    """

    network: CSLC
    settings: Settings
    fit: PayloadFit
    patterns: Patterns
    errors: ErrorTable

    @property
    def file_body(self) -> LinkParameters | None:
        """The consistent body in the frame of the last joint's body in the robot's URDF or MJCF.

        None where there is no such body, or no such file.
        """
        return in_last_body_frame(self.network.robot, self.fit.possible)

    def save(self, folder: str | Path) -> tuple[Path, Path]:
        """Write `payload.csv` and `payload.json` into a folder: both or, if writing fails, none.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file.
        - `OSError`: the folder cannot be written.
        """
        folder = Path(folder)
        with all_or_nothing(folder) as scratch:
            write_csv(scratch / "payload.csv", self.fit.rows())
            write_json(
                scratch / "payload.json",
                {
                    "robot": self.network.robot.name,
                    "settings": settings_document(self.settings),
                    **self.fit.document(),
                    **_fit_document(self.network.robot, self.file_body),
                    "torque_error_rms": dict(zip(self.errors.names, self.errors.rms, strict=True)),
                },
            )
        return folder / "payload.csv", folder / "payload.json"

    def __repr__(self) -> str:
        return f"PayloadReport of {self.network.robot.name}. {self.fit}"

    def _repr_html_(self) -> str:
        """Return tables of the payload and of the torque errors, for notebooks."""
        errors = dict(zip(self.errors.names, self.errors.rms, strict=True))
        title = "RMS torque error [N m or N] with and without the payload"
        table = html_table(title, {"joint": self.network.output_labels, **errors})
        return html_of(self.fit) + table

    def __str__(self) -> str:
        names = ["value", "low", "high", "possible"]
        table = text_table(
            ["", "unit", *names],
            [
                [row["name"], row["unit"], *(_number(row[name]) for name in names)]
                for row in self.fit.rows()
            ],
            left=("unit",),
        )
        lines = [
            f"{self.network}\nsettings: {self.settings}\n\n{table}\n",
            "frame of the last link; I.. at the centre of gravity; low and high: 95 % intervals"
            f" for {self.fit.fit.errors} errors; possible: the nearest body that can exist",
            *_determination_lines(self.fit),
        ]
        if self.file_body is not None and self.network.robot.source is not None:
            name, body = self.network.robot.source.links[-1], self.file_body
            centre = ", ".join(f"{x:.4g}" for x in np.asarray(body.centre_of_gravity))
            tensor = np.asarray(body.inertia)
            moments = ", ".join(f"{tensor[pair]:.4g}" for pair in TENSOR_ENTRIES)
            lines.append(
                f"possible, in the file's frame of {name}: {float(body.mass):.4g} kg at"
                f" [{centre}] m; Ixx, Iyy, Izz, Ixy, Ixz, Iyz there {moments} kg m²"
                + ("; what the motion does not determine is a guess" if _open(self.fit) else "")
            )
        units = dict.fromkeys(self.network.output_units)
        loaded, unloaded = (", ".join(f"{x:.3g}" for x in row.tolist()) for row in self.errors.rms)
        lines.append(
            f"RMS torque error [{' or '.join(units)}] over the loaded recording, joint by joint:"
            f" {loaded}"
        )
        lines.append(f"  without the payload's part: {unloaded}")
        return "\n".join(lines)


def _number(value: float) -> str:
    return f"{value:.4g}" if np.isfinite(value) else ""


def _open(fit: PayloadFit) -> bool:
    """Return whether the motion leaves something of the body open."""
    return not np.isfinite(np.asarray(fit.physical_error)).all()


def _determination_lines(fit: PayloadFit) -> list[str]:
    """Return lines about what the motion does not determine of the payload.

    If something of the body is open, a line lists what is determined. Without the mass, the centre
    of gravity is open, but its first moments are not.
    """
    lines = [f"not determined: {sentence}" for sentence in fit.unidentifiable]
    if not _open(fit):
        return lines
    intervals = fit.confidence_interval()
    determined = [
        f"{name} {value:.4g} ({low:.4g} to {high:.4g}) {unit}"
        for name, unit, value, (low, high), known in zip(
            PAYLOAD, _PAYLOAD_UNITS, fit.parameters.tolist(), intervals, fit.determined, strict=True
        )
        if known and low <= high  # neither is a number of a covariance that is none
    ]
    return [
        *lines,
        f"determined: {', '.join(determined) or 'nothing by itself'}",
        "pIxx to pIyz: about the origin of the last link's frame; phx to phz: mass times centre of"
        " gravity; pm: mass",
    ]


_PAYLOAD_UNITS = (*["kg m²"] * 6, *["kg m"] * 3, "kg")  # of `PAYLOAD`


def in_last_body_frame(robot: Manipulator, body: LinkParameters | None) -> LinkParameters | None:
    """Return a body of the last link's frame in the frame of that joint's body in the file.

    None of no body, and of robots that are read from no URDF or MJCF.
    """
    source = robot.source
    if body is None or source is None or source.format == "toml":
        return None
    return seen_from(body, np.linalg.inv(source.placements[-1]))


def _fit_document(robot: Manipulator, body: LinkParameters | None) -> dict[str, Any]:
    if body is None or robot.source is None:
        return {}
    return {
        "file_body": {
            "frame": robot.source.links[-1],
            "mass": float(body.mass),
            "centre_of_gravity": np.asarray(body.centre_of_gravity),
            "inertia": np.asarray(body.inertia),
        }
    }


def identify_payload(
    network: CSLC,
    loaded: Recording,
    unloaded: Recording | None = None,
    settings: Settings | None = None,
    *,
    previous: Previous | None = None,
    progress: Callable[[str], None] | None = None,
) -> PayloadReport:
    """Identify a payload from a recording of the arm that carries it.

    `jaxcslc payload` prints and saves the report that this function returns.

    **Arguments**

    - `network`: of the arm, with or without a payload's coefficients.
    - `loaded`: the recording with the payload.
    - `unloaded`: a recording without it: the arm's coefficients are then fitted to both recordings.
    - `settings`: of preparation and fit; by default those that `choose_settings` finds for the
      loaded recording.
    - `previous`: an identification of the arm, or its coefficients, which are fixed at them. Give
      one of `unloaded` and `previous`.
    - `progress`: is called with a few words at the start of each step.

    **Returns** a `PayloadReport`.

    **Raises**

    - `ValueError`: both or none of `unloaded` and `previous`; a recording that cannot be used, with
      its name, loaded or unloaded; or as `fit_payload`.
    - `RuntimeError`: as `fit_payload`.

    >>> import numpy as np, jaxcslc as jc
    >>> robot = jc.puma560()
    >>> network = jc.derive(robot).with_payload()
    >>> body = jc.LinkParameters(1.5, np.array([0.02, 0.0, 0.1]), 2e-3 * np.eye(3))
    >>> k = network.coefficients_from(robot.links, viscous=robot.viscous, payload=body)
    >>> k = np.asarray(k)
    >>> recording = jc.examples.swing_recording(network, k, samples=500)
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> round(float(report.fit.mass), 2)
    1.5
    """
    step = progress or (lambda words: None)
    network = network.with_payload() if network.payload is None else network
    with recording_named("loaded recording"):
        if settings is None:
            step("choosing settings")
            settings = choose_settings(network, loaded).settings
        settings = settings.for_network(network)
        step("preparing patterns")
        patterns = settings.patterns(loaded)
    arm = None
    if unloaded is not None:
        with recording_named("unloaded recording"):
            arm = settings.patterns(unloaded)
    step("fitting coefficients")
    fit = fit_payload(network, patterns, arm, previous=previous, solver=settings.solver)
    step("computing errors")
    k = np.asarray(fit.fit.k)
    without = k.copy()
    without[network.layout.payload] = 0.0
    vectors = {"with": k, "without": without}
    return PayloadReport(network, settings, fit, patterns, compare(network, patterns, vectors))
