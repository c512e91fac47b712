import dataclasses
import zipfile
from pathlib import Path

import numpy as np

from jaxcslc._scratch import unfinished
from jaxcslc.recordings import Recording
from sim.engine._truth import SimulatedRecording, Truth


def save(folder: Path, name: str, result: SimulatedRecording) -> None:
    """Saves a recording and its truth as `folder/name.npz`; atomic if interrupted.

    **Arguments**

    - `folder`: made if missing.
    - `name`: of the file, without its ending.
    - `result`: recording and truth.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth = {
        field.name: getattr(result.truth, field.name)
        for field in dataclasses.fields(result.truth)
        if field.name != "time"
    }
    with unfinished(folder / f"{name}.npz", clean=False) as path:
        try:
            np.savez(
                path,
                time=result.recording.time,
                reading=result.recording.position,
                demand=result.recording.torque,
                **truth,
            )
        except ValueError as error:
            # Interrupted within an array, the archive complains of it as it is closed.
            if isinstance(error.__context__, KeyboardInterrupt):
                raise error.__context__ from None
            raise


def load(folder: Path, name: str) -> SimulatedRecording | None:
    """The recording that `save` saved under a name, or None.

    **Raises**

    - `ValueError`: a file that `save` did not write.
    """
    path = folder / f"{name}.npz"
    if not path.exists():
        return None
    try:
        with np.load(path) as file:
            values = {key: file[key] for key in file.files}
        time = values.pop("time")
        recording = Recording(time, values.pop("reading"), values.pop("demand"))
        return SimulatedRecording(recording, Truth(time=time, **values))
    except (KeyError, TypeError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(
            f"{path}: expected a simulated recording; delete it to continue"
        ) from error
