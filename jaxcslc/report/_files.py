"""Files of reports: what they wrote is read back, and a folder of them written, all or none.

Documents, settings and the network of a saved robot are read; CSV, JSON and a page are written.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._plain_data import plain, record_from
from .._scratch import all_or_nothing
from .._text_table import csv_line
from ..least_squares import Identification, Settings, settings_from
from ..manipulator import Manipulator, RobotError
from ..network import CSLC, derive
from ._page import render


if TYPE_CHECKING:
    from ._report import AbstractReport


# SI units. No robot comes near; and squares, in covariances, are far from overflow.
_LARGEST = 1e12


def read_files(
    path: str | Path,
) -> tuple[Settings | None, Identification, dict[str, Any]]:
    """Return settings, fit and all entries of a report's files.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.

    **Raises**

    - `ValueError`: there is no such file, or it holds something else.
    """
    file = identification_file(path)
    document = _document(file, "identification.json, or a folder with one")
    fit = _fit(document, file)
    _check_texts(document, file)
    settings = load_settings(file) if "settings" in document else None
    charts = file.parent / "charts.json"
    if file.name == "identification.json" and charts.exists():
        document = {**_document(charts, "report's drawings"), **document}
    return settings, fit, document


def load_settings(path: str | Path) -> Settings:
    """Return settings from a report's `identification.json`, or from a JSON file of their own.

    **Arguments**

    - `path`: of the file, or of the report's folder.

    **Returns** `Settings`.

    **Raises**

    - `ValueError`: the file holds something else; the message names file and entry.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "settings.json"
    ...     _ = path.write_text('{"cutoff": 15.0}')
    ...     load_settings(path).solver.cutoff
    15.0
    """
    path = identification_file(path)
    document = _document(path, "settings file")
    entries = document.get("settings", document)
    if not isinstance(entries, dict):
        raise ValueError(f"{path}: settings: expected a JSON object")
    try:
        return settings_from(entries)
    except ValueError as error:
        # With its traceback, which leads the command to the page on settings.
        raise ValueError(f"{path}: {error}").with_traceback(error.__traceback__) from None


def identification_file(path: str | Path) -> Path:
    """The `identification.json` of a report's folder, or the file itself."""
    path = Path(path)
    return path / "identification.json" if path.is_dir() else path


def _document(path: Path, kind: str) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path}: no such {kind}") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(f"{path}: not valid JSON: {error}; expected {kind}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected a JSON object ({kind})")
    return document


def _check_texts(document: Mapping[str, Any], path: Path) -> None:
    model = document.get("model")
    for entries in (document, model if isinstance(model, dict) else {}):
        for name in ("joints", "expressions", "units", "labels", "groups", "lines"):
            texts = entries.get(name)
            if isinstance(texts, list) and not all(isinstance(text, str) for text in texts):
                wrong = next(text for text in texts if not isinstance(text, str))
                raise ValueError(f"{path}: {name}: expected texts, got {wrong!r}")


def _fit(document: Mapping[str, Any], path: Path) -> Identification:
    """**Raises** `ValueError` for numbers that no robot has, and that would overflow."""
    try:
        fit = Identification.from_document(document, str(path))
    except OverflowError as error:
        raise ValueError(f"{path}: {error}") from None
    for name, value in zip(fit.names, np.asarray(fit.k), strict=True):
        if not abs(value) <= _LARGEST:
            raise ValueError(
                f"{path}: {name} is {value:.3g}; expected finite coefficients below {_LARGEST:g}"
            )
    for name in ("covariance", "independent_covariance"):
        if np.any(np.abs(np.asarray(getattr(fit, name))) > _LARGEST**2):
            raise ValueError(f"{path}: {name}: expected variances below {_LARGEST**2:g}")
    if not float(fit.degrees_of_freedom) >= 0.0:
        raise ValueError(
            f"{path}: degrees_of_freedom is {float(fit.degrees_of_freedom):g}; expected 0 or more"
        )
    return fit


