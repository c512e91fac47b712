from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...motion import Patterns
from ...network import AbstractLinearNetwork
from ...page import render
from .._held_out import HeldOut
from .._settings import settings_document
from ..friction import pre_sliding_document
from ._errors import ErrorTable, predicted_torque
from ._output import all_or_nothing, write_csv, write_json
from .page import WritableReport, report_page


if TYPE_CHECKING:
    from ._report import Report


RECORDINGS = ("training", "validation")
# States of the motion that are stored beside the coefficients.
_STATES = 100


def write_report(
    folder: Path,
    report: WritableReport,
    document: Mapping[str, Any],
    data: Mapping[str, Any],
    *,
    pictures: bool,
) -> list[Path]:
    """Writes the files of a report into a folder that exists.

    - `document`: what `identification.json` holds.
    - `data`: what the page shows, from `report_data`.

    **Returns** the files: `index.html`, `coefficients.csv`, `identification.json`, and for every
    recording `errors_NAME.csv` and `torque_NAME.csv`; of another system than a robot, its known
    sides in place of torques. Pictures are on the page.
    """
    network = report.network
    page = folder / "index.html"
    coefficients, identification = folder / "coefficients.csv", folder / "identification.json"
    page.write_text(render(report_page(data, charts=pictures)), encoding="utf-8")
    write_csv(coefficients, report.rows())
    write_json(identification, document)
    written = [page, coefficients, identification]
    for name, patterns in report.patterns.items():
        errors, torque = recording_files(folder, name, network.output_quantity)
        of_motion = report.network_along(name)
        predicted = np.asarray(predicted_torque(of_motion, patterns, report.fit.k))
        write_csv(errors, _error_rows(patterns, report.errors[name]))
        _write_torque(torque, network, patterns, predicted)
        written += [errors, torque]
    return written


def save_report(
    folder: Path,
    report: WritableReport,
    document: Mapping[str, Any],
    data: Mapping[str, Any],
    *,
    pictures: bool,
) -> tuple[Path, ...]:
    """Writes a report into a folder: all of its files or, if writing fails, none.

    Files of these names that an earlier report left and this one does not have are removed.

    **Returns** the files. **Raises** as `Report.save`.
    """
    with all_or_nothing(folder) as scratch:
        files = write_report(scratch, report, document, data, pictures=pictures)
        names = [path.name for path in files]
    for recording in RECORDINGS:
        for path in recording_files(folder, recording, report.network.output_quantity):
            if path.name not in names:
                path.unlink(missing_ok=True)
    return tuple(folder / name for name in names)


def recording_files(folder: Path, name: str, quantity: str) -> tuple[Path, Path]:
    """The files about one recording: its errors, and its torques or known sides."""
    stem = quantity.replace(" ", "_")
    return folder / f"errors_{name}.csv", folder / f"{stem}_{name}.csv"


def replaced_files(folder: Path) -> list[Path]:
    """The files of a folder that a report written into it may replace or remove."""
    files = [folder / name for name in ("index.html", "coefficients.csv", "identification.json")]
    for quantity in ("torque", "known sides"):
        for name in RECORDINGS:
            files += recording_files(folder, name, quantity)
    return files


