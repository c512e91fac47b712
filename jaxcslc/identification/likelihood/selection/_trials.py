from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float

from ....motion import Recording
from ....network import CSLC
from ..._held_out import RelativeError
from .._left_out import Estimator, LeftOut
from .._likelihood_fit import LikelihoodFit
from .._problem import Problem
from ..search import Minimum, search
from ._selection import OrderChoice, SpacingTrial


# Spacings that are tried beside 1: each takes its part of the time.
_SPACINGS = (2, 3, 6)
# Positions with more than so many times the noise of readings move as rigid links do not.
EXCESS = 1.3


def excess_noise(problem: Problem, minimum: Minimum) -> Float[np.ndarray, " joints"]:
    """(n,) estimated noise of positions over that of encoders' steps, or over what readings
    without steps scatter by; the greatest of several recordings.

    Above 1, joints move as the equations of rigid links do not.
    """
    steps = problem.encoder_step > 0.0
    expected = np.where(steps, problem.least_position_noise, problem.scatter)
    return np.max(minimum.position_noise / np.maximum(expected, 1e-300), axis=0)


def spacing_trials(
    estimator: Callable[[int], Estimator],
    network: CSLC,
    recordings: Sequence[Recording],
    plain: LikelihoodFit,
    progress: Callable[[str], None],
) -> tuple[SpacingTrial, ...]:
    """Spacings of positions, judged on motion that was not fitted.

    Likelihoods of different spacings are of different data. So coefficients from the first three
    quarters of recordings, for each spacing, are judged by how well they agree with the last
    quarter when its positions are estimated: all at the largest spacing, which suits rigid links
    best.

    **Arguments**

    - `estimator`: with a spacing.
    - `plain`: a fit to everything with positions at every sample.
    - `progress`: is called with a few words at each step.

    **Returns** a trial for each spacing above 1; none where a recording is too short to be divided,
    or one of its parts has too little motion.
    """
    left_out = LeftOut.of(recordings)
    if left_out is None:
        return ()
    near = plain.at(left_out.rows)
    fits: dict[int, LikelihoodFit] = {}
    for every in (1, *_SPACINGS):
        words = f"maximum likelihood: trying every {every}"
        start = near if every == 1 else None
        # Where too little motion is left, or rounding ends a search, there is no fit to be judged.
        try:
            fits[every] = estimator(every).fit(
                network, left_out.early, start, lambda _, words=words: progress(words)
            )
        except (ValueError, RuntimeError):
            continue
    if 1 not in fits:
        return ()
    largest = max(fits)
    try:
        relative = left_out.relative(estimator(largest), fits, base=1, level=largest)
    except (ValueError, RuntimeError):
        return ()
    return tuple(SpacingTrial(every, error) for every, error in relative.items() if every > 1)


def with_spectrum(
    problem: Problem,
    minimum: Minimum,
    order: int,
    fit: Callable[[Minimum], LikelihoodFit],
    white: Estimator,
    recordings: Sequence[Recording],
    progress: Callable[[str], None],
) -> tuple[Minimum, OrderChoice]:
    """The minimum with torque noise that has a spectrum of its own, unless something speaks
    against it.

    Friction that a model lacks is slow, and the spectrum of what it leaves is steep: a filter that
    makes that white takes out slow torque, and with it most of what is known of gravity and
    inertia. A likelihood of the same motion prefers it all the same. (Of a KUKA KR300, the noise of
    four joints of six drifts, and errors on other motion grew from 52 to 92 % at its first joint;
    of a Franka Panda, motion left out has 60 % more of misfit.)

    **Arguments**

    - `minimum`: with white noise; `order`: of the autoregression.
    - `fit`: makes a fit of a minimum.
    - `white`: the estimator with white noise and the spacing of this minimum.
    - `progress`: is called with a few words at each step.
    """
    coefficients = np.zeros((order, problem.readings.position.shape[1]))
    coloured = search(
        problem,
        minimum.point,
        minimum.torque_noise,
        minimum.position_noise,
        progress,
        noise_coefficients=coefficients,
    )
    drifting = coloured.objective.whitening.drifting
    if drifting:
        return minimum, OrderChoice(order, drifting, None)
    plain = fit(minimum)
    trial = _of_orders(white, recordings, plain, fit(coloured), progress)
    choice = OrderChoice(order, (), trial)
    return (coloured if choice.used else minimum), choice


def _of_orders(
    white: Estimator,
    recordings: Sequence[Recording],
    plain: LikelihoodFit,
    coloured: LikelihoodFit,
    progress: Callable[[str], None],
) -> RelativeError | None:
    """The misfit of motion left out by fits with a spectrum over that by fits without; None where
    it cannot be judged."""
    left_out = LeftOut.of(recordings, plain.every)
    if left_out is None:
        return None
    words = "maximum likelihood: trying a spectrum of torque noise"
    try:
        fits = {
            name: white.fit(
                near.network, left_out.early, near.at(left_out.rows), lambda _: progress(words)
            )
            for name, near in (("plain", plain), ("coloured", coloured))
        }
        return left_out.relative(white, fits, base="plain", level="plain")["coloured"]
    except (ValueError, RuntimeError):
        return None
