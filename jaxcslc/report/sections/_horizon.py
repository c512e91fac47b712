"""Section on prediction over a horizon: positions of open-loop simulation."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from jaxcslc.instruments import HorizonError

from .._blocks import Column, Section, Table
from .._section import AbstractSection, AnyReport


class HorizonSection(AbstractSection):
    """Median errors of simulated positions, some time after simulations started."""

    name = "horizon"
    results = MappingProxyType({"horizon": None})
    entries = MappingProxyType({"horizon": dict})
    position = 14

    @classmethod
    def document_of(cls, result: HorizonError, report: AnyReport) -> Mapping[str, Any]:
        return {"horizon": result.document()}

    def result(self, name: str, report: AnyReport) -> HorizonError:
        data = self.data["horizon"]

        def by_name(entries: Mapping[str, Any]) -> dict[str, np.ndarray]:
            arrays = {name: np.array(values, float) for name, values in entries.items()}
            return {name: np.where(np.isnan(x), np.inf, x) for name, x in arrays.items()}

        return HorizonError(
            np.array(data["horizons"]),
            by_name(data["error"]),
            by_name(data["distance"]),
            tuple(data["starts"]),
            tuple(data["units"]),
        )

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        table = str(self.result(self.name, report))
        yield ["simulated open loop, median absolute error of positions", table]

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        horizon = self.data["horizon"]
        distance = horizon["distance"]
        columns = [
            Column("horizon [s]"),
            Column("starts", "simulations that are that long"),
            Column(
                "coefficients",
                "of this report, of its fit with pre-sliding states, or of the robot's file",
                numeric=False,
            ),
            *(
                Column(f"{joint} [{unit}]", digits=3)
                for joint, unit in zip(report.model.output_names, horizon["units"], strict=True)
            ),
        ]
        if distance:
            columns.append(Column("last frame [m]", "distance of its origin", digits=3))
        rows = tuple(
            (length, horizon["starts"][row], name, *errors[row])
            + ((distance[name][row],) if distance else ())
            for row, length in enumerate(horizon["horizons"])
            for name, errors in horizon["error"].items()
        )
        table = Table(tuple(columns), rows, "Median absolute error of positions", "horizon")
        yield Section(
            "Prediction over a horizon",
            "The arm simulated without feedback, from recorded states and under recorded torques:"
            " how far its positions are from the recorded ones after some time. An empty cell is a"
            " simulation that diverged.",
            [table],
        )
