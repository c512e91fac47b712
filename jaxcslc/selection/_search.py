"""Coordinate search for the settings of the least score, one axis after the other."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

from ..least_squares import Settings


# The search goes over all options this often at most; two rounds are the rule.
_ROUNDS = 4
# Axes with no more values than this are tried in full, longer ones climbed along.
_ALL = 5
# Rounding alone, as between weights of a single joint, is no improvement.
_LEAST_GAIN = 1e-6
# Another family of smoothings must lower the score by a fifth. On simulated arms with white noise
# of 1e-4 rad, a Butterworth filter lowered the score of slow motion by 5 and 14 %, by smoother
# predictions, while the torque errors on faster motion rose to three times those of splines.
_FAMILY_GAIN = 0.2


@dataclasses.dataclass(frozen=True)
class SearchAxis:
    """Option of settings, and the values that a search tries for it.

    **Attributes**

    - `values`: in order.
    - `value_of`: reads the option off settings.
    - `replaced`: settings with another value of it.
    """

    values: tuple[Any, ...]
    value_of: Callable[[Settings], Any]
    replaced: Callable[[Settings, Any], Settings]

    def middle(self) -> Any:
        """The value in the middle."""
        return self.values[len(self.values) // 2]

    def index(self, settings: Settings) -> int | None:
        """Return the position of settings on the axis, None if they are elsewhere."""
        value = self.value_of(settings)
        return self.values.index(value) if value in self.values else None


@dataclasses.dataclass
class CoordinateSearch:
    """Looks for the settings of the least score, one axis after the other.

    Scores are computed once for each settings. Deterministic.

    **Attributes**

    - `scored`: computes the scores of several settings; the least wins.
    - `scores`: all that were computed.
    """

    scored: Callable[[Sequence[Settings]], Sequence[float]]
    scores: dict[Settings, float] = dataclasses.field(default_factory=dict)

    def run(
        self, start: Settings, families: Sequence[SearchAxis], options: Sequence[SearchAxis]
    ) -> Settings:
        """The best settings.

        The family of smoothings that `start` belongs to is searched together with all options,
        round after round until nothing improves. Then each other family is climbed along with
        the options as they are; if one lowers the score by a fifth, the rounds go on with it.

        **Arguments**

        - `start`: on the axis of one of the families and on all axes of options.
        - `families`: axes of one option, of which settings are on one.
        - `options`: axes of options of their own.

        **Returns**

        The settings of the least score within their family of smoothings.
        """
        best = start
        # Where each family did best, to climb on from there.
        starts = [family.middle() for family in families]
        for _ in range(_ROUNDS):
            current = family_of(families, best)
            best = self._rounds(best, (families[current], *options))
            for number, family in enumerate(families):
                if number != current:
                    other = self._along(family, family.replaced(best, starts[number]))
                    starts[number] = family.value_of(other)
                    best = self._better(best, [other], _FAMILY_GAIN)
            if family_of(families, best) == current:
                break
        return best

    def _rounds(self, best: Settings, axes: Sequence[SearchAxis]) -> Settings:
        for _ in range(_ROUNDS):
            before = best
            for axis in axes:
                best = self._along(axis, best)
            if best == before:
                break
        return best

    def _along(self, axis: SearchAxis, best: Settings) -> Settings:
        """The best settings that are reached along one axis."""
        values, size = axis.values, len(axis.values)
        if size <= _ALL:
            return self._better(best, [axis.replaced(best, value) for value in values])
        for step in (2, 1):
            while True:
                index = axis.index(best)
                assert index is not None
                beside = [i for i in (index - step, index + step) if 0 <= i < size]
                better = self._better(best, [axis.replaced(best, values[i]) for i in beside])
                if better == best:
                    break
                best = better
        return best

    def _better(
        self, best: Settings, others: Sequence[Settings], gain: float = _LEAST_GAIN
    ) -> Settings:
        """The best of some settings; `best` itself if none lowers its score by so large a part."""
        missing = [some for some in dict.fromkeys((*others, best)) if some not in self.scores]
        self.scores |= zip(missing, self.scored(missing), strict=True)
        better = min(others, key=self.scores.__getitem__, default=best)
        improved = self.scores[better] < (1.0 - gain) * self.scores[best]
        return better if improved else best


def family_of(families: Sequence[SearchAxis], settings: Settings) -> int:
    """The number of the family that settings belong to."""
    return next(i for i, family in enumerate(families) if family.index(settings) is not None)
