"""Tables of the experiment, beside those of the thesis."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

import jaxcslc as jc
import sim
from jaxcslc.report import coefficient_rows
from jaxcslc.uncertainty import uncertainty_interval
from scripts.studies.puma560.agreement import agreement
from scripts.studies.puma560.hand import hand_errors
from scripts.studies.puma560.machines import SOLVED, TRAINED, IdentifiedMachine, SeedTrainings
from scripts.studies.sensitivity import output_sensitivity
from scripts.studies.truth import truth_within_intervals


Rows = list[dict[str, Any]]

# What the thesis reports of its real machines: ε of Figs. 7.6-3 and 7.6-4, peaks of 7.4.2.
# Its coefficients are trained.
_THESIS_EPSILON = {
    "PUMA A": {"Ar+LS": 1.8155, "Ar+Rg": 0.698, TRAINED: 0.2498},
    "PUMA B": {"Ar+LS": 1.105, "Ar+Rg": 0.979, TRAINED: 0.3085},
}
_THESIS_PEAKS = (13.6, 42.8, 8.59, 1.44, 1.77, 1.76)  # N m
# The flange in the last link's frame, whose origin is the wrist centre [m].
_FLANGE = (0.0, 0.0, sim.FLANGE)
MEAN_ROW = "mean ε, mean of two demands"
VALIDATION_ROW = "mean ε, as jaxcslc identify judges"


def error_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """Fig. 7.6-3 (or its twin for B) judged as in the thesis, then ε judged in two other ways.

    All are the same mean of half a root mean square. What differs is which demand belongs to a
    sample, how positions are smoothed, and which samples count.
    """
    rows: Rows = list(jc.compare(network, puma.thesis_patterns, puma.vectors).rows())
    others: Rows = []
    for name, patterns in (
        (MEAN_ROW, puma.comparison_patterns),
        (VALIDATION_ROW, puma.validation_patterns),
    ):
        errors = jc.compare(network, patterns, puma.vectors)
        others.append(
            {"": name, **dict(zip(errors.names, np.asarray(errors.epsilon).tolist(), strict=True))}
        )
    reported = _THESIS_EPSILON[puma.name]
    thesis = {name: reported.get(name, float("nan")) for name in puma.vectors}
    return [*rows, *others, {"": "mean ε, thesis", **thesis}]


def training_rows(puma: IdentifiedMachine) -> Rows:
    """The trainings of every seed by route, the direct solve, and measured coefficients."""
    every = puma.side_by_side
    assert every is not None, "a quick run trains nothing"
    solved = every.comparison_error[SOLVED]
    others = (every.comparison_error["Ar+LS"], every.comparison_error["Ar+Rg"])
    rows: Rows = []
    for name, errors in every.comparison_error.items():
        training = every.trainings.get(name)
        epochs = ("", "") if training is None else [float(np.median(x)) for x in training.epochs()]
        rows.append(
            {
                "coefficients": name,
                "epochs of backpropagation": epochs[0],
                "epochs of PERAL": epochs[1],
                "all seeds [s]": "" if training is None else training.seconds,
                "training ε [N m]": float(np.median(every.training_error[name])),
                "comparison ε [N m]": float(np.median(errors)),
                "over the direct solve": float(np.median(errors / solved)),
                "worst seed": float(np.max(errors / solved)),
                "seeds below Ar+LS and Ar+Rg": int(np.sum(errors < np.minimum(*others))),
            }
        )
    return rows


def letter_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """The training of 7.5 to the letter, on the first seed's recording."""
    route = puma.to_the_letter
    assert route is not None, "a quick run trains nothing"
    rows: Rows = []
    for thresholds, stage in (
        ("a hundredth of top speed", route.first),
        ("from the residuals", route.second),
    ):
        vectors = {"": stage.training.weights}
        (error,) = np.asarray(jc.compare(network, puma.thesis_patterns, vectors).epsilon).tolist()
        backpropagation, peral = stage.epochs
        rows.append(
            {
                "thresholds": thresholds,
                "training ε when PERAL begins [N m]": stage.hand_over,
                "epochs of backpropagation": backpropagation,
                "epochs of PERAL": peral,
                "ended": next(iter(stage.training.outcomes())),
                "training ε [N m]": float(stage.training.cost),
                "comparison ε [N m]": error,
            }
        )
    return rows


def curves(every: SeedTrainings) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Cost before every epoch of the first seed's trainings, and the rule that learnt, by route."""
    result: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, part in every.trainings.items():
        history = part.training.history
        learnt = np.asarray(history.rule[0]) >= 0
        result[name] = (np.asarray(history.cost[0])[learnt], np.asarray(history.rule[0])[learnt])
    return result


def hand_rows(network: jc.CSLC, puma: IdentifiedMachine) -> Rows:
    """What each model's torque errors do at the hand (7.5): mean acceleration errors [m/s²]."""
    vectors = puma.vectors
    errors = hand_errors(network, puma.thesis_patterns, vectors, vectors["true"], point=_FLANGE)
    return list(errors.rows())


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
    return list(sim.mask_quality(np.asarray(masked.backlash_mask), apart).rows())


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
    """Return how many of each machine's 95 % intervals contain the true coefficients."""
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
