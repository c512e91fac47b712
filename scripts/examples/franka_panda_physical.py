"""A real Panda's parameters made physically possible, judged on held-out data, beside Table III.

    python -m scripts.examples.franka_panda_physical [FOLDER] [--choose]

The recording, its target and its division are those of `franka_panda.py`. Coefficients are fitted
to the first two thirds; the nearest physically possible bodies follow from them; both are judged on
the last third. Only the robot's lengths are known, so the prior is a ball of equal mass for each
link.

Then both stand beside the authors' own base coefficients (Gaz, Cognetti, Oliva, Robuffo Giordano
and De Luca, RA-L 2019, Table III): their classical least squares on this very trajectory, all of
it, and what their own physically consistent parameters give. Our coefficients follow from the first
two thirds alone, and from differences in smoothing.
"""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.recordings import RecordingError, resample
from jaxcslc.report import all_or_nothing, write_csv, write_json
from scripts.examples.franka_panda import DATA, PERIOD, Target, read_recording


jc.enable_x64()

TABLE = "table_III_authors_base_parameters.csv"
_TERM = re.compile(
    r"(?P<sign>[+-])?(?P<factor>\d+\.\d*)?"
    r"(?:(?P<sum>\((?:\+?m\d)+\))|(?P<name>J\d[xyz]{2}|J[xyz]{2}\d|c\d[xyz]m\d|m\d))"
)
_FRICTION = {"fv": "viscous", "fc": "dry", "fo": "offset"}


def fixed_settings() -> jc.Settings:
    """Return those of the recording's other test, fixed before any body was computed."""
    return jc.Settings(
        jc.Preparation(jc.AveragedSplines(97), threshold_fraction=0.0, torque_lag=0.003),
        jc.LeastSquares(cutoff=8.0),
    )


def errors(
    network: jc.CSLC, target: Target, settings: jc.Settings, k: Float[np.ndarray, " coefficients"]
) -> dict[str, Float[np.ndarray, " joints"]]:
    """Return the errors of the last third's torque, as `franka_panda.py` judges it [N m]."""
    motion = settings.preparation.smoothing.smooth(target.time, target.position)
    predicted = np.asarray(jax.jit(network.torque)(k, *motion))
    read = target.time - settings.preparation.torque_lag
    shifted = np.stack([np.interp(read, target.time, x) for x in predicted.T], axis=1)
    return target.errors(shifted, target.judged)


def value_of(symbol: str, parameters: jc.PhysicalParameters) -> float:
    """One of the authors' coefficients, from the links' tensors at the frames and first moments.

    **Raises** `ValueError` for a symbol that is not a sum of such terms.
    """
    if match := re.fullmatch(r"(f[vco]),(\d)", symbol):
        return float(parameters.friction[_FRICTION[match[1]]][int(match[2]) - 1])
    text, total, start = symbol.replace(" ", ""), 0.0, 0
    while start < len(text):
        match = _TERM.match(text, start)
        if match is None:
            raise ValueError(f"{TABLE}: cannot read {symbol!r} at {text[start:]!r}")
        factor = float(match["factor"] or 1) * (-1 if match["sign"] == "-" else 1)
        names = re.findall(r"m\d", match["sum"]) if match["sum"] else [match["name"]]
        total += factor * sum(_parameter(name, parameters.links) for name in names)
        start = match.end()
    return total


def _parameter(name: str, links: tuple[jc.LinkParameters, ...]) -> float:
    number = int(re.search(r"\d", name)[0])  # pyright: ignore[reportOptionalSubscript]
    link, letters = links[number - 1], re.sub(r"[Jcm\d]", "", name)
    axes = ["xyz".index(letter) for letter in letters]
    if name.startswith("J"):
        motor = float(link.motor_inertia) if letters == "zz" else 0.0
        return float(link.inertia_at_frame[axes[0], axes[1]]) + motor
    return float(link.first_moment[axes[0]]) if axes else float(link.mass)


