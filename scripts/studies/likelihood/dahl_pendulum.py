"""A pendulum whose dry friction yields before it slides (Dahl 1968): what studies record and judge.

0.4 kg m², a weight of 3 N m, viscous friction of 0.3 N m s/rad and dry friction of 0.8 N m; torques
are held for 5 ms each, within which Runge and Kutta's method goes in steps of 0.2 ms.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store
from scripts.studies.tables import stacked


INERTIA, WEIGHT, VISCOUS, DRY = 0.4, 3.0, 0.3, 0.8
INTERVAL = 0.005  # s, that torques are held for and positions are read after
COUNT = 1e-4  # rad
_STEPS, _NOISE = 25, 0.02

State = Float[np.ndarray, "3"]
"""Position [rad], velocity [rad/s], and the contact's state from -1 to 1."""


def pendulum() -> tuple[jc.CSLC, Float[np.ndarray, " coefficients"]]:
    """Its network, and the true coefficients."""
    robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")
    true = {"kB1": INERTIA, "kB2": WEIGHT / 9.81, "kB3": 0.0, "kv1": VISCOUS, "kd1": DRY}
    return network, np.array([true[name] for name in network.names])


def after_interval(state: State, torque: float, length: float) -> State:
    """The state after a torque [N m] was held for an interval; `length` of pre-sliding [rad]."""

    def rates(state: State) -> State:
        q, qd, w = state
        net = torque - WEIGHT * np.cos(q) - VISCOUS * qd - DRY * w
        return np.array([qd, net / INERTIA, (qd - abs(qd) * w) / length])

    step = INTERVAL / _STEPS
    for _ in range(_STEPS):
        one = rates(state)
        two = rates(state + 0.5 * step * one)
        three = rates(state + 0.5 * step * two)
        four = rates(state + step * three)
        state = state + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    return state


def counted(position: Float[np.ndarray, "*samples"] | float) -> Float[np.ndarray, "*samples"]:
    """Positions as the encoder reads them [rad]."""
    return COUNT * np.round(np.asarray(position) / COUNT)


def recording(
    position: Float[np.ndarray, " samples"],
    torque: Float[np.ndarray, " samples"],
    rng: np.random.Generator,
) -> jc.Recording:
    """Return the recording of positions that were read and torques that acted [N m], with torque
    noise of 0.02 N m.
    """
    noisy = torque + _NOISE * rng.normal(size=len(torque))
    return jc.Recording(INTERVAL * np.arange(len(torque)), position[:, None], noisy[:, None])


def torque_error(network: jc.CSLC, difference: Float[np.ndarray, " coefficients"]) -> float:
    """RMS torque of a difference of coefficients where the pendulum slides [N m]."""
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-1, 1, (3, 300, 1)) * np.array([1.0, 2.0, 8.0])[:, None, None]
    return float(np.sqrt(np.mean(np.square(network.torque(difference, q, qd, qdd)))))


def study_lengths(
    options: argparse.Namespace,
    lengths: Sequence[float],
    module: str,
    what: str,
    last: str,
    rows_of: Callable[[float, int, int], Iterator[dict[str, Any]]],
    table: Callable[[Sequence[dict[str, Any]], float], list[list[str]]],
) -> int:
    """Make the rows that are missing, print a table per length, and write the rows.

    - `lengths`: of pre-sliding [rad].
    - `module`: file of the study; `what`: the column that tells rows of a recording apart, and
      `last`: its value in the last of them.
    """
    digest = made_of({"samples": options.samples}, [Path(module), Path(__file__)])
    finished = Rows(options.output / "rows.jsonl", ("length", "seed", what), digest)
    cases = [(length, seed) for length in lengths for seed in command.seeds_of(options)]
    for length, seed in command.progress(cases, desc="recordings", unit="recording"):
        if (length, seed, last) not in finished:
            for row in rows_of(length, seed, options.samples):
                finished.add(row)
    rows = [row for row in finished.all() if (row["length"], row["seed"]) in cases]
    tables = {f"{1e3 * length:g} mrad": table(rows, length) for length in lengths}
    for head, *lines in tables.values():
        print(text_table(head, lines), end="\n\n")
    seeds = command.seeds_of(options)
    run = f"likelihood_{Path(module).stem}"
    store(options, run, f"seeds {seeds[0]} to {seeds[-1]}", {"lengths": stacked("length", tables)})
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0
