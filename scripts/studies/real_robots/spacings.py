"""How far apart maximum likelihood has positions: torque errors of real arms with each spacing.

Every arm's training recording is fitted with positions at every sample, at every second, third and
sixth, and as far apart as `jaxcslc.MaximumLikelihood` selects. Errors are those of `study`, in
percent of the raw torque over all samples of motion that was not fitted, joint by joint. A KUKA
LWR4+ is fitted to its first recording and judged on its third, a faster motion, and on its second,
a repetition.
"""

from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np

import jaxcslc as jc
from jaxcslc._text_table import text_table
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import READERS, Arm, read
from scripts.studies.real_robots.methods import Model
from scripts.studies.real_robots.study import judged
from scripts.studies.stored import store


jax.config.update("jax_enable_x64", True)

LWR4, LWR4_FOLDER = "KUKA LWR4+", "kuka_lwr4"
SPACINGS = (1, 2, 3, 6, "auto")


def lwr4(folder: Path) -> Arm:
    """KUKA LWR4+: joint positions and torques of joint sensors, three recordings at 200 Hz."""
    first, second, third = (jc.load_recording(folder / f"hw{number}.csv") for number in (1, 2, 3))
    return Arm(
        jc.load_robot(folder / "kuka_lwr4.urdf").with_friction("viscous", "dry", "offset"),
        first,
        {"other motion": third, "repetition": second},
        "kjyv/FloBaRoID, LGPL-3.0",
        "the first recording is fitted, the others are judged",
    )


def models_of(arm: Arm) -> list[Model]:
    """Least squares, and maximum likelihood with each spacing, all with the same settings."""
    network = jc.derive(arm.robot, lengths="numeric")
    report = jc.identify(network, arm.training, possible="never", checks=False, systematic=False)
    settings = report.settings
    models = [Model("least squares", report.network, np.asarray(report.k), settings, 0.0, "")]
    sampled = settings.preparation.torque_alignment == "sample"
    start = None if "static" in network.robot.friction_terms else report.fit
    for every in SPACINGS:
        estimator = jc.MaximumLikelihood(
            torque_sampling="sampled" if sampled else "held", settings=settings, every=every
        )
        fit = estimator.fit(network, arm.training, start)
        name = f"every {every}" + f" ({fit.every})" * (every == "auto")
        models.append(Model(name, fit.network, np.asarray(fit.k), settings, 0.0, ""))
    return models


def rows_of(name: str, arm: Arm) -> list[list[str]]:
    """A row for each recording and spacing."""
    rows: list[list[str]] = []
    for model in models_of(arm):
        for test, recording in arm.tests.items():
            errors = judged(model, model.settings, recording)["all"]
            values = [*errors, float(np.mean(errors))]
            rows.append([name, test, model.method, *(f"{value:.1f}" for value in values)])
    return rows


def page_table(means: list[list[str]]) -> list[list[str]]:
    """The page's table, the head first: mean errors by recording, a column for each spacing.

    - `means`: recording, method and error; what `every auto` chose is in brackets.
    """
    by_recording: dict[str, dict[str, str]] = {}
    for recording, method, mean in means:
        name, _, chosen = method.partition(" (")
        text = f"{mean} ({chosen}" if chosen else mean
        by_recording.setdefault(recording, {})[name] = text
    head = ["least squares", *(f"every {spacing}" for spacing in SPACINGS)]
    return [["", *head], *([name, *(x[y] for y in head)] for name, x in by_recording.items())]


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "spacings")
    command.add_store(parser)
    options = command.parse(parser, argv, arms=["KUKA KR300"])
    command.require_some_of(parser, "arm", options.arms, tuple(READERS))

    def study() -> int:
        means: list[list[str]] = []
        for name in command.progress(options.arms, desc="arms", unit="arm"):
            arm = lwr4(options.data / LWR4_FOLDER) if name == LWR4 else read(name, options.data)
            rows = rows_of(name, arm)
            joints = [str(joint + 1) for joint in range(len(rows[0]) - 4)]
            header = ["arm", "recording", "maximum likelihood", *joints, "mean"]
            print(text_table(header, rows, left=header[:3]), end="\n\n")
            means += [[f"{arm}, {test}", method, mean] for arm, test, method, *_, mean in rows]
        store(options, "spacings", "one recording of each motion", {"errors": page_table(means)})
        return 0

    return command.run(parser, study, seconds=15.0 * len(options.arms))


if __name__ == "__main__":
    raise SystemExit(main())
