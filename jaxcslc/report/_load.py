"""Reading of what reports wrote: a report, whole, or its settings."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ..least_squares import Identification, Settings, settings_from
from ..manipulator import Manipulator
from ._report import AbstractReport, Report
from ._saved_network import saved_network


R = TypeVar("R", bound=AbstractReport[Any])

# SI units. No robot comes near; and squares, in covariances, are far from overflow.
_LARGEST = 1e12


def load_report(path: str | Path, robot: Manipulator | None = None) -> Report:
    """Return the report that `Report.save` wrote, or what `Identification.save` did.

    Its sections, coefficients and their covariance are those of the report that was saved, and so
    are its text and its page. Its `patterns` are empty: of the motion it has some states.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.
    - `robot`: that was identified; the one that the file describes if None. Friction terms and
      couplings are taken from the file, unless `robot` has friction terms of single joints or
      couplings of its own.

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
    ...     saved = jc.load_report(folder)
    >>> bool(np.all(saved.k == report.k)), saved.settings == report.settings
    (True, True)
    >>> str(saved) == str(report), saved.page(charts=False) == report.page(charts=False)
    (True, True)
    """
    report = read_report(path, Report)
    file = identification_file(path)
    network = saved_network(report.document or {}, report.fit, file, robot)
    object.__setattr__(report, "network", network)
    for section in report.sections:
        for name in section.results:
            try:
                section.result(name, report)
            except AttributeError:  # files do not hold it
                continue
            except ValueError as error:
                raise ValueError(f"{file}: {error}") from None
            except (KeyError, TypeError) as error:
                raise ValueError(f"{file}: {name}: {error!r}") from None
    return report


def read_report(path: str | Path, kind: type[R]) -> R:
    """Return a saved report whose network is derived when it is asked for.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.
    - `kind`: of the report.

    **Raises**

    - `ValueError`: there is no such file, or it holds something else.
    """
    file = identification_file(path)
    document = _document(file, "identification")
    fit = _fit(document, file)
    settings = load_settings(file) if "settings" in document else None
    charts = file.parent / "charts.json"
    if file.name == "identification.json" and charts.exists():
        document = {**_document(charts, "report's drawings"), **document}
    return kind(None, settings, fit, {}, document=document)


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
    return fit
