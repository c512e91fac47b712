"""`help()` of every public name: an example that runs, what comes back, what goes wrong."""

import dataclasses
import inspect
from typing import Any

import equinox as eqx
import pytest

import jaxcslc


# The packages that users are sent to are checked through the names that they export.
PUBLIC = {
    name: value
    for name, value in ((name, getattr(jaxcslc, name)) for name in dir(jaxcslc))
    if not name.startswith("_") and (inspect.isclass(value) or inspect.isfunction(value))
}
FUNCTIONS = {name: value for name, value in PUBLIC.items() if inspect.isfunction(value)}

DATA: dict[str, Any] = {name: v for name, v in PUBLIC.items() if dataclasses.is_dataclass(v)}


def has_section(text: str, *names: str) -> bool:
    return any(f"**{name}" in text for name in names)


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_says_what_it_is(name: str) -> None:
    text = inspect.getdoc(PUBLIC[name]) or ""
    assert len(text) > 40


def needs_example(value: Any) -> bool:
    """Not exceptions, nor enumerations of messages: nobody makes one."""
    exceptional = inspect.isclass(value) and issubclass(value, (Exception, eqx.Enumeration))
    return not exceptional


@pytest.mark.parametrize("name", sorted(n for n, v in PUBLIC.items() if needs_example(v)))
def test_has_an_example_that_runs(name: str) -> None:
    """Its own or, of a class, of a method; `--doctest-modules` runs them."""
    value = PUBLIC[name]
    texts = [inspect.getdoc(value) or ""]
    if inspect.isclass(value):
        texts += [inspect.getdoc(member) or "" for _, member in inspect.getmembers(value)]
    assert any(">>>" in text for text in texts)


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_functions_say_what_comes_back(name: str) -> None:
    """Arguments, if there are any; and what is returned, or raised, or where else it is said."""
    function = FUNCTIONS[name]
    text = inspect.getdoc(function) or ""
    if inspect.signature(function).parameters:
        assert has_section(text, "Arguments")
        assert has_section(text, "Returns", "Raises")


@pytest.mark.parametrize("name", sorted(DATA))
def test_attributes_are_named(name: str) -> None:
    """Every field stands in the class's docstring, or is documented beside it."""
    value = DATA[name]
    text = (inspect.getdoc(value) or "") + inspect.getsource(value)
    for field in dataclasses.fields(value):
        if not field.name.startswith("_"):
            assert f"`{field.name}`" in text or f"{field.name}: " in text