def beside_table(folder: Path, parameters: jc.PhysicalParameters) -> list[dict[str, str | float]]:
    """The authors' rows beside the coefficients of our bodies; empty cells are NaN."""
    rows: list[dict[str, str | float]] = []
    for line in (folder / TABLE).read_text(encoding="utf-8").splitlines()[1:]:
        symbol, *cells = line.split(";")
        least, consistent = (
            float(c) if c.strip("- ") else float("nan") for c in (cells[3], cells[2])
        )
        rows.append(
            {
                "coefficient": symbol.strip(),
                "jaxcslc": value_of(symbol, parameters),
                "authors_least_squares": least,
                "authors_consistent": consistent,
            }
        )
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=DATA, help="of the recording")
    parser.add_argument(
        "--choose", action="store_true", help="settings by cross-validation (minutes)"
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("build/franka_panda_physical"))
    options = parser.parse_args(argv)
    try:
        recording = read_recording(options.folder)
    except RecordingError as error:
        parser.error(str(error))

    network = jc.derive(jc.panda(), lengths="numeric")
    target = Target.of(recording)
    training = resample(recording.rows(recording.time < target.until), PERIOD)
    settings = (
        jc.choose_settings(network, training).settings if options.choose else fixed_settings()
    )
    patterns = settings.patterns(training)
    fit = settings.fit(network, patterns)
    possible = jc.physical_parameters(network, fit, patterns=patterns)
    print(f"{network}\n{settings}\n{fit!r}\n{possible}\n")
    print(possible.to_pandas().to_string(float_format="{:.4g}".format))

    results = {
        "least squares": errors(network, target, settings, np.asarray(fit.k)),
        "possible bodies": errors(network, target, settings, possible.k),
    }
    rows: list[dict[str, str | float]] = []
    for kind in results["least squares"]:
        for name, by_kind in results.items():
            rows.append({"torque": kind, "parameters": name, **_by_joint(by_kind[kind])})
        ratio = results["possible bodies"][kind] / results["least squares"][kind]
        rows.append({"torque": kind, "parameters": "ratio", **_by_joint(ratio)})
    header = list(rows[0])
    cells = [[v if isinstance(v, str) else f"{v:.4f}" for v in row.values()] for row in rows]
    print("\nRMS torque error on the last third [N m]")
    print(text_table(header, cells, left=("parameters",)))
    summary = {kind: ratios(results, kind) for kind in results["least squares"]}
    print("\npossible bodies over least squares: worst joint, and all joints together")
    for kind, (worst, together) in summary.items():
        print(f"  torque {kind}: {worst:.4f}, {together:.4f}")

    table = beside_table(options.folder, possible)
    print("\nbeside Table III")
    cells = [[v if isinstance(v, str) else f"{v:.4f}" for v in row.values()] for row in table]
    print(text_table(list(table[0]), cells))
    with all_or_nothing(options.output) as folder:
        write_csv(folder / "held_out.csv", rows)
        write_csv(folder / "table_III.csv", table)
        possible.to_pandas().to_csv(folder / "links.csv")
        write_json(folder / "summary.json", {"distance": possible.distance, "ratios": summary})
    print(f"\nwrote tables into {options.output}")
    return 0


def ratios(
    results: dict[str, dict[str, Float[np.ndarray, " joints"]]], kind: str
) -> tuple[float, float]:
    """Return the ratios of errors: the largest of any joint, and that of the root mean square over
    all joints.
    """
    before, after = results["least squares"][kind], results["possible bodies"][kind]
    together = float(np.linalg.norm(after) / np.linalg.norm(before))
    return float(np.max(after / before)), together


def _by_joint(values: Float[np.ndarray, " joints"]) -> dict[str, float]:
    return {f"joint_{joint}": float(value) for joint, value in enumerate(values, start=1)}


if __name__ == "__main__":
    raise SystemExit(main())
