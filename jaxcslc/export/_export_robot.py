"""Entry points: a robot's file with identified parameters, and files of C code."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._scratch import unfinished
from .._text_table import text_table
from ..bodies import (
    PhysicalParameters,
    fixed_bodies,
    moved_bodies,
    other_masses,
    physical_parameters,
)
from ..least_squares import Identification
from ..network import CSLC
from ..recordings import Patterns
from ..uncertainty import SystematicError
from ._c_code import CCode
from ._write_back import WrittenRobot, random_states, write_robot


@dataclass(frozen=True, eq=False)
class RobotExport:
    """A robot file with identified parameters, and their distance from the fit.

    `print` shows what `jaxcslc export` prints.

    **Attributes**

    - `network`: of the identified robot.
    - `parameters`: the possible link parameters nearest to the identified coefficients.
    - `written`: the file, and the torques that it predicts when it is read again.
    - `measured`: whether torques were compared over recorded motion, not over random states.
    - `warnings`: about bodies that are far from the fit, a sentence each.
    """

    network: CSLC
    parameters: PhysicalParameters
    written: WrittenRobot
    measured: bool
    warnings: tuple[str, ...] = ()

    def __str__(self) -> str:
        written, parameters = self.written, self.parameters
        units = self.network.output_units
        names = self.network.output_names
        rows = [
            [names[j], f"{parameters.torque_distance[j]:.3g}", f"{written.rms[j]:.1e}", units[j]]
            for j in range(len(units))
        ]
        table = parameters.to_pandas()
        table.columns = [f"{name} [{_unit(name)}]" for name in table.columns]
        states = "the recording's motion" if self.measured else "random states"
        header = ["joint", "cost of being possible", "file against parameters", "unit"]
        lines = [
            f"{self.network}\n",
            f"{table.to_string(float_format=lambda x: f'{x:.5g}')}\n",
            "in the frames of the robot's file; rx, ry, rz: centre of gravity; I..: about it\n",
            f"possible parameters are {parameters.distance:.3g} standard errors from the identified"
            " coefficients (root mean square)",
            f"\nRMS difference of torque over {states}",
            text_table(header, rows),
        ]
        lines += [f"warning: {warning}" for warning in self.warnings]
        if written.motors is not None:
            lines.append(
                f"URDF has no element for motor inertia: it is in {written.motors}, and the bodies"
                " are those beside it (--no-motors puts it into the bodies)"
            )
        if written.left_out:
            lines.append(f"the file has no entry for {', '.join(written.left_out)}: left out")
        lines.append(
            f"\nwrote {written.path}; read again, it predicts the same torques to"
            f" {np.max(written.largest):.1e} {' or '.join(dict.fromkeys(units))}"
        )
        return "\n".join(lines)


def _unit(column: str) -> str:
    """Return the unit of a column of `PhysicalParameters.to_pandas`."""
    return {"m": "kg", "r": "m"}.get(column[0], "kg m²") if column != "motor_inertia" else "kg m²"


def export_robot(
    network: CSLC,
    fit: Identification,
    path: str | Path,
    *,
    motion: Patterns | None = None,
    motors: bool = True,
    systematic: SystematicError | None = None,
    progress: Callable[[str], None] | None = None,
) -> RobotExport:
    """Writes the possible parameters nearest to an identification into a copy of the robot's file.

    Bodies that the robot's file fixes to a link keep their numbers. Motor inertias go to TOML's
    `motor_inertia`, MJCF's `armature` or, for URDF, a file beside it (`motor_file`).

    **Arguments**

    - `network`: derived from a robot that was read from a file.
    - `fit`: of this network.
    - `path`: of the file to write, of the same kind as the robot's.
    - `motion`: states at which torques are compared; random ones if omitted.
    - `motors`: whether joints have motor inertia where the network has it. False fixes it at zero:
      for a simulator that has none, at the cost of bodies that make up for it.
    - `systematic`: of the fit: added to the standard errors that movements are counted in.
    - `progress`: is called with a short text at the start of every step.

    **Returns**

    - The parameters, the written file, and how well it reproduces their torque.

    **Raises**

    - The errors of `physical_parameters` and `write_robot`.

    >>> import tempfile
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.export import export_robot
    >>> with tempfile.TemporaryDirectory() as name:
    ...     folder = Path(name)
    ...     _ = (folder / "arm.toml").write_text("gravity = [0, -9.81, 0]\\n[[joint]]  # hinge\\n")
    ...     network = jc.derive(jc.load_robot(folder / "arm.toml"), lengths="numeric")
    ...     t = np.linspace(0, 5, 500)[:, None]
    ...     motion, pairs = (np.sin(t), np.cos(t), -np.sin(t)), np.ones(t.shape, bool)
    ...     torque = np.asarray(network.torque(np.array([0.5, 0.3, -0.1, 0.2, 0.05]), *motion))
    ...     torque = torque + 0.01 * np.random.default_rng(0).normal(size=t.shape)
    ...     patterns = jc.Patterns(t[:, 0], *motion, torque, pairs, pairs)
    ...     fit = jc.Settings().fit(network, patterns)
    ...     export = export_robot(network, fit, folder / "identified.toml", motion=patterns)
    >>> bool(export.written.largest.max() < 1e-9)
    True
    """
    report = progress or (lambda _: None)
    fixed = fixed_bodies(network.robot)
    states = _state_patterns(network.joint_count) if motion is None else motion
    report("fitting possible bodies")
    parameters = physical_parameters(network, fit, fixed=fixed, patterns=states, motors=motors)
    report("writing and reading again")
    written = write_robot(network, parameters, path, states=(states.q, states.qd, states.qdd))
    warnings = moved_bodies(network, fit, parameters, systematic, motors=motors)
    warnings += other_masses(network, parameters)
    return RobotExport(network, parameters, written, motion is not None, warnings)


def write_c(code: CCode, path: str | Path | None = None) -> tuple[Path, Path]:
    """Writes C code as a source file and the header that it includes.

    **Arguments**

    - `code`: from `c_code`.
    - `path`: of the source file; by default the code's name in the current folder.

    **Returns**

    - Paths of source and header.

    **Raises**

    - `ValueError`: a name that does not end in .c.
    - `OSError`: the files cannot be written.
    """
    source = Path(f"{code.name}.c" if path is None else path)
    if source.suffix != ".c":
        raise ValueError(f"{source}: expected a name ending in .c")
    header = source.with_suffix(".h")
    # The source includes its header by name.
    text = code.source.replace(f'#include "{code.name}.h"', f'#include "{header.name}"')
    source.parent.mkdir(parents=True, exist_ok=True)
    with unfinished(header) as header_file, unfinished(source) as source_file:
        header_file.write_text(code.header, encoding="ascii")
        source_file.write_text(text, encoding="ascii")
    return source, header


def _state_patterns(joints: int) -> Patterns:
    """Random states as patterns without torques."""
    q, qd, qdd = random_states(joints)
    mask = np.ones(q.shape, bool)
    return Patterns(np.arange(float(len(q))), q, qd, qdd, 0 * q, mask, mask)
