"""Findings about recordings that disagree with the first one, in rate or torque."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ..least_squares import LeastSquares, regressor_of, reidentify
from ..network import CSLC
from ..recordings import Patterns
from ._evidence import Evidence
from ._sample_findings import Finding


AGREEMENT_KINDS = ("payload", "friction", "disagreement")
"""Kinds of findings that say that a recording is not of the same arm as the first."""

# Recordings at rates that differ by more are not smoothed alike.
_OTHER_RATE = 1.2
# Root mean square of a joint's error under another recording's coefficients over that under its own
# from which recordings disagree; less than this part of its torque is no matter.
_WORSE, _NEGLIGIBLE = 1.5, 0.03
# A cause explains a disagreement that it takes most of away.
_EXPLAINED = 0.6


def rate_findings(rates: Sequence[float], names: Sequence[str]) -> Iterator[Finding]:
    """Recordings that were sampled at another rate than the first.

    **Arguments**

    - `rates`: of the recordings [Hz].
    - `names`: of the recordings.
    """
    for rate, name in zip(rates[1:], names[1:], strict=True):
        if not 1 / _OTHER_RATE < rate / rates[0] < _OTHER_RATE:
            every = round(max(rate, rates[0]) / min(rate, rates[0]))
            faster = name if rate > rates[0] else names[0]
            yield Finding(
                "rate",
                "",
                f"{rate:.4g} samples a second, {rates[0]:.4g} in {names[0]}: settings chosen for"
                " one smooth the other differently",
                "the recorder ran at another rate",
                f"identify each by itself, or thin {faster} with --every {every}",
                name,
            )


def agreement_findings(
    network: CSLC, evidence: Sequence[Evidence], names: Sequence[str]
) -> Iterator[Finding]:
    """Recordings whose torque the coefficients of the first do not predict.

    **Arguments**

    - `network`: n joints.
    - `evidence`: of the recordings.
    - `names`: of the recordings.
    """
    solver = LeastSquares()
    first = solver.fit(network, evidence[0].patterns, throw=False)
    k = np.asarray(first.k)
    for other, name in zip(evidence[1:], names[1:], strict=True):
        patterns = other.patterns
        alone = other.errors(patterns)
        carried = _errors(network, k, patterns)
        worse = carried > np.maximum(_WORSE * alone, alone + _NEGLIGIBLE)
        if not worse.any():
            continue
        joints = np.flatnonzero(worse)
        evidence_text = "; ".join(
            f"{network.output_names[j]} {100 * carried[j]:.2g} % in place of {100 * alone[j]:.2g} %"
            for j in joints
        )
        text = (
            f"the coefficients of {names[0]} leave more of its torque unexplained than its own:"
            f" {evidence_text}"
        )
        listed = ", ".join(network.output_names[j] for j in joints)
        yield _cause(network, k, patterns, carried, alone, text, listed, (names[0], name))


def _cause(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    patterns: Patterns,
    carried: Float[np.ndarray, " joints"],
    alone: Float[np.ndarray, " joints"],
    text: str,
    joints: str,
    names: tuple[str, str],
) -> Finding:
    excess = np.maximum(carried**2 - alone**2, 0.0)

    def explained(errors: Float[np.ndarray, " joints"]) -> float:
        remaining = np.maximum(errors**2 - alone**2, 0.0)
        return 1.0 - float(np.sum(remaining) / np.sum(excess))

    solver = LeastSquares(errors="independent")
    friction = [group for group in ("viscous", "dry", "offset") if group in network.layout.groups]
    parts = {"friction": 0.0}
    if friction:
        fit = reidentify(network, patterns, k, groups=friction, solver=solver)
        parts["friction"] = explained(_errors(network, np.asarray(fit.k), patterns))
    loaded = network.with_payload()
    fit = reidentify(loaded, patterns, k, groups=("payload",), solver=solver)
    parts["payload"] = explained(_errors(loaded, np.asarray(fit.k), patterns))
    (index,) = loaded.layout.indices("pm")
    mass = f" ({float(fit.k[index]):+.2g} kg)" if bool(fit.determined[index]) else ""
    best = max(parts, key=parts.__getitem__)
    if best == "payload" and parts[best] > _EXPLAINED:
        return Finding(
            "payload",
            joints,
            f"{text}; a body at the last link explains {100 * parts[best]:.0f} % of the difference"
            f"{mass}",
            "the arm carried another payload or tool",
            f"identify {names[0]} first, and the payload with jaxcslc payload",
            names[1],
        )
    if best == "friction" and parts[best] > _EXPLAINED:
        return Finding(
            "friction",
            joints,
            f"{text}; other friction explains {100 * parts[best]:.0f} % of the difference",
            "another temperature or state of the gears, or torques that the motors did not deliver",
            f"--reidentify {','.join(friction)} with the identification of {names[0]}",
            names[1],
        )
    return Finding(
        "disagreement",
        joints,
        f"{text}; neither a payload nor friction explains the difference",
        "another robot, another base, or joints and units in another order",
        "check it by itself, and identify it by itself",
        names[1],
    )


def _errors(
    network: CSLC, k: Float[np.ndarray, " coefficients"], patterns: Patterns
) -> Float[np.ndarray, " joints"]:
    """Error of each joint as part of its torque's root mean square."""
    mask, torque = np.asarray(patterns.mask), np.asarray(patterns.torque)
    error = torque - np.asarray(regressor_of(network, patterns)) @ k
    squares = np.where(mask, error**2, 0.0).sum(axis=0)
    size = np.where(mask, torque**2, 0.0).sum(axis=0)
    return np.sqrt(squares / np.where(size > 0, size, 1.0))
