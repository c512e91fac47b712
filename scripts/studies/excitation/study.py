"""Designed motions: are they feasible, better than others, and what they are predicted to be?

A simulated PUMA 560 performs motions of 6.6 s, and is identified from the recordings.

- **design**: ten motions a criterion, from random starts of their own.
- **compare**: all disturbances; the designs in turns, a random feasible Fourier series a seed, and
  the thesis's training trajectory; ε on the comparison trajectory, errors and standard errors of
  coefficients, means of them: over sizes as designs have them, and over values.
- **directions**, **directional**, **auto**: the same, friction of each joint larger forwards or
  backwards by chance, the same chances for all motions; **directional**: designed for, and
  identified with, a model that has friction of each direction; **auto**: with the terms that the
  data ask for.
- **regression**, **likelihood**: encoders and white torque noise alone; predicted standard errors
  over those obtained, coefficient by coefficient.
- **arms**: designs of random arms of two to four joints under random limits, looked at on a grid of
  20,001 instants, the most that is used of any limit.
- **sequence**: seconds to 5 % on every coefficient, each recording designed after those before.
- **panda**: a Panda's URDF with its meshes over a floor, 20 s: feasible, condition numbers, time.

Rows of finished tasks are kept in `rows.jsonl`; an interrupted run goes on from there.
"""

import argparse
import importlib.util
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import zip_longest
from pathlib import Path
from typing import Any

import jax
import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from scripts.studies import command
from scripts.studies.excitation.motions import (
    DESIGNED,
    DESIGNS,
    DIRECTIONAL,
    MOTIONS,
    RANDOM,
    THESIS,
    Designs,
    path_of,
    predicted_errors,
)
from scripts.studies.excitation.pictures import figure
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


jc.enable_x64()

COMPARED = ("compare", "directions", "directional", "auto")
PARTS = ("design", *COMPARED, "regression", "likelihood", "arms", "sequence", "panda")
Task = tuple[str, str, int]
QUANTITIES = {
    "epsilon": "ε [N m]",
    "error": "mean error",
    "standard error": "mean standard error",
    "median error": "median error",
    "error over value": "mean error over value",
    "standard error over value": "mean standard error over value",
}


def panda_urdf() -> Path | None:
    """The Panda of `example-robot-data`, if it is installed."""
    spec = importlib.util.find_spec("cmeel")
    for root in list(spec.submodule_search_locations or []) if spec else []:
        path = Path(root).parent / "cmeel.prefix/share/example-robot-data/robots"
        path = path / "panda_description/urdf/panda.urdf"
        if path.exists():
            return path
    return None


_designs: Designs = {}


def begin(cache: str) -> None:
    """What each process does first."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    jc.enable_x64()
    jax.config.update("jax_compilation_cache_dir", cache)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def load_designs(parameters: dict[str, list[Any]]) -> None:
    """Makes motions of the parameters of designs, when they are all there."""
    if not _designs:
        _designs.update({name: [path_of(x) for x in draws] for name, draws in parameters.items()})


def row_of(
    task: Task, parameters: dict[str, list[Any]], urdf: str, steps: int, quick: bool
) -> dict[str, Any]:
    """A task's row; `parameters`: of the designs, by name."""
    from scripts.studies.excitation import tasks  # in the process that needs them

    load_designs(parameters)
    part, name, number = task
    if part == "design":
        row = tasks.designed(name, number, quick)
    elif part == "sequence":
        row = tasks.sequence(number, steps)
    elif part in COMPARED:
        row = tasks.compared(part, name, number, _designs)
    elif part in ("regression", "likelihood"):
        row = tasks.repeated(part, number, _designs)
    elif part == "arms":
        row = tasks.random_arms(number)
    else:
        row = tasks.panda(number, urdf, steps)
    return {"part": part, "name": name, "number": number, **row}


# Rows and columns of the page's tables; what a design's name is there.
_PAGE = {
    "epsilon": "ε [N m]",
    "error": "mean error",
    "standard error": "mean reported standard error",
}
_NAMES = {
    "overall": "designed: overall",
    "mean error": "designed: mean standard error",
    "condition number": "least condition number",
    RANDOM: "random Fourier series within the limits",
    THESIS: "the thesis's training trajectory",
}


