from typing import NamedTuple

from jaxtyping import Array, Bool, Float, Int

from ._recursive_least_squares import NormalEquations


class PayloadEstimate(NamedTuple):
    """The estimate of a payload at one instant, in the frame of the link that carries it.

    **Attributes**

    - `body`: its ten inertial parameters in the order of `BODY`, physically possible.
    - `covariance`: of the unconstrained estimate, (10, 10).
    - `mass`, `mass_error`: and its standard error [kg].
    - `centre`, `centre_error`: centre of gravity and its standard error, (3,) [m]; the error is
      infinite while the mass may be zero.
    - `carrying`: whether there is a payload, as decided last; see `PayloadEstimator`.
    - `picked_up`, `put_down`: when that was detected last [s since `begin`]; −1 for never.
    - `change`: disagreement of the latest motion with the estimate: χ² of ten degrees of freedom.
    - `evidence`: for the next change, the natural logarithm of its likelihood ratio: for a payload
      while there is none, for none while there is one.
    """

    body: Float[Array, "10"]
    covariance: Float[Array, "10 10"]
    mass: Float[Array, ""]
    mass_error: Float[Array, ""]
    centre: Float[Array, "3"]
    centre_error: Float[Array, "3"]
    carrying: Bool[Array, ""]
    picked_up: Float[Array, ""]
    put_down: Float[Array, ""]
    change: Float[Array, ""]
    evidence: Float[Array, ""]


class PayloadState(NamedTuple):
    """The memory of a `PayloadEstimator`.

    **Attributes**

    - `position`: the latest reading, (n,) [rad or m].
    - `torque`: the torque command for it, (n,) [N m or N].
    - `motion`, `effort`: states of the filters on readings and on torques, (lags, n).
    - `samples`, `time`: since `begin` [1], [s].
    - `since_update`: time since the latest update [s].
    - `motion_time`: time in motion since the last reset [s].
    - `rest_time`: time for which all joints have been at rest [s].
    - `disagreement_time`, `evidence_time`: time in motion for which the disagreement, or the
      evidence, has exceeded its threshold [s].
    - `long_term`, `short_term`: equations of the present payload, and of the latest motion.
    - `candidate`, `candidate_time`: equations since the last standstill before which nothing spoke
      for a change, and time in motion since then [s].
    - `absence`: cumulative sum of the evidence against the payload that is carried.
    - `undecided`: whether there is a payload is unknown, after a change.
    - `estimate`: the present `PayloadEstimate`.
    """

    position: Float[Array, " joints"]
    torque: Float[Array, " joints"]
    motion: Float[Array, "lags joints"]
    effort: Float[Array, "lags joints"]
    samples: Int[Array, ""]
    time: Float[Array, ""]
    since_update: Float[Array, ""]
    motion_time: Float[Array, ""]
    rest_time: Float[Array, ""]
    disagreement_time: Float[Array, ""]
    evidence_time: Float[Array, ""]
    long_term: NormalEquations
    short_term: NormalEquations
    candidate: NormalEquations
    candidate_time: Float[Array, ""]
    absence: Float[Array, ""]
    undecided: Bool[Array, ""]
    estimate: PayloadEstimate
