import dataclasses
from pathlib import Path

from ..._text_table import text_table
from ...motion import Patterns
from ...network import CSLC
from .._payload_fit import PayloadFit
from .._settings import Settings, settings_document
from ._errors import ErrorTable
from ._output import all_or_nothing, write_csv, write_json


@dataclasses.dataclass(frozen=True, eq=False)
class PayloadReport:
    """The result of `identify_payload`: mass, centre of gravity and inertia of a payload.

    `print` shows what `jaxcslc payload` prints; `save` writes what it writes.

    **Attributes**

    - `network`: with the payload's ten coefficients.
    - `settings`: of preparation and fit.
    - `fit`: the `PayloadFit`, with uncertainty and the nearest body that can exist.
    - `patterns`: of the loaded recording.
    - `errors`: torque errors over them, `"with"` and `"without"` the payload's coefficients.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.puma560()).with_payload()
    >>> t, rate = np.arange(500)[:, None] * 0.01, np.arange(1.0, 7.0)
    >>> q, qd, qdd = np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)
    >>> k = np.ones(network.size)
    >>> recording = jc.Recording(t[:, 0], q, np.asarray(network.torque(k, q, qd, qdd)))
    >>> report = jc.identify_payload(network, recording, settings=jc.Settings(), previous=k)
    >>> report.errors.names
    ('with', 'without')
    """

    network: CSLC
    settings: Settings
    fit: PayloadFit
    patterns: Patterns
    errors: ErrorTable

    def save(self, folder: str | Path) -> tuple[Path, Path]:
        """Writes `payload.csv` and `payload.json` into a folder: both or, if writing fails, none.

        **Returns** the files.

        **Raises**

        - `ValueError`: `folder` is a file.
        - `OSError`: the folder cannot be written.
        """
        folder = Path(folder)
        with all_or_nothing(folder) as scratch:
            write_csv(scratch / "payload.csv", self.fit.rows())
            write_json(
                scratch / "payload.json",
                {
                    "robot": self.network.robot.name,
                    "settings": settings_document(self.settings),
                    **self.fit.document(),
                    "torque_error_rms": dict(zip(self.errors.names, self.errors.rms, strict=True)),
                },
            )
        return folder / "payload.csv", folder / "payload.json"

    def __str__(self) -> str:
        rows = self.fit.rows()
        names = ["value", "low", "high", "possible"]
        table = text_table(
            ["", "unit", *names],
            [[row["name"], row["unit"], *(f"{row[name]:.4g}" for name in names)] for row in rows],
            left=("unit",),
        )
        lines = [
            f"{self.network}\nsettings: {self.settings}\n\n{table}\n",
            "frame of the last link; I.. at the centre of gravity; low and high: 95 % intervals"
            f" for {self.fit.fit.errors} errors; possible: the nearest body that can exist",
            *(f"not determined: {sentence}" for sentence in self.fit.unidentifiable),
        ]
        loaded, unloaded = (", ".join(f"{x:.3g}" for x in row.tolist()) for row in self.errors.rms)
        lines.append(f"torque error over the loaded recording, joint by joint: {loaded}")
        lines.append(f"  without the payload's part: {unloaded}")
        return "\n".join(lines)
