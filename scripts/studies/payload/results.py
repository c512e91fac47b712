"""Tables of the payload study."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from jaxcslc._text_table import text_table
from scripts.studies.payload.arms import LEARNT, METHODS, NOT_LEARNT
from scripts.studies.payload.errors import SIGMAS
from scripts.studies.payload.task import CASES, MOMENTS
from scripts.studies.tables import median_text


_HAND = {
    "carrying": "carrying",
    "last leg": "on the last leg",
    "arrival": "arriving",
    "place": "at the place",
}


PAGE_CASES = ("encoders", "friction", "everything")


class Tables:
    """The rows of all seeds as tables."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self.rows = rows
        self.pairs = list(dict.fromkeys((row["case"], row["mass"]) for row in rows))

    def of(self, case: str, mass: float, name: str) -> list[float]:
        """One number of each seed; NaN for what a trial run leaves out."""
        selected = [row for row in self.rows if (row["case"], row["mass"]) == (case, mass)]
        return [float(row.get(name, np.nan)) for row in selected]

    def page_table(self) -> list[list[str]]:
        """The page's table, the head first: medians, and the worst in brackets, of each mass."""
        cases = [case for case in PAGE_CASES if case in {case for case, _ in self.pairs}]
        masses = sorted({mass for _, mass in self.pairs if mass})

        def cell(case: str, text: Callable[[str, float], str]) -> str:
            return ", ".join(text(case, mass) for mass in masses)

        def error(name: str, case: str, mass: float) -> str:
            off = np.abs(self.of(case, mass, name))
            off = off[np.isfinite(off)]
            return f"{np.median(off):.2g} ({np.max(off):.2g})" if len(off) else "-"

        def moment(name: str, case: str, mass: float) -> str:
            times = np.array(self.of(case, mass, name))
            found = times[np.isfinite(times)]
            some = f" ({len(found)} of {len(times)})" if len(found) < len(times) else ""
            return (f"{np.median(found):.2f}" if len(found) else "-") + some

        def benefit(case: str, mass: float) -> str:
            without, learnt = (
                np.array(self.of(case, mass, f"place [mm], {method}"))
                for method in (NOT_LEARNT, LEARNT)
            )
            return f"{np.median(without / learnt):.2g}"

        lines: dict[str, Callable[[str, float], str]] = {
            f"{name} after {t:g} s{' of motion' * (t == 1)} [{unit}]": partial(
                error, f"{name} error [{unit}], {t:g} s"
            )
            for name, unit in (("mass", "%"), ("centre", "mm"))
            for t in (1.0, 2.0)
        }
        lines |= {
            f"{name}, detected after [s]": partial(moment, name)
            for name in ("picked up", "put down")
        }
        lines["placing error, uncompensated over compensated"] = benefit
        head = ["", *(CASES[case].description for case in cases)]
        return [
            head,
            *([name, *(cell(case, text) for case in cases)] for name, text in lines.items()),
        ]

    def estimates(self) -> str:
        """Errors of the estimates, and their intervals."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            for moment in (*(f"{t:g} s" for t in MOMENTS), "end", "off-line") if mass else ():
                cells.append([CASES[case].description, f"{mass:g}", moment])
                for name in ("mass", "centre"):
                    unit = "%" if name == "mass" else "mm"
                    off, half, covered = (
                        np.array(self.of(case, mass, f"{name} {figure}, {moment}"))
                        for figure in (f"error [{unit}]", f"interval [{unit}]", "covered")
                    )
                    if name == "mass":
                        cells[-1].append(f"{np.isfinite(off).sum()}/{len(off)}")
                    off, some = np.abs(off), np.isfinite(off).any()
                    cells[-1] += [
                        median_text(off),
                        f"{np.nanmax(off):.3g}" if some else "-",
                        f"{np.nanmedian(half):.2g}" if some else "-",
                        f"{np.nanmean(covered):.0%}" if some else "-",
                    ]
        header = [
            "case",
            "kg",
            "after",
            "estimated",
            "mass error [%]",
            "worst",
            "95 % ±",
            "covered",
        ]
        header += ["centre error [mm]", "worst", "95 % ±", "covered"]
        return text_table(header, cells, left=("after",))

    def bounds(self) -> str:
        """The least standard error of the mass that the motion allows, and the errors made."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            if not mass:
                continue
            bound = 1e3 * np.array(self.of(case, mass, "mass bound [kg]"))
            off = 10.0 * mass * np.array(self.of(case, mass, "mass error [%], end"))
            half = 10.0 * mass * np.array(self.of(case, mass, "mass interval [%], end"))
            some = off[np.isfinite(off)]
            spread = f"{np.std(some, ddof=1):.2g}" if len(some) > 1 else "-"
            mean = f"{np.mean(some):+.2g}" if len(some) else "-"
            errors = [median_text(bound), median_text(half / SIGMAS), mean, spread]
            cells.append([CASES[case].description, f"{mass:g}", *errors])
        header = ["case", "kg", "bound [g]", "standard error [g]", "mean error [g]", "scatter [g]"]
        return text_table(header, cells)

    def moments(self) -> str:
        """Return when picking up and putting down were detected, and false alarms."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            up, down = (
                self.of(case, mass, name) if mass else [] for name in ("picked up", "put down")
            )
            cells.append(
                [
                    CASES[case].description,
                    f"{mass:g}",
                    *(
                        text
                        for times in (up, down)
                        for text in (f"{np.isfinite(times).sum()}/{len(times)}", median_text(times))
                    ),
                    f"{sum(self.of(case, mass, 'false alarms')):g}",
                    "-" if mass else f"{max(self.of(case, mass, 'evidence')):.2g}",
                    f"{min(self.of(case, mass, 'least eigenvalue')):.2g}",
                ]
            )
        header = ["case", "kg", "up", "after [s]", "down", "after [s]", "false"]
        return text_table([*header, "evidence", "least eigenvalue"], cells)

    def hand(self) -> str:
        """Errors of the hand by method, and their ratio without and with learning."""
        cells: list[list[str]] = []
        for case, mass in self.pairs:
            for key, name in _HAND.items():
                mm = {
                    method: np.array(self.of(case, mass, f"{key} [mm], {method}"))
                    for method in (METHODS if mass else (LEARNT,))
                }
                ratio = mm[NOT_LEARNT] / mm[LEARNT] if mass else np.empty(0)
                cells.append(
                    [
                        CASES[case].description,
                        f"{mass:g}",
                        name,
                        *(median_text(mm[method]) if method in mm else "-" for method in METHODS),
                        median_text(ratio),
                    ]
                )
        header = ["case", "kg", "error of the hand [mm]", *METHODS, "not learnt / learnt"]
        return text_table(header, cells, left=("error of the hand [mm]",))
