import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..solver import Identification
from ..systematic import SystematicError, standard_uncertainty
from ._saved import identification_file


@dataclasses.dataclass(frozen=True, eq=False)
class SavedResult:
    """What is compared of a report's `identification.json`, without its robot.

    **Attributes**

    - `name`: of the folder or file.
    - `robot`: that was identified, or another system.
    - `fit`: the `Identification`.
    - `uncertainty`: (p,) standard uncertainty of each coefficient in its unit, systematic errors
      included.
    - `document`: everything in the file.

    `compare_reports` reads two.

    >>> import tempfile
    >>> import numpy as np, jaxcslc as jc
    >>> from jaxcslc.identification import SavedResult
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, 0, -9.81))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> t = np.arange(1000)[:, None] * 0.01
    >>> q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    >>> torque = np.asarray(network.torque(np.array([0.5, 0.2, 0.05]), q, qd, qdd))
    >>> report = jc.identify(network, jc.Recording(t[:, 0], q, torque), settings=jc.Settings())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = report.save(folder, pictures=False)
    ...     result = SavedResult.load(folder)
    >>> result.fit.names, result.uncertainty.shape
    (('kB1', 'kv1', 'kd1'), (3,))
    """

    name: str
    robot: str
    fit: Identification
    uncertainty: Float[np.ndarray, " coefficients"]
    document: Mapping[str, Any]

    @classmethod
    def load(cls, path: str | Path) -> "SavedResult":
        """Reads the `identification.json` of a folder, or a file of its kind.

        **Raises**

        - `ValueError`: there is no such file, or it holds something else.
        """
        file = identification_file(path)
        try:
            fit = Identification.load(file)
            document = json.loads(file.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ValueError(f"{file}: no such identification") from None
        except OverflowError as error:
            raise ValueError(f"{file}: {error}") from None
        robot = document.get("robot", document.get("system", ""))
        uncertainty = standard_uncertainty(fit, _systematic(document, fit, file))
        return cls(str(path), str(robot), fit, uncertainty, document)

    def entry(self, name: str, default: Any) -> Any:
        """An entry of the file if it is of the default's type, or else the default."""
        value = self.document.get(name, default)
        return value if isinstance(value, type(default)) else default


def _systematic(
    document: Mapping[str, Any], fit: Identification, file: Path
) -> SystematicError | None:
    parts = document.get("systematic_error")
    if parts is None:
        return None
    try:
        arrays = {str(name): np.asarray(values, float) for name, values in parts.items()}
    except (AttributeError, TypeError, ValueError):
        raise ValueError(f"{file}: systematic_error: expected numbers by cause") from None
    for name, values in arrays.items():
        if values.shape != (len(fit.names),) or not np.all(np.isfinite(values)):
            raise ValueError(
                f"{file}: systematic_error, {name}: expected {len(fit.names)} finite numbers"
            )
    return SystematicError(arrays) if arrays else None
