import contextlib
import functools
import glob
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from .._environment import require
from ..identification import (
    Settings,
    choose_settings,
    fit_fleet_on_cluster,
    fit_on_cluster,
)
from ..identification.report import load_settings
from ..network import CSLC
from ._common import CommandContext, is_system, network_of, robot_named, typed_options
from ._recording_options import RecordingOptions


# What `identify` does on a cluster besides fitting is to read, prepare and settings.
_OPTIONS = {
    *("robot", "train", "output", "lengths", "base", "tip", "fix", "mimic", "friction"),
    *(
        "coupled",
        "settings",
        "columns",
        "between",
        "every",
        "period",
        "drop_stale",
        "despike",
        "measured",
    ),
    *("dask", "fleet"),
}
# Fits of a fleet that are printed; all are in the file.
_PRINTED = 20


def identified_on_cluster(context: CommandContext, step: Callable[[str], None]) -> str:
    """Identifies from many recordings on a cluster and writes the result.

    **Returns** what is printed of it.
    """
    options = context.params
    _check_options(context)
    tip, fix, coupled = (_listed(options[name]) for name in ("tip", "fix", "coupled"))
    arm = robot_named(options["robot"], options["base"], tip, fix, options["mimic"])
    network = network_of(arm, options["lengths"], options["friction"], coupled)
    paths = _expanded(options["train"])
    read = functools.partial(RecordingOptions.of(options).read, robot=network.robot)
    settings = _settings(network, options["settings"], paths[0], read, step)
    output: Path = options["output"]
    with _connected(options["dask"]) as client:
        arguments: dict[str, Any] = {"client": client, "read": read, "progress": step}
        if options["fleet"]:
            fleet = fit_fleet_on_cluster(network, paths, settings, **arguments)
            output.mkdir(parents=True, exist_ok=True)
            fleet.save(output / "fleet.csv")
            return _fleet_text(fleet.rows(), output / "fleet.csv")
        fit = fit_on_cluster(network, paths, settings, **arguments)
    output.mkdir(parents=True, exist_ok=True)
    fit.save(output / "fit.json")
    return f"{fit}\n\n{settings}\n{len(paths)} recordings\n\nwrote {output / 'fit.json'}"


def _listed(values: Sequence[str] | None) -> list[str] | None:
    """Values of an option that may be repeated, as commands are called with them."""
    return list(values) if values else None


def _check_options(context: CommandContext) -> None:
    if context.params["dask"] is None:
        raise ValueError("--fleet: only with --dask")
    if is_system(context.params["robot"]):
        raise ValueError("--dask: expected a robot; other systems are identified in one process")
    if others := sorted(typed_options(context) - _OPTIONS):
        raise ValueError(f"--{others[0].replace('_', '-')}: not with --dask")


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
    """Those of a file, or those that cross-validation selects on the first recording."""
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
