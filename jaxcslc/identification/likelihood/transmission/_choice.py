from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np

from .._problem import Problem
from ..band import Spectrum
from ..search import Minimum
from ._parameters import TransmissionParameters
from ._search_start import SearchStart
from ._staged_search import transmission_search
from ._transmission_equations import TransmissionEquations


# A joint's gears are rigid if their compliance is not above so many standard errors, or if their
# play is below 0 by so many of them and by the width of its edges: teeth do not overlap. A spring
# and a light link may follow noise of torque so.
_SIGNIFICANT, _OVERLAP = 3.0, 2.0


class TransmissionChoice(eqx.Module):
    """Whether a recording supports rotors and links that move apart.

    **Attributes**

    - `rigid`, `apart`: Schwarz's criterion: minus twice the logarithm of the likelihood, and the
      logarithm of the number of equations for each further parameter. The latter is infinite if no
      compliance is significant.
    - `joints`: whose links were apart in the latter, from 1.
    - `converged`: whether the search of the latter did. One that did not is never supported: of
      what its coefficients are, its likelihood says nothing.
    """

    rigid: float = eqx.field(static=True)
    apart: float = eqx.field(static=True)
    joints: tuple[int, ...] = eqx.field(static=True)
    converged: bool = eqx.field(static=True, default=True)

    @property
    def supported(self) -> bool:
        """Whether rotors and links are apart."""
        return self.converged and self.apart < self.rigid

    def document(self) -> dict[str, Any]:
        """As plain data; None in place of an infinite criterion."""
        apart = self.apart if np.isfinite(self.apart) else None
        values = {"rigid": self.rigid, "apart": apart, "joints": list(self.joints)}
        return {**values, "converged": self.converged}


def choice_line(choice: Mapping[str, Any]) -> str:
    """A choice in words.

    **Arguments**

    - `choice`: a `TransmissionChoice.document`.

    >>> choice_line({"rigid": 120.0, "apart": 100.5, "joints": [2]})
    'gears that give way at joint 2: supported, Schwarz criterion 19.5 below that of rigid gears'
    """
    if choice["apart"] is None:
        return "gears that give way: not supported by the recording"
    joints = ", ".join(str(joint) for joint in choice["joints"])
    if not choice.get("converged", True):
        return f"gears that give way at joint {joints}: not used, their search did not converge"
    difference = choice["apart"] - choice["rigid"]
    verdict = "supported" if difference < 0.0 else "not supported"
    side = "below" if difference < 0.0 else "above"
    return (
        f"gears that give way at joint {joints}: {verdict}, Schwarz criterion"
        f" {abs(difference):.4g} {side} that of rigid gears"
    )


def chosen_minimum(
    problem: Problem,
    start: SearchStart,
    rigid: Minimum,
    links: list[int],
    progress: Callable[[str], None],
) -> tuple[Minimum, TransmissionChoice]:
    """Rotors and links apart where the likelihood supports it, joint by joint.

    **Arguments**

    - `problem`, `start`: with rigid gears; `rigid`: its minimum.
    - `links`: that may move apart from their rotors, from 0.
    """
    while links:
        apart = transmission_search(problem, start, links, progress)
        parameters = TransmissionParameters.of(apart.point.transmission)
        spectrum, scale = Spectrum.of(apart.factored.information), apart.objective.scale
        first = len(apart.point.k) + len(apart.point.slopes)
        index = np.arange(first, first + len(apart.point.transmission))
        variance = np.diag(spectrum.covariance)[index]
        error = TransmissionParameters.of(np.sqrt(variance) * scale[index])
        equations = apart.objective.equations
        assert isinstance(equations, TransmissionEquations)
        significant = parameters.compliance > _SIGNIFICANT * error.compliance
        significant &= parameters.play > -_OVERLAP * error.play - equations.width
        if np.all(significant):
            criteria = criterion(rigid), criterion(apart)
            numbers = tuple(link + 1 for link in links)
            choice = TransmissionChoice(*criteria, numbers, apart.converged)
            return (apart if choice.supported else rigid), choice
        links = [link for link, keep in zip(links, significant, strict=True) if keep]
    return rigid, TransmissionChoice(criterion(rigid), float(np.inf), ())


def criterion(minimum: Minimum) -> float:
    """Schwarz's criterion of a search, with positions, of rotors and links, integrated out.

    By Laplace's method. Positions of rotors have no density beforehand; links' follow from theirs
    by the equations of gears, whose determinant counts, and from where they are at first, within
    about as much as gears give way.
    """
    linear, point = minimum.linear, minimum.point
    objective, weights = linear.objective, linear.objective.weights
    n = len(point.slopes)
    f = point.q.shape[1] - n
    torque = weights.torque
    if objective.sticking is not None:
        torque = np.where(objective.sticking.mask, 0.0, torque)
    position = weights.position[:, :n]
    result = float(objective.value(linear.present))
    if objective.intervals is not None:
        counts = objective.intervals.edge[:, :n] > 0.0
        result += 2.0 * float(np.sum(np.log(objective.intervals.step[:, :n][counts])))
        position = np.where(counts, 0.0, position)
    for values in (torque, position, weights.standstill, weights.turn):
        rows = values[values > 0.0]
        result += float(np.sum(np.log(2.0 * np.pi / rows)))
    result += minimum.factored.log_determinant - linear.order.size * float(np.log(2.0 * np.pi))
    equations = objective.equations
    if not isinstance(equations, TransmissionEquations):
        return result
    # What the next position of links does to equations of gears.
    series = n + f
    next_link = linear.by_position[:, n:, 2 * series + n : 3 * series]
    counted = np.all(weights.torque[:, n:] > 0.0, axis=1)
    result -= 2.0 * float(np.sum(np.linalg.slogdet(next_link[counted])[1]))
    windup = np.std(point.q[:, equations.joints] - point.q[:, n:], axis=0)
    result += 2.0 * float(np.sum(np.log(2.0 * np.pi * np.maximum(windup, 1e-12) ** 2)))
    return result + len(point.transmission) * float(np.log(max(minimum.counted[:, :n].sum(), 1)))
