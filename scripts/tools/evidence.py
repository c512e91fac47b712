"""Fill the tables of evidence pages from their stored results, and draw their charts.

    python -m scripts.tools.evidence

Tables are those of `docs/results` (`scripts/studies/stored.py`), and bars are stored figures
(`stored_figures.py`), so that a chart and its page agree. A test fails if a page or a picture in
docs/images/evidence is another.
"""

import contextlib
import html
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scripts.studies.stored import Results, filled, save
from scripts.tools.stored_figures import measurements, stored


DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "images" / "evidence"
# Far apart in hue and in lightness (Okabe and Ito).
_COLOURS = ("#0072b2", "#e69f00", "#3b3b3b", "#56b4e9", "#d55e00")
# Narrow, with labels above bars, so that a phone shows letters of a legible size. In pixels.
_BAR, _GAP, _LEFT, _WIDTH, _LINE = 13, 10, 16, 520, 18
_LETTER, _TITLE = 7.0, 66  # the width of a letter, at most; letters of a line of the title


@dataclass(frozen=True)
class Chart:
    """Bars in groups, one bar per series.

    **Attributes**

    - `title`: with the unit.
    - `figure`: reference of a bar, with `{group}` and `{series}`.
    - `groups`, `series`: label and what stands in the reference. Of several alternatives of a
      series, the bar is the least that the group's table has.
    """

    title: str
    figure: str
    groups: Mapping[str, str]
    series: Mapping[str, str | tuple[str, ...]]

    def values(self) -> list[list[float]]:
        """Return the bars of each group; of a benchmark the least."""
        return [
            [self._value(group, one) for one in self.series.values()]
            for group in self.groups.values()
        ]

    def _value(self, group: str, one: str | tuple[str, ...]) -> float:
        if isinstance(one, str):
            return min(stored(self.figure.format(group=group, series=one)))
        found: list[float] = []
        for alternative in one:
            with contextlib.suppress(ValueError):  # a table need not have all of them
                found += stored(self.figure.format(group=group, series=alternative))
        return min(found)


def _same(*names: str) -> dict[str, str]:
    return {name: name for name in names}


_ARMS = {
    "KUKA KR300, motion B": "KUKA KR300, B",
    "KUKA KR300, motion C": "KUKA KR300, C",
    "KUKA LWR4+, faster motion": "KUKA LWR4+, hw3",
    "KUKA LWR4+, same motion": "KUKA LWR4+, hw2",
    "Franka Panda": "Franka Panda, last third",
    "Stäubli TX40": "Stäubli TX40, last third",
}

