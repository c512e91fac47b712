"""What the robot's file is worth as prior, with right and wrong files.

MuJoCo computes the torques of a UR5 and a Panda; friction, encoder steps and noise are added. The
file that `identify` reads differs from the arm: by what files are usually wrong by (masses 20 %,
centres 2 cm), or by much more. Weak motions leave most of the arm open. The rigid-body torque of a
rich motion, which was not fitted, judges: its error over that of the file, and over that of a fit
without the file. With a rich motion the intervals are judged: how many hold the true coefficient,
and how far the file moves them.
"""

import dataclasses
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
from jaxcslc._text_table import counted, text_table
from jaxcslc.bodies import bodies_of, body_map
from jaxcslc.manipulator import LinkParameters
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.stored import store


ROBOTS = Path(jc.examples.__file__).parent / "robots"
ARMS = ("ur5", "panda")
MOTIONS = (
    "one by one",
    "two joints",
    "slow",
    "small",
    "short",
    "one pose",
    "constant speeds",
    "wrist",
    "base",
    "single sine",
)
"""Weak motions; `"rich"` is the one that is no such."""
FILES = {
    "right": "right",
    "usual": "usual: masses 20 %, centres 2 cm",
    "half masses": "half the masses",
    "double masses": "twice the masses",
    "absurd inertia": "one inertia 100 times",
    "no tool": "a tool of 12 % of the arm missing",
    "far centre": "one centre 14 cm off",
}
"""Files: right, wrong as files usually are, and wrong on purpose in five ways."""
RATE = 200.0
STEP = 2 * np.pi / 2**18  # of encoders [rad]
NOISE = 0.01  # of each joint's RMS torque
_COST = 1.1  # torque errors over those of the fit without the file, above which the file costs
TOOL = 0.12  # mass of a tool that the file lacks, as a part of the arm's