def page_table(rows: Sequence[dict[str, Any]], *, inverse: bool = False) -> list[list[str]]:
    """The page's table of motions, the head first: medians over seeds, and ratios to the design.

    - `inverse`: ratios of the design to the motion.
    """
    ours = {row["number"]: row for row in rows if row["name"] == "overall"}
    table = [["motion", "recordings", *_PAGE.values()]]
    for name in MOTIONS:
        some = [row for row in rows if row["name"] == name]
        if not some:
            continue
        line = [_NAMES.get(name, name), str(len(some))]
        for quantity in _PAGE:
            percent = quantity != "epsilon"
            middle = np.median([row[quantity] for row in some]) * (100.0 if percent else 1.0)
            text = f"{middle:.2g} %" if percent else f"{middle:.3f}"
            if name != "overall":
                ratios = [
                    row[quantity] / ours[row["number"]][quantity]
                    for row in some
                    if row["number"] in ours
                ]
                low, median, high = np.quantile(
                    np.array(ratios) ** (-1 if inverse else 1), [0.1, 0.5, 0.9]
                )
                text += f"; {median:.2f} ({low:.2f} to {high:.2f})"
            line.append(text)
        table.append(line)
    return table


def compare_text(rows: Sequence[dict[str, Any]]) -> str:
    """Medians over seeds, with 10 and 90 % of them; ratios to the design, seed by seed."""
    lines = []
    ours = {row["number"]: row for row in rows if row["name"] == "overall"}
    for name in MOTIONS:
        of_motion = [row for row in rows if row["name"] == name]
        if not of_motion:
            continue
        line = [name, str(len(of_motion))]
        for quantity in QUANTITIES:
            values = [row[quantity] for row in of_motion]
            ratios = [
                row[quantity] / ours[row["number"]][quantity]
                for row in of_motion
                if row["number"] in ours
            ]
            low, high = np.quantile(ratios, [0.1, 0.9])
            line.append(f"{np.median(values):.4g}")
            line.append(f"{np.median(ratios):.2f} ({low:.2f} to {high:.2f})")
        lines.append(line)
    header = ["motion", "seeds"]
    for quantity in QUANTITIES.values():
        header += [quantity, "over design's"]
    return text_table(header, lines, left=("motion",))


