import contextlib
import json
from collections.abc import Generator
from pathlib import Path
from typing import Annotated

import typer

from ..identification import Settings, choose_settings, settings_from
from ..motion import Recording
from ..network import CSLC
from ._identified import Identified


SettingsOption = Annotated[
    Path | None,
    typer.Option(
        help="Settings from an earlier run's identification.json, or written by hand; those of"
        " --known if omitted, or else chosen by cross-validation within the recording."
    ),
]


def settings_for(
    network: CSLC, recording: Recording, path: Path, given: Path | None, known: Identified | None
) -> Settings:
    """Those of a file, or of an earlier identification, or chosen from the recording in `path`."""
    if given is not None:
        return settings_in(given)
    if known is not None and "settings" in known.document:
        return settings_in(known.path)
    with of_file(path):
        return choose_settings(network, recording).settings


@contextlib.contextmanager
def of_file(path: Path) -> Generator[None]:
    """Says which file it was that something cannot be made of."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def settings_in(path: Path) -> Settings:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ValueError(f"{path}: expected settings as a JSON object")
    try:
        return settings_from(document.get("settings", document))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