Motion = tuple[Float[np.ndarray, "samples joints"], ...]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the study. **Returns** the exit status."""
    parser = command.new_parser(__doc__, "file_prior")
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help="some of them")
    parser.add_argument("--motions", nargs="+", default=[*MOTIONS, "rich"], help="some of them")
    parser.add_argument("--files", nargs="+", default=list(FILES)[1:], help="some of them")
    parser.add_argument(
        "--offset", type=float, default=0.0, help="torque offsets, in joints' Coulomb friction"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    command.add_seeds(parser, 2)
    command.add_store(parser)
    options = command.parse(
        parser, arguments, arms=["ur5"], motions=["slow", "rich"], files=["usual"], seeds=2
    )
    command.require_least(parser, options, seeds=1, jobs=1)
    command.require_some_of(parser, "arm", options.arms, ARMS)
    command.require_some_of(parser, "motion", options.motions, (*MOTIONS, "rich"))
    command.require_some_of(parser, "file", options.files, tuple(FILES))
    keys = ("arm", "motion", "file", "seed")
    rows = Rows(
        options.output / "rows.jsonl", keys, made_of({"offset": options.offset}, [Path(__file__)])
    )
    jobs = list(product(options.arms, options.motions, options.files, command.seeds_of(options)))
    missing = [job for job in jobs if job not in rows]
    return command.run(
        parser,
        lambda: _study(rows, jobs, missing, options),
        rows.path,
        seconds=8.0 * len(missing) / options.jobs + 10.0,
    )


def _study(rows: Rows, jobs: list[Any], missing: list[Any], options: Any) -> int:
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        jobs_of = {pool.submit(judged, *job, offset=options.offset): job for job in missing}
        for done in command.progress(as_completed(jobs_of), total=len(missing), desc="fits"):
            names = zip(("arm", "motion", "file", "seed"), jobs_of[done], strict=True)
            rows.add(dict(names) | done.result())
    text = "\n".join(_tables([rows[job] for job in jobs]))
    print(text)
    options.output.mkdir(parents=True, exist_ok=True)
    (options.output / "tables.txt").write_text(text + "\n", encoding="utf-8")
    finished = [row for row in (rows[job] for job in jobs) if "failed" not in row]
    sample = f"{counted(len(options.arms), 'arm')}, {counted(options.seeds, 'seed')} of each"
    if not options.offset:
        tables = {"files": _files(finished), "links": _links(finished)}
        store(options, "file_prior", sample, tables)
        store(options, "file_prior_intervals", sample, {"intervals": _intervals(finished)})
    return 0


def judged(arm: str, motion: str, file: str, seed: int, offset: float = 0.0) -> dict[str, Any]:
    """Return the errors of one recording, fitted with and without the file.

    - `offset`: standard deviation of torque offsets, as a part of each joint's Coulomb friction.
      With such, offsets are identified as the command does by default.
    """
    jc.enable_x64()
    rng = np.random.default_rng([seed, MOTIONS.index(motion) if motion in MOTIONS else 99])
    robot = jc.load_robot(ROBOTS / f"{arm}.urdf")
    truth = robot.links
    assert truth is not None
    links = wrong(rng, file, truth)
    model = model_of(arm, file == "no tool")
    states = moved(rng, model, motion)
    n = model.nv
    size = np.sqrt(np.mean(torque_of(model, moved(rng, model, "rich")) ** 2, axis=0))
    viscous, dry = 0.1 * size, 0.1 * size
    time = np.arange(len(states[0])) / RATE
    rigid = torque_of(model, states)
    friction = viscous * states[1] + dry * np.tanh(states[1] / 0.002)
    friction += offset * dry * np.random.default_rng([seed, 5]).standard_normal(n)
    noise = NOISE * size * rng.standard_normal(rigid.shape)
    position = STEP * np.floor(states[0] / STEP + rng.uniform(size=n))
    recording = jc.Recording(time, position, rigid + friction + noise)
    network = jc.derive(dataclasses.replace(robot, links=tuple(links)), lengths="numeric")
    of_bodies, _ = body_map(network.algebra)
    inertial = network.layout.inertial
    true = true_coefficients(network, model)
    stated = np.einsum("ple,le->p", of_bodies, bodies_of(links))
    new = moved(np.random.default_rng(seed + 10_000), model, "rich")
    expected = torque_of(model, new)
    try:
        fits = {use: _fit(network, recording, use, offset > 0.0) for use in (True, False)}
    except RuntimeError as failure:
        return {"failed": str(failure).split("\n")[0]}

    def error(values: Float[np.ndarray, " inertial"]) -> list[float]:
        k = np.zeros(network.size)
        k[inertial] = values
        return _rms(np.asarray(network.torque(k, *new)) - expected).tolist()

    with_file, without = fits[True], fits[False]
    weight = with_file.file_prior
    interval = np.stack([[row["low"], row["high"]] for row in with_file.rows()])[inertial]
    noise = np.asarray(with_file.fit.confidence_interval())[inertial]
    share = weight.share[inertial]
    assert without.possible is not None
    unaided = np.asarray(without.possible.free.k)[inertial]
    informed = np.asarray(with_file.k)[inertial]
    spread = np.asarray(without.fit.standard_error)[inertial]
    bodies = with_file.bodies
    assert bodies is not None, with_file.warnings
    return {
        "with": error(informed),
        "without": error(unaided),
        "today": error(np.asarray(without.k)[inertial]),
        "file_error": error(stated),
        "torque": _rms(expected).tolist(),
        "inside": ((interval[:, 0] <= true) & (true <= interval[:, 1])).tolist(),
        "inside_noise": ((noise[:, 0] <= true) & (true <= noise[:, 1])).tolist(),
        "share": share.tolist(),
        "change": (np.abs(informed - unaided) / np.where(spread > 0, spread, np.inf)).tolist(),
        "contradicted": list(weight.contradicted),
        "named": bool(weight.contradicted or weight.implausible),
        "width": weight.width,
        "misfit": weight.misfit,
        "body_error": _body_errors(bodies.links, truth),
        "file_body_error": _body_errors(links, truth),
        "verdicts": [str(row["verdict"]) for row in with_file.rows()][: len(true)],
    }


def _fit(network: jc.CSLC, recording: jc.Recording, use: bool, offsets: bool) -> jc.Report:
    return jc.identify(
        network,
        recording,
        friction="offset" if offsets else None,
        checks=False,
        file_prior=use,
        progress=False,
    )


def moved(rng: np.random.Generator, model: Any, motion: str) -> Motion:
    """Positions, velocities and accelerations of a motion of `MOTIONS`, or of the rich one."""
    n = model.nv
    duration = {"short": 2.0, "rich": 20.0}.get(motion, 5.0)
    time = np.arange(int(duration * RATE)) / RATE
    low, high = np.clip(model.jnt_range, -2.5, 2.5).T
    limited = np.asarray(model.jnt_limited, bool)
    low, high = np.where(limited, low, -2.5), np.where(limited, high, 2.5)
    middle, half = (low + high) / 2, 0.4 * (high - low)
    base = 2 * np.pi * {"slow": 0.05, "rich": 0.1}.get(motion, 0.2)
    orders = np.arange(1, 2 if motion == "single sine" else 6)
    amplitude = rng.standard_normal((len(orders), n)) / orders[:, None]
    phase = rng.uniform(0, 2 * np.pi, (len(orders), n))
    scale = np.full(n, {"small": 0.1, "one pose": 0.15, "slow": 0.4}.get(motion, 1.0))
    offset = np.zeros(n)
    if motion == "one pose":
        offset = 0.5 * half * rng.uniform(-1, 1, n)
    if motion == "two joints":
        scale *= np.isin(np.arange(n), rng.choice(n, 2, replace=False))
    if motion == "wrist":
        scale[: n - 3] = 0.0
    if motion == "base":
        scale[3:] = 0.0
    if motion == "constant speeds":
        return _constant_speeds(rng, time, middle, half)
    angle = base * orders[:, None, None] * time[:, None] + phase[:, None]
    weights = amplitude[:, None]
    speed = base * orders[:, None, None]
    waves = (
        np.sum(weights * np.sin(angle), axis=0),
        np.sum(weights * speed * np.cos(angle), axis=0),
        np.sum(-weights * speed**2 * np.sin(angle), axis=0),
    )
    size = scale * half / np.max(np.abs(waves[0]), axis=0)
    q, qd, qdd = (size * wave for wave in waves)
    if motion == "one by one":
        turn = (time * n / duration).astype(int)
        moving = turn[:, None] == np.arange(n)
        blend = np.sin(np.pi * (time * n / duration - turn))[:, None] ** 3 * moving
        q = blend * q
        qd, qdd = np.gradient(q, 1 / RATE, axis=0), np.zeros_like(q)
        qdd = np.gradient(qd, 1 / RATE, axis=0)
    return middle + offset + q, qd, qdd


def _constant_speeds(
    rng: np.random.Generator,
    time: Float[np.ndarray, " samples"],
    middle: Float[np.ndarray, " joints"],
    half: Float[np.ndarray, " joints"],
) -> Motion:
    """There and back at constant speeds, with smooth reversals."""
    period = rng.uniform(2.0, 3.0, len(half))
    angle = 2 * np.pi * time[:, None] / period + rng.uniform(0, 2 * np.pi, len(half))
    sharp = 0.97
    q = half * np.arcsin(sharp * np.sin(angle)) / np.arcsin(sharp)
    qd = np.gradient(q, 1 / RATE, axis=0)
    return middle + q, qd, np.gradient(qd, 1 / RATE, axis=0)


def model_of(arm: str, tool: bool) -> Any:
    """MuJoCo's model of an arm, with a tool that its file lacks."""
    spec = mujoco.MjSpec.from_file(str(ROBOTS / f"{arm}.urdf"))
    if tool:
        arm_mass = float(np.sum(spec.compile().body_mass))
        body = spec.bodies[-1].add_body(name="tool", pos=[0.0, 0.0, 0.1])
        body.mass, body.inertia = TOOL * arm_mass, [0.01, 0.01, 0.005]
        body.ipos, body.explicitinertial = [0.0, 0.0, 0.0], True
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # no torque of ends of travel
    return model


