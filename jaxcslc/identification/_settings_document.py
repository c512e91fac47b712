import dataclasses
from collections.abc import Mapping
from typing import Any

from ..motion import AbstractSmoothing, AveragedSplines, Butterworth, SavitzkyGolay
from ._settings import Settings


_SMOOTHINGS: dict[str, type[AbstractSmoothing]] = {
    "averaged_splines": AveragedSplines,
    "butterworth": Butterworth,
    "savitzky_golay": SavitzkyGolay,
}


def settings_document(settings: Settings) -> dict[str, Any]:
    """Settings as plain data, to be written and read again.

    **Raises**

    - `ValueError`: for a smoothing of one's own, which has no name in a file.

    >>> import jaxcslc as jc
    >>> settings = jc.Settings(smoothing=jc.Butterworth(20.0), cutoff=15.0)
    >>> settings_from(settings_document(settings)) == settings
    True
    """
    names = {kind: name for name, kind in _SMOOTHINGS.items()}
    if type(settings.smoothing) not in names:
        raise ValueError(f"{settings.smoothing!r} cannot be written; it has no name in a file")
    document = {field.name: getattr(settings, field.name) for field in dataclasses.fields(settings)}
    document["smoothing"] = {
        "method": names[type(settings.smoothing)],
        **{
            field.name: getattr(settings.smoothing, field.name)
            for field in dataclasses.fields(settings.smoothing)
        },
    }
    return document


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
        entries["smoothing"] = _smoothing(entries["smoothing"])
    if isinstance(entries.get("thresholds"), list):
        entries["thresholds"] = tuple(entries["thresholds"])
    try:
        return Settings(**entries)
    except TypeError as error:
        raise ValueError(f"settings: {error}") from None


def _smoothing(document: Any) -> AbstractSmoothing:
    if not isinstance(document, Mapping) or document.get("method") not in _SMOOTHINGS:
        raise ValueError(
            f"settings, smoothing: expected a method out of {', '.join(_SMOOTHINGS)},"
            f" got {document!r}"
        )
    entries: dict[str, Any] = {
        str(name): tuple(value) if isinstance(value, list) else value
        for name, value in document.items()
        if name != "method"
    }
    try:
        return _SMOOTHINGS[document["method"]](**entries)
    except TypeError as error:
        raise ValueError(f"settings, smoothing: {error}") from None
