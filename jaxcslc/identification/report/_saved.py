import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...manipulator import Manipulator, RobotError
from ...motion import Patterns
from ...network import CSLC, derive
from .._settings import Settings, settings_from
from ..friction import PreSlidingFit, pre_sliding_from
from ..solver import Identification
from ..systematic import SystematicError


# SI units. No robot comes near; and squares, in covariances, are far from overflow.
_LARGEST = 1e12


@dataclass(frozen=True, eq=False)
class SavedReport:
    """What is read back from a report's `identification.json`.

    **Attributes**

    - `network`: that was identified, with its friction terms and slopes of static friction.
    - `fit`: the `Identification`.
    - `settings`: of the fit; None if the file has none.
    - `motion`: some of the training recording's states, as patterns without torques; None if the
      file has none.
    - `systematic`: error of the fit that no residual shows; None if the file has none.
    - `pre_sliding`: dry friction that yields before it slides; None if the file has none.

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.linspace(0, 5, 500)[:, None]
    >>> motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), *motion))
    >>> fit = jc.LeastSquares().fit(network, jc.Patterns(t[:, 0], *motion, torque, pairs, pairs))
    >>> jc.SavedReport(network, fit, settings=None, motion=None).fit.names == network.names
    True
    """

    network: CSLC
    fit: Identification
    settings: Settings | None
    motion: Patterns | None
    systematic: SystematicError | None = None
    pre_sliding: PreSlidingFit | None = None


def load_report(path: str | Path, robot: Manipulator) -> SavedReport:
    """Reads the `identification.json` that `Report.save` wrote, or what `Identification.save` did.

    **Arguments**

    - `path`: of the file, or of the report's folder.
    - `robot`: that was identified. Friction terms and couplings are taken from the file, unless the
      robot has friction terms of single joints or couplings of its own.

    **Returns** a `SavedReport`.

    **Raises**

    - `ValueError`: the file is no identification of this robot; the message names file and entry.

    >>> import tempfile
    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), q, qd, qdd))
    >>> recording = jc.Recording(t[:, 0], q, torque)
    >>> report = jc.identify(network, recording, settings=jc.Settings())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     saved = jc.load_report(folder, pendulum)
    >>> bool(np.all(saved.fit.k == report.k)), saved.settings == report.settings
    (True, True)
    """
    path = identification_file(path)
    document = _document(path, "identification")
    network = derive(_with_friction(robot, document, path), lengths=_lengths(document, path))
    network = _with_slopes(network, document, path)
    fit = _fit(path)
    if difference := _difference(network, document, fit.names):
        raise ValueError(f"{path}: {difference}; expected an identification of this robot")
    if network.load_terms:  # it follows the torque of the identified bodies
        network = network.with_load(np.asarray(fit.k))
    return SavedReport(
        network,
        fit,
        _settings(document, path),
        _motion(document, network, path),
        _systematic(document, network, path),
        None
        if document.get("pre_sliding") is None
        else pre_sliding_from(document["pre_sliding"], network, f"{path}: pre_sliding"),
    )


def load_settings(path: str | Path) -> Settings:
    """Reads settings from a report's `identification.json`, or from a JSON file of their own.

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
        raise ValueError(f"{path}: {error}") from None


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
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected a JSON object ({kind})")
    return document


def _settings(document: dict[str, Any], path: Path) -> Settings | None:
    return load_settings(path) if "settings" in document else None


def _lengths(document: dict[str, Any], path: Path) -> Any:
    lengths = document.get("lengths", "auto")
    names = lengths if isinstance(lengths, list) else [lengths]
    if not all(isinstance(name, str) for name in names):
        raise ValueError(f"{path}: lengths: expected a text or a list of names, got {lengths!r}")
    return lengths


def _with_friction(robot: Manipulator, document: dict[str, Any], path: Path) -> Manipulator:
    """With the friction and couplings of the identification, where the robot has none of its own.

    Friction terms of single joints and couplings of the robot are for `_difference` to compare.
    """
    terms, pairs = document.get("friction"), document.get("coupled")
    for name, value in (("friction", terms), ("coupled", pairs)):
        if value is not None and not isinstance(value, list):
            raise ValueError(f"{path}: {name}: expected a list")
    if robot.joint_friction is not None:
        return robot
    joint_friction: Any = document.get("joint_friction", [])
    if not isinstance(joint_friction, list):
        raise ValueError(f"{path}: joint_friction: expected a list")
    try:
        if terms is not None and tuple(terms) != robot.friction:
            robot = robot.with_friction(*terms)
        for joint, terms_of_joint in enumerate(joint_friction, 1):
            if tuple(terms_of_joint) != robot.friction:
                robot = robot.with_friction(*terms_of_joint, joint=joint)
        if pairs and not robot.coupled:
            robot = robot.with_coupling(*pairs)
    except (RobotError, TypeError) as error:
        raise ValueError(f"{path}: {error}") from None
    return robot


def _with_slopes(network: CSLC, document: dict[str, Any], path: Path) -> CSLC:
    """With the slopes of static friction that were fitted."""
    if network.static_slopes is None or "static_slopes" not in document:
        return network
    try:
        return network.with_static_slopes(np.asarray(document["static_slopes"], float))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: static_slopes: {error}") from None


def _difference(network: CSLC, document: dict[str, Any], names: tuple[str, ...]) -> str | None:
    """How the file's robot differs from the network's; None if no difference shows."""
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


def _fit(path: Path) -> Identification:
    """**Raises** `ValueError` for numbers that no robot has, and that would overflow."""
    try:
        fit = Identification.load(path)
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
    return fit


def _motion(document: dict[str, Any], network: CSLC, path: Path) -> Patterns | None:
    motion = document.get("motion")
    if motion is None:
        return None
    try:
        q, qd, qdd = (np.asarray(motion[name], float) for name in ("q", "qd", "qdd"))
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: motion: expected arrays q, qd and qdd") from None
    joints = network.joint_count
    finite = q.shape == qd.shape == qdd.shape and np.all(np.abs([q, qd, qdd]) <= _LARGEST)
    if not finite or q.shape != (len(q), joints):
        raise ValueError(f"{path}: motion: expected finite q, qd and qdd of {joints} joints each")
    mask = np.ones(q.shape, bool)
    return Patterns(np.arange(len(q), dtype=float), q, qd, qdd, 0 * q, mask, mask)


def _systematic(document: dict[str, Any], network: CSLC, path: Path) -> SystematicError | None:
    parts = document.get("systematic_error")
    if parts is None:
        return None
    try:
        arrays = {str(name): np.array(values, float) for name, values in parts.items()}
    except (AttributeError, TypeError, ValueError):
        raise ValueError(f"{path}: systematic_error: expected numbers by cause") from None
    for name, values in arrays.items():
        values[np.isnan(values)] = np.inf  # JSON has no number for it
        if values.shape != (network.size,) or np.any(values < 0):
            raise ValueError(
                f"{path}: systematic_error, {name}: expected {network.size} numbers from 0 up"
            )
    return SystematicError(arrays)


def _summary(names: tuple[str, ...]) -> str:
    return f"{names[0]} to {names[-1]} ({len(names)})" if names else "none"
