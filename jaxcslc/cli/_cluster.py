"""`jaxcslc identify --dask`: many recordings on the workers of a cluster."""

import contextlib
import functools
import glob
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from .._environment import require
from ..least_squares import Settings, fit_fleet_on_cluster, fit_on_cluster
from ..network import CSLC
from ..report import load_settings
from ..selection import choose_settings
from ._identify_options import IdentifyOptions
from ._recording_options import RecordingOptions


# Fits of a fleet that are printed; all are in the file.
_PRINTED = 20


def identified_on_cluster(
    network: CSLC,
    options: IdentifyOptions,
    recordings: RecordingOptions,
    step: Callable[[str], None],
) -> str:
    """Identify from many recordings on a cluster, and write the result.

    **Returns** what is printed of it.
    """
    assert options.dask is not None
    paths = _expanded(options.train)
    read = functools.partial(recordings.read, robot=network.robot, measured=options.measured)
    settings = _settings(network, options.settings, paths[0], read, step)
    output = options.output
    with _connected(options.dask) as client:
        arguments: dict[str, Any] = {"client": client, "read": read, "progress": step}
        if options.fleet:
            fleet = fit_fleet_on_cluster(network, paths, settings, **arguments)
            output.mkdir(parents=True, exist_ok=True)
            fleet.save(output / "fleet.csv")
            return _fleet_text(fleet.rows(), output / "fleet.csv")
        fit = fit_on_cluster(network, paths, settings, **arguments)
    output.mkdir(parents=True, exist_ok=True)
    fit.save(output / "fit.json")
    return f"{fit}\n\n{settings}\n{len(paths)} recordings\n\nwrote {output / 'fit.json'}"


def _expanded(paths: Sequence[Path]) -> list[Path]:
    """Paths with patterns replaced by the files that match them, in the order of their names."""
    expanded: list[Path] = []
    for path in paths:
        matching = [Path(name) for name in sorted(glob.glob(str(path)))]
        if not matching:
            raise ValueError(f"{path}: no such file; expected recordings")
        expanded += matching
    return expanded


def _settings(
    network: CSLC,
    path: Path | None,
    first: Path,
    read: Callable[[Path], Any],
    step: Callable[[str], None],
) -> Settings:
    """Load the settings of a file, or choose them by cross-validation on the first recording."""
    if path is not None:
        return load_settings(path)
    step("choosing settings on the first recording")
    return choose_settings(network, read(first)).settings


@contextlib.contextmanager
def _connected(address: str) -> Generator[Any]:
    """A client of the cluster at an address; none for a local one."""
    if address == "local":
        yield None
        return
    distributed = require("distributed", "cluster")
    with distributed.Client(address) as client:
        yield client


def _fleet_text(rows: list[dict[str, Any]], path: Path) -> str:
    lines = [
        f"{row['file']}  {row['result']}, rank {row['rank']}, condition {row['condition']:.3g}"
        for row in rows[:_PRINTED]
    ]
    if len(rows) > _PRINTED:
        lines.append(f"and {len(rows) - _PRINTED} others")
    return "\n".join([*lines, "", f"wrote {path}"])