CHARTS: Mapping[str, Chart] = {
    "file_prior": Chart(
        "Torque error of new motion with the file as prior, over two others, median",
        "file_prior/files | {group} | {series}",
        {
            "usual file": "usual: masses 20 %, centres 2 cm",
            "half the masses": "half the masses",
            "twice the masses": "twice the masses",
            "one inertia 100 times": "one inertia 100 times",
            "a tool missing": "a tool of 12 % of the arm missing",
            "one centre off": "one centre 14 cm off",
        },
        {"the file itself": "error over file", "the fit alone": "error over fit"},
    ),
    "real_robots": Chart(
        "Held-out torque error, mean of the joints [% of the torque]",
        "real_robots/{group} | {series} | mean",
        _ARMS,
        {
            "usual pipeline, best variant": tuple(
                f"usual pipeline, 20 Hz, {variant}"
                for variant in (
                    "OLS",
                    "WLS",
                    "OLS and offsets",
                    "WLS and offsets",
                    "ridge to the file",
                )
            ),
            "identify": "identify",
            "identify --quality best": "identify, best",
        },
    ),
    "estimators": Chart(
        "95 % intervals that contain the truth [%]",
        "estimators/{series} | {group} | 95 % intervals that hold",
        _same(
            "least squares",
            "least squares, with systematic errors",
            "instruments, known controller",
            "instruments, observer",
            "direct dynamics, known controller",
        ),
        {"encoders": "encoders", "all disturbances": "all disturbances"},
    ),
    "likelihood": Chart(
        "Held-out torque error on real arms, mean of the joints [%]",
        "real_robots/{group} | {series} | mean",
        _ARMS,
        {"identify": "identify", "maximum likelihood": "identify, maximum likelihood"},
    ),
    "friction": Chart(
        "KUKA KR300, motion B: torque error by friction at standstill [%]",
        "rests/errors | {series} | {group}",
        {f"joint {joint}": str(joint) for joint in range(1, 7)},
        {
            "by the sign of velocity": "KUKA KR300 & B & by the sign of velocity",
            "mean of before and after": "KUKA KR300 & B & mean of before and after",
        },
    ),
    "uncertainty": Chart(
        "Of 43 intervals of 95 %, those that contain the truth",
        "systematic/causes | {group} | {series}",
        _same(
            "PUMA A, encoders",
            "PUMA A, all disturbances",
            "PUMA B, encoders",
            "PUMA B, all disturbances",
        ),
        {"standard error alone": "standard error alone", "with systematic errors": "all"},
    ),
    "excitation": Chart(
        "Mean error of the coefficients, by motion [%]",
        "excitation/motions | {group} | {series}",
        _same(
            "designed: overall",
            "designed: mean standard error",
            "D-optimal",
            "least condition number",
            "random Fourier series within the limits",
        ),
        {"error": "mean error", "reported standard error": "mean reported standard error"},
    ),
    "scale": Chart(
        "Seconds, on the quicker of two machines with two cores",
        "benchmark {group}.{series}",
        {
            "3,300 samples": "identify.puma560",
            "20,000 samples, URDF": "urdf.identify_choosing",
            "3,300, maximum likelihood": "likelihood.3300_samples",
        },
        {"first run": "first_run", "later run": "later_run"},
    ),
    "recordings": Chart(
        "Exported files: torque error over that of the fit, geometric mean of ten recordings",
        "possible_bodies/files | {group} | {series}",
        _same("20 s, half of the top speed", "20 s, slow: 15 % of it", "5 s, 30 % of it"),
        {
            "URDF and motor inertias": "URDF and motor inertias",
            "URDF alone": "URDF alone (`--no-motors`)",
        },
    ),
    "systems": Chart(
        "Coefficients within two standard errors of the truth [%]; 95.4 are expected",
        "systems/coverage | {group} | {series}",
        {
            "cart-pole": "cart-pole, 6 coefficients",
            "vehicle": "vehicle, 3 coefficients",
            "motor": "motor, 12 coefficients",
            "quadrotor": "quadrotor, 9 coefficients",
            "tanks": "tanks, 4 coefficients",
        },
        {"corrected": "within 2 errors", "least squares": "least squares"},
    ),
    "control": Chart(
        "Error of the hand, median of twenty simulated arms [mm RMS]",
        "control/tracking | {group} | {series}",
        {
            "PID": "PID, the thesis's gains",
            "published (Ar+LS)": "computed torque, Ar+LS",
            "friction fitted (Ar+Rg)": "computed torque, Ar+Rg",
            "identified (CSLC)": "computed torque, CSLC",
            "true": "computed torque, truth",
        },
        {"go-to in 3 s": "go-to, 3 s", "circle in 3 s": "circle, 3 s"},
    ),
    "servo": Chart(
        "A real SO-101: simulated position error on held-out motion [mrad RMS]",
        "servo_sage/joints | {series} | {group}",
        _same(
            "joints 1 to 5",
            "shoulder pan",
            "shoulder lift",
            "elbow",
            "wrist flex",
            "wrist roll",
            "gripper",
        ),
        {
            "identified drives": "identified drives",
            "MuJoCo servos, least squares": "servos of MuJoCo, `scipy.optimize.least_squares`",
        },
    ),
    "payload": Chart(
        "Payload of 0.5 kg: detected after [s]",
        "payload/disturbances | {series} | {group}",
        _same("quantised encoders", "static friction as well", "all disturbances"),
        {
            "picked up": "picked up, detected after [s]",
            "put down": "put down, detected after [s]",
        },
    ),
    "peral": Chart(
        "Epochs until the goal, linear classes and CSLC",
        "peral_classes/epochs | {group} | {series}",
        _same("linear, correlated inputs", "logistic, correlated inputs", "CSLC, 3 joints"),
        {"backpropagation": "backpropagation", "with PERAL": "indicator", "L-BFGS": "L-BFGS"},
    ),
    "generalisation": Chart(
        "ε on training and on comparison motion, median of ten seeds [N m]",
        "generalisation/networks | {group} | {series}",
        {"CSLC": "CSLC", **{f"tanh, {n} nodes": f"tanh {n}" for n in (4, 8, 16)}},
        {"training": "training", "comparison": "comparison"},
    ),
    "experiment": Chart(
        "Torque error ε on the comparison trajectory [N m]",
        "demo/errors_{series}.csv | mean ε | {group}",
        {
            "published (Ar+LS)": "Ar+LS",
            "friction fitted (Ar+Rg)": "Ar+Rg",
            "trained network": "CSLC trained",
            "identified (CSLC)": "CSLC",
            "true": "true",
        },
        {"PUMA A": "a", "PUMA B": "b"},
    ),
    "simulator": Chart(
        "Torque error of 1,024 simulated PUMA 560s [N m]",
        "thousand/errors | {group} | {series}",
        {
            "published coefficients (Ar+LS)": "Ar+LS",
            "trained network": "trained",
            "direct solution": "solved",
            "true coefficients": "true coefficients",
        },
        {"median": "median", "90 % of machines": "90 %"},
    ),
    "ultrasound": Chart(
        "Comparison patterns that are classified correctly, of 3,150 for training [%]",
        "ultrasound_comparison/patterns | 3,150 & {group} & {series} | comparison patterns correct",
        {"inputs as they are": "as they are", "inputs centred": "centred"},
        {"backpropagation": "end of backpropagation", "PERAL": "end of PERAL"},
    ),
    "puma_a_b": Chart(
        "Torque difference from the thesis's PUMA A [N m]",
        "puma_a_b.md # Effect on the torque | PUMA | A & {series} against it | {group}",
        _same(*(f"joint {joint}" for joint in range(1, 7))),
        {"puma_a": "`puma_a`", "Armstrong": "Armstrong"},
    ),
    "thesis": Chart(
        "Entries of the thesis",
        "thesis.md # The thesis, entry by entry |  | {group} | {series}",
        _same("sections", "numbered equations", "figures and tables"),
        _same("in all", "carried over"),
    ),
}


