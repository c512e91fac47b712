"""Directions of joints, where they turn and where they rest."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclasses.dataclass(frozen=True)
class Signs:
    """Direction of every joint at every equation, its reversals, and where it sticks.

    Fixed while the positions move: with these, friction is smooth in them.

    **Attributes**

    - `direction`: (equations, n), 1 or -1: the sign of velocity, after the turn at a reversal.
    - `samples`, `joints`: (reversals,) of each reversal, the sample next to it.
    - `turn`: (reversals,) the moment of each where velocity, interpolated linearly, is zero, in
      intervals after its sample.
    - `uncertain`: (equations, n), whether friction may have any value up to break-away.
    - `stuck`: (intervals, n), whether the joint is at rest.
    """

    direction: Float[np.ndarray, "equations joints"]
    samples: Int[np.ndarray, " reversals"]
    joints: Int[np.ndarray, " reversals"]
    turn: Float[np.ndarray, " reversals"]
    uncertain: Bool[np.ndarray, "equations joints"]
    stuck: Bool[np.ndarray, "intervals joints"]

    @classmethod
    def of(
        cls,
        q: Float[np.ndarray, "samples joints"],
        time: Float[np.ndarray, " samples"],
        stuck: Bool[np.ndarray, "intervals joints"],
        *,
        margin: int,
        modelled: bool,
        joined: Bool[np.ndarray, " equations"] | None = None,
        ambiguous: Bool[np.ndarray, "equations joints"] | None = None,
    ) -> "Signs":
        """Return the signs of a motion.

        - `q`: positions.
        - `time`: of the samples.
        - `stuck`: where joints are at rest.
        - `margin`: how many equations on either side of a change of sign are uncertain.
        - `modelled`: whether a reversal on its own, with clear motion on both sides, is a moment
          to be estimated, instead of uncertain equations.
        - `joined`: equations that span two recordings; there are none if omitted.
        - `ambiguous`: equations that are uncertain whatever the motion; none if omitted.
        """
        intervals = np.diff(time)
        mean = np.diff(q, axis=0) / intervals[:, None]
        sign = np.sign(mean)
        velocity = (intervals[1:, None] * mean[:-1] + intervals[:-1, None] * mean[1:]) / (
            intervals[1:] + intervals[:-1]
        )[:, None]
        direction = np.where(velocity < 0.0, -1.0, 1.0)
        at_rest = stuck[1:] | stuck[:-1]
        changes = sign[:-1] * sign[1:] <= 0.0
        uncertain = dilated(at_rest, 3)
        if joined is not None:
            uncertain |= dilated(joined[:, None], margin)
        if ambiguous is not None:
            uncertain |= dilated(ambiguous, _ALONE)
        samples: list[int] = []
        joints: list[int] = []
        turns: list[float] = []
        for joint in range(q.shape[1]):
            rows = np.flatnonzero(changes[:, joint] & ~uncertain[:, joint])
            for position, row in enumerate(rows):
                apart = 2 * _ALONE
                if position:
                    apart = min(apart, row - rows[position - 1])
                if position + 1 < len(rows):
                    apart = min(apart, rows[position + 1] - row)
                clear = (
                    modelled
                    and apart > _ALONE
                    and 2 <= row < len(changes) - 2
                    and not uncertain[row - 2 : row + 3, joint].any()
                )
                if not clear:
                    uncertain[max(row - margin, 0) : row + margin + 1, joint] = True
                    continue
                before, after = mean[row, joint], mean[row + 1, joint]
                # Where velocity, linear between the middles of the two intervals, is zero.
                turn = 0.5 * (before + after) / (before - after) if before != after else 0.0
                samples.append(int(row) + 1)
                joints.append(joint)
                turns.append(float(np.clip(turn, -0.5, 0.5)))
                direction[row - 1 : row + 2, joint] = np.sign(mean[row + 2, joint])
        return cls(
            direction,
            np.array(samples, int),
            np.array(joints, int),
            np.array(turns, float),
            uncertain,
            stuck,
        )

    def turns(
        self, turn: Float[np.ndarray, " reversals"] | None = None
    ) -> Float[np.ndarray, "equations joints"]:
        """Return (equations, n): when the joint turns within each equation's two intervals, -1 if
        not."""
        turn = self.turn if turn is None else turn
        result = np.full(self.direction.shape, -1.0)
        for offset in (-1, 0, 1):
            result[self.samples - 1 + offset, self.joints] = np.clip(turn - offset, -1.0, 1.0)
        return result

    def moments(
        self, turn: Float[np.ndarray, " reversals"], samples: int
    ) -> Float[np.ndarray, "samples joints"]:
        """Return (samples, n): the moment of the reversal next to a sample, NaN where there is
        none."""
        result = np.full((samples, self.direction.shape[1]), np.nan)
        result[self.samples, self.joints] = turn
        return result

    def from_moments(
        self, moments: Float[np.ndarray, "samples _"]
    ) -> Float[np.ndarray, " reversals"]:
        """Return moments of the reversals from `moments` where it has them, else `self.turn`."""
        result = self.turn.copy()
        for offset in (-1, 1, 0):  # the latter's counts, where there are two
            near = moments[self.samples + offset, self.joints] + offset
            result = np.where(np.abs(near) < LATEST_TURN, near, result)
        return result

    def without_moments(
        self, moments: Float[np.ndarray, "samples _"]
    ) -> Bool[np.ndarray, "equations joints"]:
        """Return equations of reversals that `moments` has not within a sample."""
        result = np.zeros(self.direction.shape, bool)
        near = [moments[self.samples + offset, self.joints] for offset in (-1, 0, 1)]
        result[self.samples - 1, self.joints] = np.all(np.isnan(near), axis=0)
        return result

    def unmatched(self, other: "Signs") -> Bool[np.ndarray, "equations joints"]:
        """Return equations of reversals, of either, that are more than a sample from all of the
        other."""
        mine, theirs = (x.moments(x.turn, len(x.direction) + 2) for x in (self, other))
        return self.without_moments(theirs) | other.without_moments(mine)

    def at_bounds(
        self, turn: Float[np.ndarray, " reversals"]
    ) -> Bool[np.ndarray, "equations joints"]:
        """Return equations of reversals whose moments are as far from their samples as they may
        be: there velocity is zero at one moment, and friction changes its sign at another."""
        result = np.zeros(self.direction.shape, bool)
        late = np.abs(turn) >= LATEST_TURN
        result[self.samples[late] - 1, self.joints[late]] = True
        return result

    def carried(
        self, before: "Signs", turn: Float[np.ndarray, " earlier"]
    ) -> Float[np.ndarray, " reversals"]:
        """Return moments of the reversals, those of earlier signs where there are, else
        `self.turn`."""
        moments = {
            joint: (before.samples + turn)[before.joints == joint] for joint in set(before.joints)
        }
        result = self.turn.copy()
        for index, (sample, joint) in enumerate(zip(self.samples, self.joints, strict=True)):
            others = moments.get(joint, np.empty(0)) - sample
            if len(others) and np.abs(others).min() < LATEST_TURN:
                result[index] = others[np.abs(others).argmin()]
        return result


# A moment is at most so many intervals from its sample.
LATEST_TURN = 1.4
# A reversal is modelled if no other one is within so many samples.
_ALONE = 4


def dilated(mask: Bool[np.ndarray, "rows joints"], by: int) -> Bool[np.ndarray, "rows joints"]:
    """Return a mask that is true also so many rows before and after each true row."""
    result = mask.copy()
    for offset in range(1, by + 1):
        result[offset:] |= mask[:-offset]
        result[:-offset] |= mask[offset:]
    return result


def runs(mask: Bool[np.ndarray, " rows"]) -> list[tuple[int, int]]:
    """Return first row and row after the last of each stretch of true rows.

    >>> runs(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    edges = np.flatnonzero(np.diff(np.r_[0, mask.astype(int), 0])).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def rests(
    position: Float[np.ndarray, "samples joints"],
    speed: Float[np.ndarray, "samples joints"],
    resolution: Float[np.ndarray, " joints"],
    slowest: Float[np.ndarray, " joints"],
) -> Bool[np.ndarray, "intervals joints"]:
    """Tell where joints are at rest: readings stay the same for long, and speed is small.

    - `position`: as recorded [rad or m]; `speed`: of the smoothed motion [rad/s or m/s].
    - `resolution`: of the encoders; readings that differ by less than half of it are the same.
    - `slowest`: speed below which a joint counts as slow [rad/s or m/s].
    """
    stuck = np.zeros((len(position) - 1, position.shape[1]), bool)
    for joint in range(position.shape[1]):
        same = np.abs(np.diff(position[:, joint])) < 0.5 * resolution[joint]
        slow = np.maximum(speed[:-1, joint], speed[1:, joint]) < slowest[joint]
        for start, end in runs(same & slow):
            if end - start >= _LONG:
                stuck[start + _ENDS : end - _ENDS, joint] = True
    return stuck


# Readings of a rest are the same for so many intervals; what it may move at its ends is left out.
_LONG, _ENDS = 16, 2
