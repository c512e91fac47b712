"""Numbers of the thesis's pages that long studies measured: their tables lie in results/."""

import csv
import functools
import shutil
from pathlib import Path


FOLDER = Path(__file__).parent / "results"
IMAGES = Path(__file__).parents[3] / "docs" / "images"
# Pictures that pages show, by the folder of their study.
PICTURES = {"demo": ("figure_7.4-1.png",)}
# Folder, the command that writes it, and the tables that the pages read.
STUDIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "demo": (
        "make demo",
        (
            "errors_a.csv",
            "errors_b.csv",
            "intervals.csv",
            "peaks.csv",
            "thresholds_a.csv",
            "thresholds_b.csv",
            "threshold_fits_a.csv",
            "threshold_fits_b.csv",
            "hand_a.csv",
            "hand_b.csv",
            "training_a.csv",
            "training_b.csv",
            "letter_a.csv",
            "letter_b.csv",
            "demands.csv",
            "weak_motors.csv",
            "coefficients_a.csv",
            "coefficients_b.csv",
            "one_design.csv",
        ),
    ),
    "peral_study": (
        "python -m scripts.studies.training.peral --seeds 30 --starts 30",
        ("epochs.csv",),
    ),
}


def collect(build: Path, folder: Path = FOLDER, images: Path = IMAGES) -> list[Path]:
    """Copies the tables and pictures of every study that lies in `build`.

    **Returns** the copies.

    **Raises**

    - `ValueError`: a study's folder lacks one of its files, or `build` has no study.
    """
    copies: list[Path] = []
    for study, (command, names) in STUDIES.items():
        if not (build / study).is_dir():
            continue
        for name in (*names, *PICTURES.get(study, ())):
            if not (build / study / name).is_file():
                raise ValueError(
                    f"{build / study / name}: no such file; expected that of {command}"
                )
            copy = folder / study / name if name in names else images / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            if name in names:  # with the line ends of text files here
                copy.write_text((build / study / name).read_text("utf-8"), encoding="utf-8")
            else:
                shutil.copyfile(build / study / name, copy)
            copies.append(copy)
    if not copies:
        raise ValueError(f"{build}: holds none of {', '.join(STUDIES)}")
    return copies


@functools.cache
def rows(study: str, name: str) -> tuple[dict[str, str], ...]:
    """A table's rows, as texts."""
    with (FOLDER / study / name).open(encoding="utf-8", newline="") as file:
        return tuple(csv.DictReader(file))


def comparison_errors(machine: str, model: str) -> list[float]:
    """Mean error moduli of joints 1 to 6 in the comparison trajectory, and ε [N m]."""
    table = {row[""]: row[model] for row in rows("demo", f"errors_{machine}.csv")}
    names = [*(f"mean |e{joint}|" for joint in range(1, 7)), "mean ε"]
    return [float(table[name]) for name in names]


def hand_over_errors() -> list[float]:
    """ε on the training patterns at which PERAL takes part, of PUMA A and PUMA B [N m]."""
    tables = (rows("demo", f"letter_{machine}.csv") for machine in ("a", "b"))
    return [float(table[0]["training ε when PERAL begins [N m]"]) for table in tables]


def fine_tuning(problem: str, variant: str, goal: str) -> list[float]:
    """Median epochs of backpropagation from the hand-over to a goal of Section 6.3, and how many
    times fewer PERAL takes."""
    (row,) = (
        row
        for row in rows("peral_study", "epochs.csv")
        if (row["problem"], row["variant"], row["goal"]) == (problem, variant, goal)
        and row["rule"] == "backpropagation"
    )
    return [
        float(row["epochs, median"]),
        float(row["backpropagation's median epochs over PERAL's"]),
    ]


def peak_torques(machine: str) -> list[float]:
    """Return the peak torques of each joint in the comparison trajectory [N m]."""
    return [float(row[f"{machine} [N m]"]) for row in rows("demo", "peaks.csv")]


def thresholds(machine: str) -> list[float | str]:
    """Return the speeds from which static friction is insignificant, from the residuals [rad/s].

    Where residuals show no static friction, the table has the least speed that is looked at, a
    hundredth of the joint's top speed. Such a joint is "not seen" here.
    """
    return [
        float(row["from residuals [rad/s]"]) if row["seen in residuals"] == "yes" else "not seen"
        for row in rows("demo", f"thresholds_{machine}.csv")
    ]


def dry_sensitivity() -> float:
    """Mean output sensitivity of PUMA A's dry friction coefficients."""
    sensitivity = [
        float(row["sensitivity"])
        for row in rows("demo", "coefficients_a.csv")
        if row["group"] == "dry"
    ]
    return sum(sensitivity) / len(sensitivity)


def variations() -> list[float]:
    """Largest difference of the coefficients of PUMA A and a machine with its links and PUMA B's
    friction, times sensitivity, of mass and of gravity coefficients [N m]."""
    table = rows("demo", "one_design.csv")
    return [
        max(float(row["product"]) for row in table if row["group"] == group)
        for group in ("mass", "gravity")
    ]
