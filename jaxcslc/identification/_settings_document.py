import dataclasses
from collections.abc import Mapping
from typing import Any

from ..motion import smoothing_document, smoothing_from
from ._settings import Settings


def settings_document(settings: Settings) -> dict[str, Any]:
    """Settings as plain data, to be written and read again.

    **Raises**

    - `ValueError`: for a smoothing of one's own, which has no name in a file.

    >>> import jaxcslc as jc
    >>> settings = jc.Settings(smoothing=jc.Butterworth(20.0), cutoff=15.0)
    >>> settings_from(settings_document(settings)) == settings
    True
    """
    document = {field.name: getattr(settings, field.name) for field in dataclasses.fields(settings)}
    return {**document, "smoothing": smoothing_document(settings.smoothing)}


def settings_from(document: Mapping[str, Any]) -> Settings:
    """Settings from what `settings_document` made, read from JSON or TOML.

    **Raises**

    - `ValueError`: naming the entry that is unknown or wrong.
    """
    known = {field.name for field in dataclasses.fields(Settings)}
    if unknown := sorted(set(document) - known):
        raise ValueError(
            f"settings: unknown entry {unknown[0]!r}; expected some of {', '.join(sorted(known))}"
        )
    entries = dict(document)
    if "smoothing" in entries:
        entries["smoothing"] = smoothing_from(entries["smoothing"])
    if isinstance(entries.get("thresholds"), list):
        entries["thresholds"] = tuple(entries["thresholds"])
    try:
        return Settings(**entries)
    except TypeError as error:
        raise ValueError(f"settings: {error}") from None
