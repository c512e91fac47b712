"""Records as plain data: what JSON holds of them is read back as it was."""

import json
from collections.abc import Callable

import pytest

import jaxcslc as jc
from jaxcslc._plain_data import record_document, record_from


@pytest.mark.parametrize("robot", [jc.puma560, jc.panda, jc.tx40], ids=lambda x: x.__name__)
def test_robots_are_read_back(robot: Callable[[], jc.Manipulator]) -> None:
    """Numberings, couplings, files' frames and infinite limits included."""
    first = robot()
    document = record_document(first)
    again = record_from(jc.Manipulator, json.loads(json.dumps(document, allow_nan=False)))
    assert again == first and record_document(again) == document


@pytest.mark.parametrize(
    ("entry", "value"),
    [("name", 1), ("joints", [{"kind": "S"}]), ("gravity", [0, 1]), ("links", "none")],
)
def test_other_kinds_are_errors(entry: str, value: object) -> None:
    document = {**record_document(jc.puma560()), entry: value}
    with pytest.raises((TypeError, ValueError)):
        record_from(jc.Manipulator, document)