def drawn(chart: Chart) -> str:
    """Return a chart as SVG."""
    values = chart.values()
    scale = (_WIDTH - _LEFT - 60) / max(max(row) for row in values)
    parts: list[str] = []
    top = _LINE
    for line in textwrap.wrap(chart.title, _TITLE):
        top += _LINE
        parts.append(_text(_LEFT, top - 10, line, weight="600"))
    left = float(_LEFT)
    for name, colour in zip(chart.series, _COLOURS, strict=False):
        if len(chart.series) > 1:
            wide = 30 + _LETTER * len(name)
            if left > _LEFT and left + wide > _WIDTH:
                left, top = float(_LEFT), top + _LINE
            parts.append(
                f'<rect x="{left:.1f}" y="{top - 4}" width="11" height="11" fill="{colour}"/>'
            )
            parts.append(_text(left + 16, top + 6, name))
            left += wide
    top += _LINE + _GAP
    for label, row in zip(chart.groups, values, strict=True):
        parts.append(_text(_LEFT, top, label))
        top += 6
        for value, colour in zip(row, _COLOURS, strict=False):
            wide = max(1.0, scale * value)
            parts.append(
                f'<rect x="{_LEFT}" y="{top}" width="{wide:.1f}" height="{_BAR - 2}"'
                f' fill="{colour}"/>'
            )
            parts.append(_text(_LEFT + wide + 6, top + _BAR - 3, f"{value:.3g}"))
            top += _BAR
        top += _LINE
    words = "; ".join(
        f"{label}: " + ", ".join(f"{value:.3g}" for value in row)
        for label, row in zip(chart.groups, values, strict=True)
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {top}" width="{_WIDTH}"'
        f' height="{top}" font-family="system-ui, sans-serif" font-size="13" role="img"'
        f' aria-label="{html.escape(chart.title)}. {html.escape(words)}">\n'
        f'<rect width="{_WIDTH}" height="{top}" rx="8" fill="#ffffff"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def _text(x: float, y: float, text: str, *, weight: str = "400") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="#1f2933"'
        f' font-weight="{weight}">{html.escape(text)}</text>'
    )


# Rows of the table of the solve's accuracy: robots and motions of the benchmark's metrics.
_MOTIONS = {"all": "all joints moving", "1e_2": "by hundredths of rad", "1e_3": "by thousandths"}
_ERRORS = {
    "reflections, processor": "error_of_reflections_standard_errors",
    "products, H200": "error_of_products_standard_errors",
    "`fit`, H200": "error_of_fit_standard_errors",
}


def solve_accuracy() -> Results:
    """Return the table of the accuracy of solves on an H200, from the stored benchmark."""
    (measured,) = (
        one for one in measurements() if one["group"] == "solve" and "H200" in one["machine"]
    )
    values = {metric["name"]: metric["value"] for metric in measured["metrics"]}
    rows = [["", "condition number", *_ERRORS]]
    for robot, name in (("puma560", "PUMA 560, "), ("panda", "Panda, ")):
        for motion, words in _MOTIONS.items():
            of_motion = f"{robot}_motion_{motion}"
            cells = [f"{values[f'{of_motion}.{error}']:.1e}" for error in _ERRORS.values()]
            rows.append([name + words, f"{values[f'{of_motion}.condition']:.2g}", *cells])
    command = "make bench ARGS='--groups solve --update'"
    return Results(command, measured["date"], "one seed, H200", {"motions": rows})


def main() -> None:
    save("solve_accuracy", solve_accuracy())
    for path in sorted(DOCS.glob("*.md")):
        page = path.read_text("utf-8")
        if (now := filled(page)) != page:
            path.write_text(now, encoding="utf-8")
            print(f"filled the tables of {path}")
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, chart in CHARTS.items():
        (FOLDER / f"{name}.svg").write_text(drawn(chart), encoding="utf-8")
    print(f"wrote {len(CHARTS)} charts into {FOLDER}")


if __name__ == "__main__":
    main()
