"""Tables of the experiment, beside those of the thesis."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.assessment import agreement, mask_quality, output_sensitivity
from jaxcslc.identification import coefficient_rows, uncertainty_interval
from scripts.studies.puma560.machines import TRAINED, IdentifiedMachine
from scripts.studies.truth import truth_within_intervals


Rows = list[dict[str, Any]]

# What the thesis reports of its real machines: ε of Figs. 7.6-3 and 7.6-4, peaks of 7.4.2.
# Its coefficients are trained.
_THESIS_EPSILON = {
    "PUMA A": {"Ar+LS": 1.8155, "Ar+Rg": 0.698, TRAINED: 0.2498},
    "PUMA B": {"Ar+LS": 1.105, "Ar+Rg": 0.979, TRAINED: 0.3085},
}
_THESIS_PEAKS = (13.6, 42.8, 8.59, 1.44, 1.77, 1.76)  # N m
VALIDATION_ROW = "mean ε, as jaxcslc identify judges"
_UNWEIGHTED = jc.LeastSquares(joint_weights="equal", errors="independent")


def error_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Fig. 7.6-3 (or its twin for B), ε as `jaxcslc identify` judges, and the thesis's ε.

    Both are the same mean of half a root mean square; what differs is how positions are smoothed,
    which demand belongs to a sample, and from which speed on a joint counts.
    """
    rows: Rows = list(jc.compare(network, puma.comparison_patterns, puma.vectors).rows())
    validation = jc.compare(network, puma.validation_patterns, puma.vectors)
    epsilon = dict(zip(validation.names, np.asarray(validation.epsilon).tolist(), strict=True))
    reported = _THESIS_EPSILON[puma.name]
    return [
        *rows,
        {"": VALIDATION_ROW, **epsilon},
        {"": "mean ε, thesis", **{name: reported.get(name, float("nan")) for name in puma.vectors}},
    ]


def training_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """The trainings of 7.5: epochs, ε in training and comparison, and the direct solve's."""
    rows: Rows = []
    for masks, route in puma.routes.items():
        for thresholds, stage in (
            ("a hundredth of top speed", route.first),
            ("from the residuals", route.second),
        ):
            k = stage.training.weights
            # What training would end at if it went on: squares in place of ε, no joint weighted.
            direct = _UNWEIGHTED.fit(network, stage.patterns).k
            vectors = {"trained": k, "direct": direct}
            trained, solved = np.asarray(
                jc.compare(network, puma.comparison_patterns, vectors).epsilon
            ).tolist()
            backpropagation, peral = stage.epochs
            rows.append(
                {
                    "left out": masks,
                    "thresholds": thresholds,
                    "training ε when PERAL begins [N m]": stage.hand_over,
                    "epochs of backpropagation": backpropagation,
                    "epochs of PERAL": peral,
                    "ended": next(iter(stage.training.outcomes())),
                    "training ε [N m]": float(stage.training.cost),
                    "comparison ε [N m]": trained,
                    "comparison ε, direct solve [N m]": solved,
                }
            )
    return rows


def peak_rows(machines: Sequence[IdentifiedMachine]) -> Rows:
    """Peak torques of the comparison trajectory beside 7.4.2."""
    rows: Rows = []
    for joint, reported in enumerate(_THESIS_PEAKS):
        row: dict[str, Any] = {"joint": joint + 1, "thesis [N m]": reported}
        for puma in machines:
            row[f"{puma.name} [N m]"] = float(
                np.abs(puma.comparison.recording.torque[:, joint]).max()
            )
        rows.append(row)
    return rows


def mask_rows(puma: IdentifiedMachine) -> Rows:
    """The mask of Eqn. 2.5-7 against the simulator's record of gears apart."""
    settings = puma.settings.with_options(backlash=True)
    masked = settings.patterns(puma.training.recording)
    start = int(np.searchsorted(puma.training.truth.time, masked.time[0] - 1e-9))
    apart = puma.training.truth.apart[start : start + masked.samples]
    return list(mask_quality(np.asarray(masked.backlash_mask), apart).rows())


def agreement_rows(
    network: jc.CSLC,
    puma: IdentifiedMachine,
    twin: jc.Identification,
    twin_truth: Float[Array, " coefficients"],
) -> tuple[Rows, str]:
    """Agreement of the coefficients of two machines with the same links and other friction."""
    sensitivity = output_sensitivity(network, puma.patterns)
    result = agreement(
        network,
        puma.fit,
        twin,
        sensitivity=sensitivity,
        truth=(puma.vectors["true"], twin_truth),
    )
    return list(result.rows()), str(result)


def coefficient_table_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Figs. B.1 to B.5: identified beside true coefficients, Armstrong's and the thesis's."""
    return coefficient_rows(
        network,
        puma.fit,
        {
            "true": np.asarray(puma.vectors["true"]),
            **({"trained": np.asarray(puma.vectors[TRAINED])} if TRAINED in puma.vectors else {}),
            "Ar+LS": np.asarray(puma.vectors["Ar+LS"]),
            "thesis": sim.thesis_coefficients(puma.letter).coefficients,
        },
        sensitivity=output_sensitivity(network, puma.patterns),
        systematic=puma.systematic,
    )


def interval_rows(machines: Sequence[IdentifiedMachine]) -> Rows:
    """How many of each machine's 95 % intervals contain the true coefficients."""
    rows: Rows = []
    for puma in machines:
        truth = np.asarray(puma.vectors["true"])
        within = truth_within_intervals(puma.fit, puma.systematic, truth)
        narrow, wide = (
            np.ptp(uncertainty_interval(puma.fit, error), axis=1)
            for error in (None, puma.systematic)
        )
        rows.append(
            {
                "": puma.name,
                "intervals": len(truth),
                **{name: int(np.sum(some)) for name, some in within.items()},
                "times as wide, median": float(np.median(wide / narrow)),
            }
        )
    return rows
