import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial, reduce
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from ...motion import Patterns
from ...network import AbstractLinearNetwork
from ..solver import Equations, Identification, LeastSquares
from ..systematic import SystematicError
from ._agreement import RecordingAgreement, agreement_of, agreement_text
from ._recording_equations import RecordingEquations
from ._systematic import combined_systematic


# Rounds of weighting each joint of each recording by its residual: two change no weight by 1 %.
_ROUNDS = 2


@dataclasses.dataclass(frozen=True, eq=False)
class SeveralFit:
    """One fit of several recordings.

    **Attributes**

    - `fit`: of all of them.
    - `patterns`: by recording, less its torque offsets.
    - `offsets`: by recording, (n,) constant torques that were fitted along; zero if not asked for.
    - `noise`: by recording, (n,) RMS residual, by which its equations are weighted.
    - `alone`: by recording, the fit of it by itself.
    - `without`: by recording, the fit of the others.
    - `agreement`: of the recordings.
    """

    fit: Identification
    patterns: Mapping[str, Patterns]
    offsets: Mapping[str, Float[np.ndarray, " joints"]]
    noise: Mapping[str, Float[np.ndarray, " joints"]]
    alone: Mapping[str, Identification]
    without: Mapping[str, Identification]
    agreement: RecordingAgreement

    def allowing_for(
        self, errors: Mapping[str, SystematicError]
    ) -> tuple["SeveralFit", SystematicError]:
        """The same with an agreement that allows for systematic errors, and that of the fit.

        - `errors`: by recording, of its fit in `alone`.
        """
        difference: dict[str, np.ndarray] = {}
        for name in self.alone:
            others = {n: fit for n, fit in self.alone.items() if n != name}
            other = combined_systematic(others, {n: errors[n] for n in others})
            difference[name] = np.hypot(errors[name].total, other.total)
        agreement = dataclasses.replace(
            self.agreement,
            standard_error=MappingProxyType(
                {
                    name: np.hypot(error, difference[name])
                    for name, error in self.agreement.standard_error.items()
                }
            ),
        )
        changed = dataclasses.replace(self, agreement=agreement)
        return changed, combined_systematic(self.alone, errors)

    def document(self) -> dict[str, Any]:
        """Of each recording what a report says of it, as plain data."""
        differing = self.agreement.differing
        return {
            name: {
                "samples": patterns.samples,
                "noise": self.noise[name].tolist(),
                "offsets": self.offsets[name].tolist(),
                "differing": list(differing[name]),
            }
            for name, patterns in self.patterns.items()
        }

    def __str__(self) -> str:
        return several_text(self.document())