def saved_network(
    document: Mapping[str, Any], fit: Identification, where: Path | str, robot: Manipulator | None
) -> CSLC:
    """Return the network of a report's `identification.json`.

    **Arguments**

    - `document`: what the file holds.
    - `fit`: in it.
    - `where`: it was read.
    - `robot`: that was identified; that of the file if None.

    **Raises**

    - `ValueError`: the file holds no robot, or is of another than `robot`.
    """
    robot = _robot(document, where) if robot is None else _with_friction(robot, document, where)
    network = derive(robot, lengths=_lengths(document, where))
    if network.static_slopes is not None and "static_slopes" in document:
        try:
            network = network.with_static_slopes(np.asarray(document["static_slopes"], float))
        except (TypeError, ValueError) as error:
            raise ValueError(f"{where}: static_slopes: {error}") from None
    if difference := _difference(network, document, fit.names):
        raise ValueError(f"{where}: {difference}; expected an identification of this robot")
    if network.load_terms:  # it follows the torque of the identified bodies
        network = network.with_load(np.asarray(fit.k))
    return network


def _robot(document: Mapping[str, Any], where: Path | str) -> Manipulator:
    if "manipulator" not in document:
        raise ValueError(f"{where}: has no robot; expected a folder that `Report.save` wrote")
    try:
        return record_from(Manipulator, document["manipulator"])
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{where}: manipulator: {error}") from None


def _lengths(document: Mapping[str, Any], where: Path | str) -> Any:
    lengths = document.get("lengths", "auto")
    names = lengths if isinstance(lengths, list) else [lengths]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"{where}: lengths: expected a text or a list of names, got {lengths!r}")
    return lengths


def _with_friction(
    robot: Manipulator, document: Mapping[str, Any], where: Path | str
) -> Manipulator:
    """Return the robot with the friction and couplings of the file, where it has none of its own.

    Friction terms of single joints and couplings of the robot are for `_difference` to compare.
    """
    terms, pairs = document.get("friction"), document.get("coupled")
    for name, value in (("friction", terms), ("coupled", pairs)):
        if value is not None and not isinstance(value, list):
            raise ValueError(f"{where}: {name}: expected a list")
    if robot.joint_friction is not None:
        return robot
    joint_friction: Any = document.get("joint_friction", [])
    if not isinstance(joint_friction, list):
        raise ValueError(f"{where}: joint_friction: expected a list")
    try:
        if terms is not None and tuple(terms) != robot.friction:
            robot = robot.with_friction(*terms)
        for joint, terms_of_joint in enumerate(joint_friction, 1):
            if tuple(terms_of_joint) != robot.friction:
                robot = robot.with_friction(*terms_of_joint, joint=joint)
        if pairs and not robot.coupled:
            robot = robot.with_coupling(*pairs)
    except (RobotError, TypeError) as error:
        raise ValueError(f"{where}: {error}") from None
    return robot


def _difference(network: CSLC, document: Mapping[str, Any], names: tuple[str, ...]) -> str | None:
    """Return how the file's robot differs from the network's; None if no difference shows."""
    robot = network.robot.name
    if names != network.names:
        return f"has coefficients {_summary(names)}; {robot} has {_summary(network.names)}"
    expressions = document.get("expressions")
    if expressions is None:
        name = document.get("robot", robot)
        if name != robot:  # nothing else tells robots of one structure apart
            return f"is of robot {name!r}, not {robot!r}"
    elif not isinstance(expressions, list) or len(expressions) != len(names):
        return f"expressions: is no list of {len(names)}"
    else:
        for coefficient, expression in zip(network.coefficients, expressions, strict=True):
            if expression != coefficient.expression:
                return (
                    f"{coefficient.name} is {expression}; of {robot} it is {coefficient.expression}"
                )
    coupled = [list(pair) for pair in network.robot.coupled]
    if document.get("coupled", coupled) != coupled:
        return f"has coupled joints {document['coupled']}; {robot} has {coupled}"
    return None