def report_document(report: "Report", data: Mapping[str, Any]) -> dict[str, Any]:
    """A report as plain data, without its patterns.

    It holds every entry of `Identification.document`, so that `Identification.load` reads it too.

    - `data`: what the page shows, from `report_data`.
    """
    network, fit, errors = report.network, report.fit, report.errors
    document: dict[str, Any] = {
        "robot": network.robot.name,
        "lengths": network.algebra.lengths,
        "settings": settings_document(report.settings),
    }
    if network.static_slopes is not None:
        document["static_slopes"] = np.asarray(network.static_slopes, float)
    document |= {
        "friction": list(network.robot.friction),
        "joint_friction": [list(terms) for terms in network.robot.friction_per_joint],
        "coupled": [list(pair) for pair in network.robot.coupled],
        "expressions": [coefficient.expression for coefficient in network.coefficients],
        "units": [coefficient.unit for coefficient in network.coefficients],
        "unidentifiable": fit.unidentifiable,
        **fit.document(),
    }
    if report.groups is not None:
        document["fixed"] = list(report.fixed_names)
    if report.excitation is not None:
        document["least_determined"] = report.excitation.worst_combination
    if report.systematic is not None:
        document["systematic_error"] = dict(report.systematic.parts)
    if report.several is not None:
        document["recordings"] = report.several.document()
    if report.judged_part is not None:
        document["judged_part"] = report.judged_part
    if report.prior is not None:
        document["prior"] = report.prior.document()
    if report.possible is not None:
        document["possible"] = report.possible.document()
    if report.estimators is not None:
        document["estimators"] = report.estimators.document()
    if report.horizon is not None:
        document["horizon"] = report.horizon.document()
    if report.friction is not None:
        document["friction_trials"] = report.friction.document()
    if report.pre_sliding is not None:
        document["pre_sliding"] = pre_sliding_document(report.pre_sliding)
    if report.held_out is not None:
        document["held_out"] = _held_out(report.held_out)
    return document | {
        "torque_error_rms": {name: table.rms[0] for name, table in errors.items()},
        "torque_error_rms_all_samples": {
            name: table.rms_all_samples[0] for name, table in errors.items()
        },
        "share_judged": {name: table.share_judged for name, table in errors.items()},
        **quality_document(data),
        "warnings": report.warnings,
        "notes": report.notes,
        "motion": _some_motion(report.patterns["training"]),
    }


def quality_document(data: Mapping[str, Any]) -> dict[str, Any]:
    """The errors that the page of a report shows, as a part of its `identification.json`."""
    recordings = data["recordings"].items()
    return {
        "joints": data["joints"],
        "quality": {name: recording["quality"] for name, recording in recordings},
    }


def _some_motion(patterns: Patterns) -> dict[str, np.ndarray]:
    """States of the recording, evenly spaced: enough to compare torques over it later."""
    every = max(len(np.asarray(patterns.time)) // _STATES, 1)
    return {name: np.asarray(getattr(patterns, name))[::every] for name in ("q", "qd", "qdd")}


def _held_out(held_out: HeldOut) -> dict[str, Any]:
    return {
        "training_rms": held_out.training,
        "held_out_rms": held_out.held_out,
        "limit": held_out.limit,
        "beyond_chance": held_out.beyond_chance,
    }


def _error_rows(patterns: Patterns, errors: ErrorTable) -> list[dict[str, float | int | str]]:
    judged = np.sum(np.asarray(patterns.mask), axis=0)
    return [
        {
            errors.kind: errors.labels[joint],
            "rms": float(errors.rms[0, joint]),
            "mean_modulus": float(errors.mean_modulus[0, joint]),
            "judged_samples": int(judged[joint]),
            "samples": patterns.samples,
            "share_judged": float(errors.share_judged[joint]),
            "rms_all_samples": float(errors.rms_all_samples[0, joint]),
        }
        for joint in range(patterns.joints)
    ]


def _write_torque(
    path: Path, network: AbstractLinearNetwork, patterns: Patterns, predicted: np.ndarray
) -> None:
    joints = network.output_labels
    header = [f"{name}_{label}" for name in ("measured", "predicted", "mask") for label in joints]
    numbers = np.concatenate(
        [np.asarray(patterns.time)[:, None], np.asarray(patterns.torque), predicted], axis=1
    )
    # As `numpy.savetxt` writes them, in half of the time; a mask is one character.
    row = "%.10g," * numbers.shape[1] + "%s"
    mask = np.asarray(patterns.mask)
    masks = np.full((len(mask), 2 * mask.shape[1]), ord(","), np.uint8)
    masks[:, ::2] = np.where(mask, ord("1"), ord("0"))
    masks[:, -1] = ord("\n")
    ends = masks.view(f"S{masks.shape[1]}").ravel().astype(str).tolist()
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(["time", *header]) + "\n")
        file.writelines(
            row % (*values, end) for values, end in zip(numbers.tolist(), ends, strict=True)
        )