def predicted_table(rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    """The page's table of predicted over obtained errors, the head first."""
    table = [["estimator", "recordings", "median", "least", "greatest"]]
    for part, name in (("regression", "regression"), ("likelihood", "maximum likelihood")):
        errors = np.array([row["errors"] for row in rows if row["part"] == part])
        predicted = predicted_errors(_designs["overall"][0], part).standard_error
        ratio = predicted / np.sqrt(np.mean(errors**2, axis=0))
        values = (np.median(ratio), ratio.min(), ratio.max())
        table.append([name, str(len(errors)), *(f"{value:.3g}" for value in values)])
    return table


def repeated_text(rows: Sequence[dict[str, Any]], part: str) -> str:
    """Predicted over obtained errors."""
    errors = np.array([row["errors"] for row in rows if row["part"] == part])
    reported = np.array([row["standard errors"] for row in rows if row["part"] == part])
    predicted = predicted_errors(_designs["overall"][0], part).standard_error
    ratios = {
        "error, RMS over seeds": predicted / np.sqrt(np.mean(errors**2, axis=0)),
        "error, about its mean": predicted / np.std(errors, axis=0, ddof=1),
        "reported standard error": predicted / np.median(reported, axis=0),
    }
    lines = [
        [name, *(f"{x:.2f}" for x in (np.median(r), *np.quantile(r, [0, 0.1, 0.9, 1])))]
        for name, r in ratios.items()
    ]
    header = [f"{part}, {len(errors)} seeds: predicted over", "median", "least", "10 %"]
    return text_table([*header, "90 %", "greatest"], lines)


def sequence_text(rows: Sequence[dict[str, Any]]) -> str:
    """Seconds to the goal over seeds."""
    lines = []
    for name in rows[0]["seconds"]:
        seconds = np.array([row["seconds"][name] for row in rows])
        ratio = seconds / np.array([row["seconds"]["in sequence"] for row in rows])
        low, high = np.quantile(ratio, [0.1, 0.9])
        spread = f"{np.median(ratio):.2f} ({low:.2f} to {high:.2f})"
        lines.append([name, f"{np.median(seconds):.3g}", spread])
    return text_table([f"seconds to 5 %, {len(rows)} seeds", "median", "over sequence's"], lines)


def tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return all tables of rows that there are."""
    texts: list[str] = []
    parts: dict[str, list[dict[str, Any]]] = {part: [] for part in PARTS}
    for row in rows:
        parts[row["part"]].append(row)
    texts += [f"{part}\n{compare_text(parts[part])}" for part in COMPARED if parts[part]]
    for part in ("regression", "likelihood"):
        if len(parts[part]) > 1:
            texts.append(repeated_text(parts[part], part))
    if arms := parts["arms"]:
        worst = [value for row in arms for value in row["worst"]]
        infeasible = sum(len(row["infeasible"]) for row in arms)
        texts.append(
            f"random arms: {len(arms)} arms, {len(worst)} designs, {infeasible} wishes infeasible;"
            f" most used of any limit {100 * max(worst):.4f} %, median"
            f" {100 * np.median(worst):.2f} %; over 100.1 %: {sum(x > 1.001 for x in worst)}"
        )
    if sequences := parts["sequence"]:
        texts.append(sequence_text(sequences))
    if pandas := parts["panda"]:
        spread = {
            name: np.quantile([row[name] for row in pandas], [0.0, 0.5, 1.0])
            for name in ("condition", "scaled condition", "seconds", "scale")
        }
        listed = "; ".join(
            f"{name} {low:.4g} to {high:.4g}, median {middle:.4g}"
            for name, (low, middle, high) in spread.items()
        )
        feasible = sum(row["feasible"] for row in pandas)
        texts.append(f"Panda: {feasible} of {len(pandas)} seeds feasible; {listed}")
    return texts


def study(options: argparse.Namespace) -> int:
    """Runs what is missing, prints the tables."""
    urdf = options.panda or panda_urdf()
    files = [Path(__file__).with_name(name) for name in ("tasks.py", "motions.py", "plans.py")]
    digest = made_of({"quick": options.quick}, files)
    finished = Rows(options.output / "rows.jsonl", ("part", "name", "number"), digest)
    end = time.monotonic() + 60.0 * options.minutes
    designs: list[Task] = [
        ("design", name, i) for i in range(options.designs) for name in _designed(options)
    ]
    parameters: dict[str, list[Any]] = {}
    context = multiprocessing.get_context("spawn")
    pool: Callable[..., ProcessPoolExecutor] = ProcessPoolExecutor
    # The same processes make designs and what follows: a new one imports and compiles again.
    with pool(options.jobs, context, begin, (options.cache,)) as executor:

        def run(tasks: Sequence[Task]) -> bool:
            missing = [task for task in tasks if task not in finished]
            return _run(executor, missing, finished, (parameters, str(urdf or "")), options, end)

        in_time = run(designs)
        for task in designs:
            if task in finished:
                parameters.setdefault(task[1], []).append(finished[task]["parameters"])
        if in_time:
            run(_tasks(options, bool(urdf)))
    begin(options.cache)
    load_designs(parameters)
    rows = [row for row in finished.all()]
    for text in tables(rows):
        print(text, end="\n\n")
    stored_parts(options, rows)
    if any(row["part"] == "compare" for row in rows):
        figure(rows, _designs["overall"][0], options.output / "excitation.png")
    return 0


def stored_parts(options: argparse.Namespace, rows: Sequence[dict[str, Any]]) -> None:
    """Keep the page's tables of the parts that there are."""
    parts = {part: [row for row in rows if row["part"] == part] for part in PARTS}
    sample = f"recordings as the columns say, {options.designs} designs of each criterion"
    if directional := parts["directional"]:
        tables = {"motions": page_table(directional, inverse=True)}
        store(options, "excitation_directional", sample, tables)
    if compared := parts["compare"]:
        tables = {"predicted": predicted_table(rows), "motions": page_table(compared)}
        tables["directions"] = page_table(parts["directions"], inverse=True)
        tables["auto"] = page_table(parts["auto"])
        store(options, "excitation", sample, tables)


def _designed(options: argparse.Namespace) -> tuple[str, ...]:
    """Names of the designs that the tasks need; of a trial run one, as each compiles for long."""
    if options.quick:
        return ("overall",)
    plain = options.seeds + options.directions + options.auto + options.repeats + options.fits
    return (*(DESIGNED if plain else ()), *(DIRECTIONAL.values() if options.directional else ()))


def _tasks(options: argparse.Namespace, with_panda: bool) -> list[Task]:
    """Return what is made of designs, or needs none."""
    tasks: list[Task] = [("arms", "", i) for i in range(options.arms)]
    tasks += [("sequence", "", i) for i in range(options.sequences)]
    tasks += [("regression", "", i) for i in range(options.repeats)]
    counts = (options.seeds, options.directions, options.directional, options.auto)
    for part, seeds in zip(COMPARED, counts, strict=True):
        # Of a trial run, the motions that need one design at most.
        designed = DIRECTIONAL if part == "directional" else _designed(options)
        motions = [name for name in MOTIONS if name in designed or name not in DESIGNED]
        tasks += [(part, name, i) for i in range(seeds) for name in motions]
    others: list[Task] = [("panda", "", i) for i in range(options.pandas if with_panda else 0)]
    fits: list[Task] = [("likelihood", "", i) for i in range(options.fits)]
    # In turns, so that a run that is stopped has some of both.
    return tasks + [task for pair in zip_longest(fits, others) for task in pair if task]


def _run(
    executor: ProcessPoolExecutor,
    tasks: Sequence[Task],
    finished: Rows,
    inputs: tuple[dict[str, list[Any]], str],
    options: argparse.Namespace,
    end: float,
) -> bool:
    """Makes rows until all are made or the time is over; whether all are."""
    if not tasks:
        return True
    futures = [
        executor.submit(row_of, task, *inputs, options.steps, options.quick) for task in tasks
    ]
    bar = command.progress(total=len(futures), desc="tasks")
    try:
        for future in as_completed(futures, timeout=max(end - time.monotonic(), 1.0)):
            finished.add(future.result())
            bar.update()
    except TimeoutError:
        print("the time is over; what is missing can be made later")
        processes = list(executor._processes.values())  # pyright: ignore
        executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        return False
    return True


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "excitation")
    parser.add_argument("--seeds", type=int, default=50, help="of compare")
    parser.add_argument("--directions", type=int, default=20, help="seeds of directions")
    parser.add_argument("--directional", type=int, default=50, help="seeds of directional")
    parser.add_argument("--auto", type=int, default=10, help="seeds of auto")
    parser.add_argument("--repeats", type=int, default=200, help="of regression")
    parser.add_argument("--fits", type=int, default=200, help="of likelihood")
    parser.add_argument("--arms", type=int, default=50, help="random arms, of 20 designs each")
    parser.add_argument("--pandas", type=int, default=100, help="designs of a Panda")
    parser.add_argument("--panda", type=Path, default=None, help="its URDF")
    parser.add_argument("--designs", type=int, default=DESIGNS, help="of each criterion")
    parser.add_argument("--sequences", type=int, default=12, help="of recordings")
    parser.add_argument("--steps", type=int, default=40, help="of a Panda's design, in a round")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--minutes", type=float, default=1e4, help="at most")
    parser.add_argument("--cache", default=".cache/jax", help="of compiled programs")
    quick = {"designs": 1, "seeds": 1, "repeats": 3, "fits": 0, "arms": 0, "pandas": 0, "jobs": 1}
    quick |= {"sequences": 0, "directions": 0, "directional": 0, "auto": 0}
    command.add_store(parser)
    options = command.parse(parser, argv, **quick)
    command.require_least(parser, options, seeds=0, repeats=0, fits=0, arms=0, pandas=0, jobs=1)
    command.require_least(parser, options, designs=1, sequences=0, directions=0, auto=0)
    command.require_least(parser, options, directional=0)
    seconds = (
        240 * options.designs
        + 120 * options.sequences
        + 25 * (options.seeds + options.directions + options.directional + 2 * options.auto)
        + options.repeats
        + 10 * options.fits
    )
    seconds += 60 * options.arms + 60 * options.pandas
    if options.quick:
        seconds /= 4  # one design of seven, and from one start
    return command.run(
        parser, lambda: study(options), options.output / "rows.jsonl", seconds=seconds
    )


if __name__ == "__main__":
    raise SystemExit(main())
