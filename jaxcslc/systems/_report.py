"""Reports on systems: of an identification, and of what separation makes of equations."""

from pathlib import Path
from typing import ClassVar

from ..report import (
    AbstractReport,
    AbstractSection,
    all_or_nothing,
    coefficient_rows,
    read_report,
    write_csv,
    write_json,
)
from ._network import SystemNetwork
from ._sections import SYSTEM_SECTIONS, separation_document
from ._system import System


class SystemReport(AbstractReport[SystemNetwork]):
    """The result of `identify_system`: coefficients, their uncertainty, and equation errors.

    `print` shows what `jaxcslc identify` prints of a system; `save` writes what it writes.

    **Attributes**

    - `network`: of the system; with the values that were found for searched constants, if it has
      any.
    - `settings`: of preparation and fit.
    - `fit`: the `Identification`, with standard errors and covariance.
    - `patterns`: by recording, `"training"` and, if there was one, `"validation"`; empty of a
      report that was loaded.
    - `results`: by name, what sections are made of: `errors` to `simulation` below.
    - `document`: what the files hold of a report that was loaded; None of others.
    - `errors`: of the equations, by recording: root mean squares of known side less output.
    - `excitation`: of the training recording.
    - `held_out`: errors of the validation recording beside those of the training recording; without
      a validation recording by cross-validation.
    - `warnings`: one sentence each.
    - `search`: of the constants that enter nonlinearly; None without any.
    - `correction`: of the bias of noise and smoothing, already in `fit`; None without noise.
    - `constants`: that follow from the coefficients, see `constants_from`.
    - `simulation`: of the identified system from the first sample of the validation recording, or
      why it cannot be simulated; None without a validation recording.

    >>> import numpy as np, sympy
    >>> from jaxcslc.systems import Constant, System, SystemRecording, Variable, identify_system
    >>> current, voltage, resistance = sympy.symbols("current voltage resistance")
    >>> wire = System(
    ...     "wire", {"Ohm": sympy.Eq(voltage, resistance * current)},
    ...     (Variable(current, "A"), Variable(voltage, "V")), (Constant(resistance, "Ω"),),
    ... )
    >>> time = np.arange(400) * 0.1
    >>> columns = {"current": np.sin(time), "voltage": 2.5 * np.sin(time)}
    >>> report = identify_system(wire, SystemRecording(time, columns))
    >>> [(row["name"], round(row["value"], 6), row["unit"]) for row in report.rows()]
    [('resistance', 2.5, 'Ω')]
    """

    kinds: ClassVar[tuple[type[AbstractSection], ...]] = SYSTEM_SECTIONS

    def network_along(self, recording: str) -> SystemNetwork:
        """Return the network that predicts known sides along a recording: that of all motion."""
        del recording
        return self.network

    def derived_network(self) -> SystemNetwork:
        """**Raises** `AttributeError`: files do not hold the equations as they were written."""
        raise AttributeError("network: the files of a report on a system do not hold it")


def load_system_report(path: str | Path) -> SystemReport:
    """Return the report on a system that `SystemReport.save` wrote.

    Its sections, coefficients and their covariance are those of the report that was saved. Files
    hold neither its network nor its patterns.

    **Arguments**

    - `path`: of the report's folder, or of its `identification.json`.

    **Raises**

    - `ValueError`: there is no such file, or it holds something else.

    >>> import tempfile, numpy as np, sympy
    >>> from jaxcslc.systems import (
    ...     Constant, System, SystemRecording, Variable, identify_system, load_system_report
    ... )
    >>> current, voltage, resistance = sympy.symbols("current voltage resistance")
    >>> wire = System(
    ...     "wire", {"Ohm": sympy.Eq(voltage, resistance * current)},
    ...     (Variable(current, "A"), Variable(voltage, "V")), (Constant(resistance, "Ω"),),
    ... )
    >>> time = np.arange(400) * 0.1
    >>> columns = {"current": np.sin(time), "voltage": 2.5 * np.sin(time)}
    >>> report = identify_system(wire, SystemRecording(time, columns))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     str(load_system_report(folder)) == str(report)
    True
    """
    return read_report(path, SystemReport)


def save_derivation(system: System, folder: str | Path) -> tuple[Path, ...]:
    """Writes what separation made of a system: `coefficients.csv`, `constants.csv`, `system.json`.

    **Arguments**

    - `system`: that is separated.
    - `folder`: is made if it is missing.

    **Returns** the files.

    **Raises**

    - `DescriptionError`: as `System.separation`.
    - `ValueError`: `folder` is a file.
    - `OSError`: the folder cannot be written.
    """
    folder, network = Path(folder), system.network
    names = ("coefficients.csv", "constants.csv", "system.json")
    with all_or_nothing(folder) as scratch:
        write_csv(scratch / names[0], coefficient_rows(network))
        constants = [
            {
                "constant": row.constant,
                "verdict": row.verdict,
                "coefficients": " ".join(row.coefficients),
            }
            for row in system.separation.identifiability
        ]
        write_csv(scratch / names[1], constants)
        write_json(scratch / names[2], separation_document(network))
    return tuple(folder / name for name in names)
