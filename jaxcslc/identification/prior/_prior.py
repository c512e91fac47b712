import dataclasses
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..._toml_document import toml_document
from ...inertia import KNOWN_PARAMETERS, Known, LinkKnowledge
from ...manipulator import Manipulator
from ...network import AbstractLinearNetwork


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is known of a robot before it is identified: of coefficients, and of its links.

    **Attributes**

    - `coefficients`: `Known` values by the names that the network gives them.
    - `links`: by link, `Known` values of `mass` [kg], of the centre of gravity `rx`, `ry`, `rz` [m]
      and of `motor_inertia` [kg m² or kg]. A link is named by its body or joint in the robot's
      file, or by its number from 1. Centres are in the frames of the file's bodies, which are
      meant without what the file fixes to them.

    What is known of links changes possible bodies, not the free fit: a coefficient is a combination
    of many links' parameters.

    **Raises**

    - `ValueError`: a parameter of a link that is none of these.

    >>> import jaxcslc as jc
    >>> from jaxcslc.identification import Known, Prior
    >>> prior = Prior({"kv1": Known(2.0, 0.1)}, {"3": {"mass": Known(low=1.0, high=4.0)}})
    >>> print(prior)
    kv1 2 ± 0.1; link 3: mass from 1 to 4
    """

    coefficients: Mapping[str, Known] = dataclasses.field(default_factory=dict[str, Known])
    links: Mapping[str, Mapping[str, Known]] = dataclasses.field(
        default_factory=dict[str, Mapping[str, Known]]
    )

    def __post_init__(self) -> None:
        for link, parameters in self.links.items():
            for name in parameters:
                if name not in KNOWN_PARAMETERS:
                    raise ValueError(
                        f"prior, links, {link}: unknown parameter {name!r}; expected some of"
                        f" {', '.join(KNOWN_PARAMETERS)}"
                    )

    def coefficient_values(self, network: AbstractLinearNetwork) -> dict[int, Known]:
        """What is known of coefficients, by index.

        **Raises**

        - `ValueError`: a name that no coefficient has.
        """
        for name in self.coefficients:
            if name not in network.names:
                raise ValueError(
                    f"prior, coefficients: {name!r} is none of {network.name!r}'s; expected some of"
                    f" {network.names[0]} to {network.names[-1]} (jaxcslc derive lists them)"
                )
        return {network.names.index(name): known for name, known in self.coefficients.items()}

    def link_values(self, robot: Manipulator) -> tuple[LinkKnowledge, ...]:
        """What is known of links, in the order of the joints.

        **Raises**

        - `ValueError`: a name that no link has, or a motor inertia of a joint that has none.
        """
        bodies = robot.source.links if robot.source is not None else ()
        entries: list[LinkKnowledge] = []
        for name, parameters in self.links.items():
            candidates = [
                index
                for index in range(robot.joint_count)
                if name == str(index + 1)
                or (index < len(bodies) and name == bodies[index])
                or name == robot.joint_names[index]
            ]
            if len(candidates) != 1:
                names = bodies or robot.joint_names
                raise ValueError(
                    f"prior, links: {name!r} names {len(candidates) or 'no'} link"
                    f"{'s' if candidates else ''} of {robot.name!r}; expected one of"
                    f" {', '.join(names)}, or a number from 1 to {robot.joint_count}"
                )
            for parameter, known in parameters.items():
                if parameter == "motor_inertia" and not robot.inertia[candidates[0]].motor:
                    raise ValueError(
                        f"prior, links, {name}: motor_inertia is known, and {robot.name!r} has none"
                        " at this joint"
                    )
                entries.append(LinkKnowledge(candidates[0], parameter, known))
        return tuple(entries)

    def document(self) -> dict[str, Any]:
        """It as plain data, as `load_prior` reads it."""
        return {
            "coefficients": {name: known.document() for name, known in self.coefficients.items()},
            "links": {
                link: {name: known.document() for name, known in parameters.items()}
                for link, parameters in self.links.items()
            },
        }

    def __str__(self) -> str:
        return "; ".join(self._parts()) or "nothing"

    def _parts(self) -> Iterator[str]:
        if self.coefficients:
            yield ", ".join(f"{name} {known}" for name, known in self.coefficients.items())
        for link, parameters in self.links.items():
            listed = ", ".join(f"{name} {known}" for name, known in parameters.items())
            yield f"{'link ' if link.isdigit() else ''}{link}: {listed}"


def load_prior(path: str | Path) -> Prior:
    """Reads what is known before an identification from a TOML file.

    Tables `[coefficients]` and `[links.NAME]`, see `Prior`. An entry is a number, which is fixed;
    or `{ value = 2.4, error = 0.1 }`, a value and its standard error; or `{ low = 0, high = 3 }`,
    either of which may be left out; or all of them.

    **Arguments**

    - `path`: of the file.

    **Returns** a `Prior`.

    **Raises**

    - `ValueError`: the file holds something else; the message names file and entry.

    >>> import tempfile
    >>> from jaxcslc.identification import load_prior
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "priors.toml"
    ...     _ = path.write_text("[links.3]\\nmass = { value = 2.4, error = 0.1 }\\n")
    ...     print(load_prior(path))
    link 3: mass 2.4 ± 0.1
    """
    path = Path(path)
    return prior_from(toml_document(path, "file of priors", ValueError), str(path))


def prior_from(document: Mapping[str, Any], where: str) -> Prior:
    """Return what is known before, from tables as `Prior.document` returns them.

    **Arguments**

    - `document`: with entries `coefficients` and `links`, either of which may be missing.
    - `where`: they were read, for messages.

    **Raises**

    - `ValueError`: they hold something else; the message names the entry.
    """
    if unknown := sorted(document.keys() - {"coefficients", "links"}):
        raise ValueError(f"{where}: unknown entry {unknown[0]!r}; expected coefficients or links")
    coefficients = _known_values(document.get("coefficients", {}), f"{where}, coefficients")
    tables = _table(document.get("links", {}), f"{where}, links")
    links = {
        name: _known_values(values, f"{where}, links, {name}") for name, values in tables.items()
    }
    try:
        return Prior(coefficients, links)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _known_values(values: Any, where: str) -> dict[str, Known]:
    return {
        name: _known(value, f"{where}, {name}") for name, value in _table(values, where).items()
    }


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{where}: expected a table, got {value!r}")
    return value


def _known(value: Any, where: str) -> Known:
    entries = value if isinstance(value, dict) else {"value": value}
    if unknown := sorted(entries.keys() - {"value", "error", "low", "high"}):
        raise ValueError(f"{where}: unknown entry {unknown[0]!r}; expected value, error, low, high")
    for name, number in entries.items():
        usable = isinstance(number, int | float) and not isinstance(number, bool)
        if not usable or not abs(number) < math.inf:
            raise ValueError(f"{where}: {name}: expected a finite number, got {number!r}")
    try:
        return Known(**{name: float(number) for name, number in entries.items()})
    except (OverflowError, ValueError) as error:
        raise ValueError(f"{where}: {error}") from None