def torque_of(model: Any, states: Motion) -> Float[np.ndarray, "samples joints"]:
    """Torques of the arm, by MuJoCo."""
    data = mujoco.MjData(model)
    torque = np.zeros_like(states[0])
    for i, (q, qd, qdd) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse
    return torque


def true_coefficients(network: jc.CSLC, model: Any) -> Float[np.ndarray, " inertial"]:
    """The inertial coefficients that MuJoCo's torques follow."""
    states = tuple(np.random.default_rng(0).normal(size=(3, 200, model.nv)))
    inertial = network.layout.inertial
    rows = np.asarray(network.regressor(*states))[..., inertial]
    torque = torque_of(model, states)
    return np.linalg.lstsq(rows.reshape(-1, rows.shape[-1]), torque.ravel())[0]


def wrong(
    rng: np.random.Generator, file: str, links: Sequence[LinkParameters]
) -> list[LinkParameters]:
    """Links as a file of `FILES` has them."""
    n = len(links)
    factor, shift, inertia = np.ones(n), np.zeros((n, 3)), np.ones(n)
    if file != "right":
        factor = 1.0 + 0.2 * np.clip(rng.standard_normal(n), -2.0, 2.0)
        shift = 0.02 / np.sqrt(3.0) * rng.standard_normal((n, 3))
    factor *= {"half masses": 0.5, "double masses": 2.0}.get(file, 1.0)
    if file == "absurd inertia":
        inertia[n // 2] = 100.0
    if file == "far centre":
        shift[1] += [0.1, 0.1, 0.0]
    return [
        LinkParameters(
            float(link.mass) * by,
            np.asarray(link.centre_of_gravity) + move,
            np.asarray(link.inertia) * by * tensor,
            link.motor_inertia,
        )
        for link, by, move, tensor in zip(links, factor, shift, inertia, strict=True)
    ]


def _body_errors(
    links: Sequence[LinkParameters], truth: Sequence[LinkParameters]
) -> list[list[float]]:
    """Errors of masses, as parts of them, and of centres [m]."""
    return [
        [
            abs(float(link.mass) / float(other.mass) - 1.0),
            float(np.linalg.norm(link.centre_of_gravity - np.asarray(other.centre_of_gravity))),
        ]
        for link, other in zip(links, truth, strict=True)
    ]


def _rms(values: Float[np.ndarray, "samples joints"]) -> Float[np.ndarray, " joints"]:
    return np.sqrt(np.mean(values**2, axis=0))


def _files(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A line for each file, the head first: ratios of torque errors, median and 95 %."""
    cells: list[list[str]] = []
    for file in dict.fromkeys(row["file"] for row in rows):
        some = [row for row in rows if row["file"] == file and row["motion"] != "rich"]
        rich = [row for row in rows if row["file"] == file and row["motion"] == "rich"]
        if not some:
            continue
        ratios = np.array(
            [
                [
                    _total(row, "with") / _total(row, name)
                    for name in ("file_error", "without", "today")
                ]
                for row in some
            ]
        )
        median, most = np.quantile(ratios, (0.5, 0.95), axis=0)
        cells.append(
            [
                FILES[file],
                str(len(some)),
                *(f"{a:.2f}, {b:.2f}" for a, b in zip(median, most, strict=True)),
                f"{100 * np.mean(np.max(ratios[:, :2], axis=1) <= 1.0):.0f}",
                f"{100 * np.mean(ratios[:, 1] <= _COST):.0f}",
                *(_part_warned(group) for group in (some, rich)),
            ]
        )
    header = ["file", "recordings", "error over file", "error over fit", "error over consistent"]
    header += ["below file and fit [%]", "below 1.1 times fit [%]", "warned [%]"]
    header += ["warned, rich motion [%]"]
    return [header, *cells]


def _tables(rows: list[dict[str, Any]]) -> Iterator[str]:
    failed = [row for row in rows if "failed" in row]
    rows = [row for row in rows if "failed" not in row]
    if failed:
        yield f"{len(failed)} recordings too short to be fitted"
    yield "torque of a rich motion after a weak one: error over that of the file, and of two fits"
    head, *lines = _files(rows)
    yield text_table(head, lines, left=("file",))
    for file in dict.fromkeys(row["file"] for row in rows):
        yield ""
        yield from _determined(file, [row for row in rows if row["file"] == file])
    yield ""
    yield from _bodies(rows)


def _part_warned(rows: list[dict[str, Any]]) -> str:
    """Part of the recordings at which a warning names the file's values [%]."""
    return f"{100 * np.mean([row['named'] for row in rows]):.0f}" if rows else "-"


def _total(row: dict[str, Any], name: str) -> float:
    """Error of the worst joint, in units of the joints' torque; at least the noise's."""
    return max(float(np.max(np.divide(row[name], row["torque"]))), NOISE)


def _known(rows: list[dict[str, Any]]) -> Float[np.ndarray, "3 coefficients"]:
    """Return the changes by the file [standard errors] of what rich motions determine by nine
    tenths, and whether it is inside of printed intervals, and of those of standard errors.
    """
    names = ("change", "inside", "inside_noise")
    told = [
        np.array([row[name] for name in names], float)[:, np.array(row["share"]) < 0.1]
        for row in rows
        if row["motion"] == "rich"
    ]
    return np.concatenate(told, axis=1) if told else np.zeros((3, 0))


def _intervals(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A line for each file, the head first: intervals that contain the truth."""
    head = ["file", "coefficients", "printed interval [%]", "standard error alone [%]"]
    table = [[*head, "change by the file, median and 95 % [standard errors]"]]
    for file in dict.fromkeys(row["file"] for row in rows):
        changes, inside, inside_noise = _known([row for row in rows if row["file"] == file])
        if len(changes):
            median, most = np.quantile(changes, (0.5, 0.95))
            shares = [f"{100 * np.mean(part):.1f}" for part in (inside, inside_noise)]
            table.append([FILES[file], str(len(changes)), *shares, f"{median:.3f}, {most:.3f}"])
    return table


def _links(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A line for each motion, the head first: errors of masses and centres with usual files, over
    those of the file, root mean squares over links and recordings.
    """
    table = [["motion", "masses", "centres"]]
    usual = [row for row in rows if row["file"] == "usual"]
    for motion in dict.fromkeys(row["motion"] for row in usual):
        some = [row for row in usual if row["motion"] == motion]
        ours, files = (
            np.sqrt(np.mean(np.square(np.concatenate([row[name] for row in some])), axis=0))
            for name in ("body_error", "file_body_error")
        )
        table.append([motion, *(f"{ratio:.2f}" for ratio in ours / files)])
    return table


def _determined(file: str, rows: list[dict[str, Any]]) -> Iterator[str]:
    changes, inside, inside_noise = _known(rows)
    if not len(changes):
        return
    median, most = np.quantile(changes, (0.5, 0.95))
    yield (
        f"{file}, rich motion, {len(changes)} coefficients of which the file is less than 10 %:"
        f" change by the file, median {median:.3f}, 95 % {most:.3f} standard errors; inside"
        f" their intervals {100 * np.mean(inside):.1f} %, and inside those of the standard error"
        f" alone {100 * np.mean(inside_noise):.1f} %"
    )


def _bodies(rows: list[dict[str, Any]]) -> Iterator[str]:
    usual = [row for row in rows if row["file"] == "usual"]
    if not usual:
        return
    for index, name in enumerate(("masses", "centres")):
        ratios = [
            [
                ours[index] / max(theirs[index], 1e-9)
                for ours, theirs in zip(row["body_error"], row["file_body_error"], strict=True)
            ]
            for row in usual
        ]
        total = [
            np.sqrt(np.mean(np.square(np.array(row["body_error"])[:, index])))
            / np.sqrt(np.mean(np.square(np.array(row["file_body_error"])[:, index])))
            for row in usual
        ]
        yield (
            f"identified {name} over the file's errors: root mean square over links, median"
            f" {np.median(total):.2f}, 95 % {np.quantile(total, 0.95):.2f}; median link"
            f" {np.median(np.concatenate(ratios)):.2f}"
        )


if __name__ == "__main__":
    raise SystemExit(main())
