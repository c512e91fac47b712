"""Do intervals of real arms' coefficients hold? Fits of motion that they have not in common.

Each arm's recordings (or thirds of one) are fitted apart, with settings that are chosen on the
first. Two fits are of the same arm: the difference of a coefficient that both determine should be
about as large as its standard error, the root of both fits' variances. The table has the median
and the root mean square of difference over standard error, and how many differences are within
1.96, for standard errors of independent residuals, for those of correlated ones (a sandwich, the
default), and with systematic errors beside them (the bias of smoothing, timing, missing terms).

The last two rows are of the common fit of all recordings but one, compared with the fit of that
one: with systematic errors, and with the drift between recordings that the others show
(`jaxcslc.uncertainty.Drift`).
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc.uncertainty import (
    DRIFT,
    SystematicError,
    fit_recordings,
    standard_uncertainty,
    systematic_error,
)
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm
from scripts.studies.real_robots.methods import without_static
from scripts.studies.stored import store
from scripts.studies.tables import grouped


jc.enable_x64()

# What standard errors allow for, and its name on the page.
KINDS = {
    "independent": "independent residuals",
    "correlated": "correlated residuals, the default",
    "correlated and systematic": "these and systematic errors",
}
OF_OTHERS = {
    "common fit of others, systematic": "common fit of the others, systematic errors too",
    "common fit of others, drift": "and drift",
}
_WITHIN = 1.96


def parts_of(arm: Arm) -> list[jc.Recording]:
    """Motion that is fitted apart: recordings, or halves of what is fitted and what is judged."""
    if len(arm.tests) > 1:
        return [arm.training, *arm.tests.values()]
    length = float(np.ptp(arm.training.time))
    halves = [(0.0, length / 2), (length / 2, length)]
    return [*(arm.training.between(*half) for half in halves), *arm.tests.values()]


def deviations_of(arm: Arm) -> dict[str, Float[np.ndarray, " differences"]]:
    """Differences of all pairs of fits over their standard errors, by what these allow for."""
    network = without_static(arm)
    parts = parts_of(arm)
    settings = jc.choose_settings(network, parts[0]).settings
    fits: list[tuple[jc.Identification, dict[str, np.ndarray]]] = []
    patterns = {str(number): settings.patterns(part) for number, part in enumerate(parts)}
    errors: dict[str, SystematicError] = {}
    for (number, motion), part in zip(patterns.items(), parts, strict=True):
        fit = settings.fit(network, motion)
        errors[number] = error = systematic_error(network, part, settings, fit)
        independent = np.sqrt(np.diag(np.asarray(fit.independent_covariance)))
        fits.append(
            (
                fit,
                {
                    "independent": independent,
                    "correlated": np.asarray(fit.standard_error),
                    "correlated and systematic": np.asarray(standard_uncertainty(fit, error)),
                },
            )
        )
    deviations: dict[str, list[np.ndarray]] = {kind: [] for kind in (*KINDS, *OF_OTHERS)}
    for (first, of_first), (second, of_second) in combinations(fits, 2):
        both = np.asarray(first.determined) & np.asarray(second.determined)
        for kind in KINDS:
            error = np.hypot(of_first[kind], of_second[kind])
            deviations[kind].append((np.abs(np.asarray(first.k - second.k)) / error)[both])
    for left, (fit, own) in zip(patterns, fits, strict=True):
        others = {number: motion for number, motion in patterns.items() if number != left}
        several = fit_recordings(network, others, settings.solver)
        _, whole = several.allowing_for({number: errors[number] for number in others})
        known = SystematicError({cause: x for cause, x in whole.parts.items() if cause != DRIFT})
        both = np.asarray(several.fit.determined) & np.asarray(fit.determined)
        difference = np.abs(np.asarray(several.fit.k - fit.k))
        for kind, allowed in zip(OF_OTHERS, (known, whole), strict=True):
            error = np.hypot(
                standard_uncertainty(several.fit, allowed), own["correlated and systematic"]
            )
            deviations[kind].append((difference / error)[both])
    return {kind: np.concatenate(values) for kind, values in deviations.items()}


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Return the lines of the table: a row for what standard errors allow for."""
    rows: list[list[str]] = []
    for kind, values in deviations_of(arm).items():
        finite = values[np.isfinite(values)]
        row = [np.median(finite), np.sqrt(np.mean(finite**2))]
        inside = f"{100 * np.mean(finite <= _WITHIN):.0f} %"
        rows.append([name, kind, *(f"{value:.2g}" for value in row), inside])
    return rows


def page_tables(table: Sequence[Sequence[str]]) -> dict[str, list[list[str]]]:
    """The tables of the pages: pairs of fits, and fits of all other recordings."""
    head, *rows = table
    pairs = [[arm, KINDS[kind], *cells] for arm, kind, *cells in rows if kind in KINDS]
    within = {(arm, kind): row[-1] for arm, kind, *row in rows}
    drift = [["arm", "pairs of fits, standard errors", *OF_OTHERS.values()]]
    for arm in dict.fromkeys(row[0] for row in rows):
        kinds = ("correlated", *OF_OTHERS)
        drift.append([arm, *(within[arm, kind] for kind in kinds)])
    return {"pairs": grouped([list(head), *pairs]), "drift": drift}


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "intervals")
    options = by_arm.parse(parser, argv, arms=["KUKA KR300"])
    header = ["arm", "standard errors for", "median of difference over error"]
    header += ["root mean square", f"within {_WITHIN}"]

    def study() -> int:
        table = by_arm.print_table(options, lines_of, header)
        sample = "three recordings of each arm, or parts"
        store(options, "intervals", sample, page_tables(table))
        return 0

    return command.run(
        parser,
        study,
        seconds=30.0 * len(options.arms),
    )


if __name__ == "__main__":
    raise SystemExit(main())