def _summary(names: tuple[str, ...]) -> str:
    return f"{names[0]} to {names[-1]} ({len(names)})" if names else "none"


_RECORDINGS = ("training", "validation")
_FILES = ("index.html", "coefficients.csv", "identification.json")
# Samples whose numbers are Python's objects at a time: those of 600,000 would take 0.4 GB.
_ROWS = 1 << 14


def write_report(
    folder: Path, report: "AbstractReport[Any]", *, pictures: bool
) -> tuple[Path, ...]:
    """Writes a report into a folder: all of its files or, if writing fails, none.

    Files of an earlier report that this one does not have are removed.

    **Returns** the files to look at: without those of drawings. **Raises** as `Report.save`.
    """
    known = [path.name for path in replaced_files(folder)]
    with all_or_nothing(folder, earlier=known) as scratch:
        page = render(report.page(charts=pictures))
        (scratch / "index.html").write_text(page, encoding="utf-8", errors="backslashreplace")
        for section in report.sections:
            for name, rows in section.tables(report).items():
                write_csv(scratch / name, rows)
        identification, *drawings = report.documents(charts=pictures).items()
        write_json(scratch / identification[0], identification[1])
        for name, entries in drawings:  # nobody reads these numbers
            text = json.dumps(entries, separators=(",", ":"), allow_nan=False)
            (scratch / name).write_text(text, encoding="utf-8", errors="backslashreplace")
        for name in report.patterns:
            _write_torque(scratch / _torque_file(name, report.model.output_quantity), report, name)
        written = {path.name for path in scratch.iterdir()}
    ordered = [*known, *sorted(written - {*known})]
    shown = written - {name for name, _ in drawings}
    return tuple(folder / name for name in ordered if name in shown)


def _torque_file(recording: str, quantity: str) -> str:
    return f"{quantity.replace(' ', '_')}_{recording}.csv"


def replaced_files(folder: Path) -> list[Path]:
    """Return the files of a folder that a report written into it may replace or remove."""
    of_recordings = [
        name
        for recording in _RECORDINGS
        for name in (
            f"errors_{recording}.csv",
            *(_torque_file(recording, quantity) for quantity in ("torque", "known sides")),
        )
    ]
    return [folder / name for name in (*_FILES, *of_recordings, "charts.json")]


def _write_torque(path: Path, report: "AbstractReport[Any]", recording: str) -> None:
    """Writes measured and predicted torque of every sample, and what is masked."""
    patterns, labels = report.patterns[recording], report.model.output_labels
    header = [f"{name}_{label}" for name in ("measured", "predicted", "mask") for label in labels]
    numbers = np.concatenate(
        [
            np.asarray(patterns.time)[:, None],
            np.asarray(patterns.torque),
            report.predicted(recording),
        ],
        axis=1,
    )
    # As `numpy.savetxt` writes them, in half of the time; a mask is one character.
    row = "%.10g," * numbers.shape[1] + "%s"
    mask = np.asarray(patterns.mask)
    masks = np.full((len(mask), 2 * mask.shape[1]), ord(","), np.uint8)
    masks[:, ::2] = np.where(mask, ord("1"), ord("0"))
    masks[:, -1] = ord("\n")
    ends = masks.view(f"S{masks.shape[1]}").ravel()
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="\n") as file:
        file.write(csv_line(["time", *header]) + "\n")
        for start in range(0, len(numbers), _ROWS):
            part = slice(start, start + _ROWS)
            pairs = zip(numbers[part].tolist(), ends[part].astype(str).tolist(), strict=True)
            file.writelines(row % (*values, end) for values, end in pairs)


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as CSV, numbers in full precision."""
    with path.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
        names = list(rows[0])
        lines = (names, *([row.get(name, "") for name in names] for row in rows))
        file.writelines(f"{csv_line(line)}\r\n" for line in lines)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """A document as JSON; numbers that JSON cannot represent become null."""
    text = json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8", errors="backslashreplace")
