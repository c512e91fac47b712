"""How much friction does a joint of a real arm have while it stands still?

Models are those of `jaxcslc identify` by its defaults. Errors are 100 |e| / |torque| of each joint
on the motion that is judged, of the raw torque, over all samples, as in `study.py`. Friction of
joints at rest (`jaxcslc.recordings.at_rest`) is

- by the sign of the measured velocity, as of joints that move;
- none; that of the motion before; or the mean of that of the motion before and after, as
  `jaxcslc.report.predicted_torque` has it (unknown at the ends of a recording: none).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

import jaxcslc as jc
from jaxcslc.recordings import at_rest, directions_beside
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm


jc.enable_x64()

_SLOW = 1e-12  # rad/s: only its sign counts


def lines_of(name: str, arm: Arm) -> list[list[str]]:
    """Return the lines of the table: for each motion, a row for each kind of friction at rest, and
    the rests.
    """
    network = jc.derive(arm.robot, lengths="numeric")
    report = jc.identify(network, arm.training, checks=False, systematic=False)
    raw = report.settings.with_options(torque_alignment="sample", smooth_torque=False)
    rows: list[list[str]] = []
    for test, recording in arm.tests.items():
        patterns = raw.patterns(recording)
        torque, qd = np.asarray(patterns.torque), np.asarray(patterns.qd)
        still = np.asarray(at_rest(qd))
        if not still.any():
            continue
        # Patterns have a velocity of zero at rest; smoothed positions have one of noise.
        trim = raw.preparation.trimmed(recording)
        _, smoothed, _ = raw.preparation.smoothing.smooth(recording.time, recording.position)
        noisy = smoothed[trim : recording.samples - trim]
        before, after = (_SLOW * np.asarray(x) for x in directions_beside(qd, still))
        errors = {
            name: _errors(report, dataclasses.replace(patterns, qd=velocity), torque)
            for name, velocity in (
                ("by the sign of velocity", np.where(still, noisy, qd)),
                ("none", np.where(still, 0.0, qd)),
                ("of the motion before", np.where(still, before, qd)),
                ("of the motion after", np.where(still, after, qd)),
            )
        }
        last = errors.pop("of the motion after")
        errors["mean of before and after"] = 0.5 * (errors["of the motion before"] + last)
        rows += [
            [name, test, kind, *_texts(100.0 * _size(error) / _size(torque))]
            for kind, error in errors.items()
        ]
        rows.append([name, test, "at rest [%]", *_texts(100.0 * still.mean(axis=0))])
    return rows


def _errors(report: jc.Report, patterns: jc.Patterns, torque: np.ndarray) -> np.ndarray:
    motion = patterns.q, patterns.qd, patterns.qdd
    return torque - np.asarray(report.network.torque(report.k, *motion))


def _size(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.sum(values**2, axis=0))


def _texts(values: np.ndarray) -> list[str]:
    return [f"{value:.1f}" for value in values]


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "rests")
    options = by_arm.parse(parser, argv, arms=["KUKA KR300"])
    header = ["arm", "motion", "friction at rest"]
    fitted = 0.4 if options.quick else 1.0

    return command.run(
        parser,
        lambda: by_arm.store_table(
            options,
            "rests",
            by_arm.print_table(options, lines_of, header, fitted=fitted),
            name="errors",
        ),
        seconds=10.0 * len(options.arms),
    )


if __name__ == "__main__":
    raise SystemExit(main())