def several_text(document: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what a report says of several recordings.

    **Arguments**

    - `document`: a `SeveralFit.document`.

    >>> entry = {"samples": 800, "noise": [0.1], "offsets": [0.0], "differing": []}
    >>> print(several_text({"morning": entry, "evening": entry}))
    the 2 recordings agree in all coefficients
    morning: 800 samples, RMS residual of each joint 0.1
    evening: 800 samples, RMS residual of each joint 0.1
    """
    lines = [agreement_text({name: entry["differing"] for name, entry in document.items()})]
    for name, entry in document.items():
        noise = ", ".join(f"{size:.3g}" for size in entry["noise"])
        lines.append(f"{name}: {entry['samples']} samples, RMS residual of each joint {noise}")
        if any(entry["offsets"]):
            listed = ", ".join(f"{offset:.3g}" for offset in entry["offsets"])
            lines.append(f"    torque offsets {listed}")
    return "\n".join(lines)


def fit_recordings(
    network: AbstractLinearNetwork,
    patterns: Mapping[str, Patterns],
    solver: LeastSquares | None = None,
    *,
    offsets: bool = False,
) -> SeveralFit:
    """Fits several recordings of one robot together, and tests whether they agree.

    Equations of each joint of each recording are weighted by their own noise: the RMS residual of
    the fit before, starting with equal ones. Recordings need not be of the same length or rate.

    **Arguments**

    - `network`: n joints, p coefficients.
    - `patterns`: of two recordings or more, by name.
    - `solver`: options of the fit; the defaults of `LeastSquares` if None. Joint weights are those
      of all recordings together.
    - `offsets`: fit a constant torque of each joint in each recording along, as for sensors whose
      zero drifts. It takes the place of a friction term `"offset"`.

    **Returns** a `SeveralFit`.

    **Raises**

    - `ValueError`: fewer than two recordings, or as `LeastSquares.fit`.
    - `RuntimeError`: as `LeastSquares.fit`.

    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import fit_recordings
    >>> arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(arm, lengths="numeric")
    >>> t, rng = np.linspace(0, 5, 500)[:, None], np.random.default_rng(0)
    >>> q, qd, qdd, pairs = np.sin(t), np.cos(t), -np.sin(t), np.ones(t.shape, bool)
    >>> def patterns(friction):
    ...     torque = np.asarray(network.torque(np.array([0.5, friction, 1.0]), q, qd, qdd))
    ...     noise = 0.01 * rng.standard_normal(t.shape)
    ...     return jc.Patterns(t[:, 0], q, qd, qdd, torque + noise, pairs, pairs)
    >>> cold, warm = patterns(2.0), patterns(1.5)
    >>> fit_recordings(network, {"cold": cold, "warm": warm}).agreement.differing["warm"]
    ('kv1',)
    """
    if len(patterns) < 2:
        raise ValueError(f"fit_recordings: got {len(patterns)} recordings; expected two or more")
    solver = solver or LeastSquares()
    equations = {
        name: RecordingEquations.of(network, values, solver, offsets=offsets)
        for name, values in patterns.items()
    }
    samples = {name: len(values.time) for name, values in patterns.items()}
    names = list(patterns)
    fitted = partial(_fitted, solver, equations, samples)
    weights = {name: np.ones(network.joint_count) for name in names}
    fit = fitted(weights, names)
    for _ in range(_ROUNDS):
        weights = _weights({name: equations[name].rms(fit) for name in names})
        fit = fitted(weights, names)
    noise = {name: equations[name].rms(fit) for name in names}
    alone = {name: fitted(weights, [name]) for name in names}
    others: dict[str, Identification] = {}
    for name in names:
        remaining = [other for other in names if other != name]
        single = len(remaining) == 1
        others[name] = alone[remaining[0]] if single else fitted(weights, remaining)
    offset_torques = {name: equations[name].offsets(fit) for name in names}
    return SeveralFit(
        fit,
        MappingProxyType(
            {
                name: dataclasses.replace(
                    values, torque=np.asarray(values.torque) - offset_torques[name]
                )
                for name, values in patterns.items()
            }
        ),
        MappingProxyType(offset_torques),
        MappingProxyType(noise),
        MappingProxyType(alone),
        MappingProxyType(others),
        agreement_of(network, equations, alone, others),
    )


def _fitted(
    solver: LeastSquares,
    equations: Mapping[str, RecordingEquations],
    samples: Mapping[str, int],
    weights: Mapping[str, Float[np.ndarray, " joints"]],
    names: Sequence[str],
) -> Identification:
    """The fit of some recordings, one after the other."""

    def followed(first: tuple[Equations, int], name: str) -> tuple[Equations, int]:
        joined, length = first
        more = equations[name].weighted(weights[name])
        return joined.followed_by(more, length), length + samples[name]

    start = equations[names[0]].weighted(weights[names[0]]), samples[names[0]]
    return solver.fit_equations(*reduce(followed, names[1:], start))


def _weights(
    noise: Mapping[str, Float[np.ndarray, " joints"]],
) -> dict[str, Float[np.ndarray, " joints"]]:
    """Of each joint of each recording: the root mean square of all its noise over its own."""
    pooled = np.sqrt(np.mean([size**2 for size in noise.values()], axis=0))
    return {
        name: np.where(size > 0.0, pooled / np.where(size > 0.0, size, 1.0), 1.0)
        for name, size in noise.items()
    }
