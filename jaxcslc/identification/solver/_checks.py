from ..._environment import require_float64
from ...motion import Patterns
from ...network import AbstractLinearNetwork
from ._compiled import traced
from ._identification import RESULTS, Identification, result_of


def check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """**Raises** `ValueError` for a value that is none of the choices."""
    if value not in choices:
        raise ValueError(f"{name} is {value!r}; expected {' or '.join(map(repr, choices))}")


def check_patterns(network: AbstractLinearNetwork, patterns: Patterns) -> None:
    """**Raises** `ValueError` for patterns of another size, and for others than float64."""
    if patterns.joints != network.joint_count:
        raise ValueError(
            f"patterns have {patterns.joints} joints, {network.name!r} has {network.joint_count}"
        )
    if patterns.q.shape[-1] != network.motion_count:
        raise ValueError(
            f"patterns have {patterns.q.shape[-1]} columns of motion, {network.name!r} has"
            f" {network.motion_count}"
        )
    require_float64(patterns.q, patterns.qd, patterns.qdd, patterns.torque)


def checked(fit: Identification, throw: bool) -> Identification:
    """**Raises** `RuntimeError` for results that are failures, if `throw` says so."""
    if not throw:
        return fit
    # Rank deficiency is an answer, not a failure.
    if not traced(fit.result) and result_of(fit) in ("successful", "rank_deficient"):
        return fit
    failed = (fit.result == RESULTS.nonfinite) | (fit.result == RESULTS.no_equations)
    return fit.result.error_if(fit, failed)
