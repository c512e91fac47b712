"""Report of a derivation: coefficients, their formulas, identifiability."""

import dataclasses
from pathlib import Path
from textwrap import fill
from typing import Any

from .._scratch import all_or_nothing
from ..derivation import StructuralIdentifiability, structural_identifiability
from ..network import CSLC
from ._coefficients import (
    coefficient_rows,
    coefficient_text,
    expression_legend,
    legend_text,
    model_lines,
)
from ._files import write_csv, write_json


# Counting the tables of 12 right-angled joints takes ten times as long as all the rest.
_MOST_JOINTS = 9
_NO_TABLES = (
    f"no closed-form tables: for more than {_MOST_JOINTS} joints, or twists other than multiples"
    " of 90°, they have tens of thousands of links; torque is computed by recursion"
)
_COUPLED = (
    "  (coupled joints: their shared coefficients are not part of this list, and may replace motor"
    " inertias)"
)
_FOLLOWING = (
    "  (as if every joint moved by itself: of joints that follow others, fewer; identify names"
    " those that are left undetermined)"
)


@dataclasses.dataclass(frozen=True, eq=False)
class DerivationReport:
    """Inputs, links and named coefficients of a network, and what any recording can determine.

    `print` shows what `jaxcslc derive` prints; `save` writes what it writes.

    **Attributes**

    - `network`: that was derived.
    - `identifiability`: of each mass, first moment and moment of inertia, from the algebra alone.

    >>> import jaxcslc as jc
    >>> from jaxcslc.report import DerivationReport
    >>> report = DerivationReport.of(jc.derive(jc.examples.pendulum()))
    >>> report.has_practical_tables
    True
    """

    network: CSLC
    identifiability: tuple[StructuralIdentifiability, ...]

    @classmethod
    def of(cls, network: CSLC) -> "DerivationReport":
        """Return the report on a network."""
        return cls(network, tuple(structural_identifiability(network.algebra)))

    @property
    def has_practical_tables(self) -> bool:
        """True if the closed form is short enough to print.

        Up to nine joints, and all twists are multiples of 90°.
        """
        links = self.network.algebra.chain.links
        return len(links) <= _MOST_JOINTS and all(
            0 in link.twist and 0 in link.branch for link in links
        )

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Writes `coefficients.csv`, `identifiability.csv` and, of practical size, `tables.json`.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file.
        - `OSError`: the folder cannot be written.
        """
        folder, names = Path(folder), ["coefficients.csv", "identifiability.csv"]
        with all_or_nothing(folder) as scratch:
            write_csv(scratch / names[0], coefficient_rows(self.network))
            write_csv(scratch / names[1], [_row(entry) for entry in self.identifiability])
            if self.has_practical_tables:
                names.append("tables.json")
                write_json(scratch / names[2], derivation_document(self.network))
        return tuple(folder / name for name in names)

    def __str__(self) -> str:
        network = self.network
        sizes = _sizes(network) if self.has_practical_tables else _NO_TABLES
        heading = "\n".join(model_lines(network))
        lines = [
            f"{heading}\n{sizes}\n\n{coefficient_text(coefficient_rows(network))}\n",
            f"{legend_text(expression_legend(network))}\n",
            _identifiability(self.identifiability),
            *([_COUPLED] if network.robot.coupled else []),
            *([_FOLLOWING] if network.joint_count < network.robot.joint_count else []),
        ]
        return "\n".join(lines)


def derivation_document(network: CSLC) -> dict[str, Any]:
    """The tables of inputs and links as plain data; indices count from 1, as in Appendix B."""

    def table(name: str) -> dict[str, Any]:
        source = getattr(network.algebra, name)
        return {
            "inputs": source.labels,
            "nodes": [[index + 1 for index in column] for column in source.columns],
            "links": [
                {
                    "input": link.input + 1,
                    "node": link.column + 1,
                    "weight": {network.names[i]: float(value) for i, value in link.weights},
                }
                for link in source.links
            ],
        }

    return {
        "robot": network.robot.name,
        "lengths": network.algebra.lengths,
        "coefficients": coefficient_rows(network),
        "order": network.order,
        "order_per_joint": network.order_per_joint,
        **{name: table(name) for name in ("mass", "velocity", "gravity")},
    }


def _sizes(network: CSLC) -> str:
    counts = network.counts
    lines = [
        f"{name}: {counts[name]['inputs']} inputs, {counts[name]['links']} links,"
        f" {counts[name]['coefficients']} coefficients"
        for name in ("mass", "velocity", "gravity")
    ]
    per_joint = ", ".join(str(order) for order in network.order_per_joint)
    return "\n".join([*lines, f"network order {network.order}; per joint {per_joint}"])


def _identifiability(entries: tuple[StructuralIdentifiability, ...]) -> str:
    verdicts: dict[str, list[str]] = {"alone": [], "only in combinations": [], "not at all": []}
    for entry in entries:
        verdicts[entry.verdict].append(entry.parameter)
    text = "link parameters that motion and torque can determine:"
    for verdict, names in verdicts.items():
        listed = fill(", ".join(names), 96, initial_indent="    ", subsequent_indent="    ")
        text += f"\n  {verdict} ({len(names)})" + (f"\n{listed}" if names else "")
    return text


def _row(entry: StructuralIdentifiability) -> dict[str, str | int]:
    return {
        "parameter": entry.parameter,
        "link": entry.link,
        "verdict": entry.verdict,
        "coefficients": " ".join(entry.coefficients),
    }
