"""One kind of result of a report.

A section gives its lines of text, its entries of the JSON files and its blocks of the page, and
reads its entries back. A report is a list of sections (`_report.py`); `sections/` has one file for
each kind, `sections/__init__.py` the list of all.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from .._plain_data import plain
from .._text_table import counted as counted
from ._page import Message, Section


if TYPE_CHECKING:
    from ._report import AbstractReport

    AnyReport = AbstractReport[Any]
else:
    AnyReport = Any


IDENTIFICATION = "identification.json"


class AbstractSection:
    """Kind of result: its text, its JSON and its blocks of the page.

    All of them are made of `data`, plain data, so that a section that was read from a file shows
    what the one that was written showed. A new kind is a subclass and its line in a list of
    sections. Methods that have nothing to say are inherited.

    **Attributes**

    - `name`: of the section, and of the result in a report that it is made of.
    - `results`: names of all results that it is made of, and what a report has without them.
    - `entries`: of its file that are the section's, and the type of each.
    - `file`: that holds them.
    - `always`: whether reports have the section without such a result, or without entries.
    - `position`: of its blocks on the page, where sections are sorted by it: below 20 errors,
      below 30 the model, below 40 the data, from there on the method.
    """

    name: ClassVar[str]
    results: ClassVar[Mapping[str, Any]] = MappingProxyType({})
    entries: ClassVar[Mapping[str, type]] = MappingProxyType({})
    file: ClassVar[str] = IDENTIFICATION
    always: ClassVar[bool] = False
    position: ClassVar[int] = 25

    def __init__(self, source: Callable[[], Mapping[str, Any]]) -> None:
        self._source = source

    @cached_property
    def data(self) -> dict[str, Any]:
        """The section's entries of its file, as JSON holds them; computed when they are needed."""
        return plain(self._source())

    @classmethod
    def of(cls, report: AnyReport) -> "AbstractSection | None":
        """Return the section of a report; None if it is made of a result that the report lacks."""
        result = report.results.get(cls.name)
        if result is None and cls.results and not cls.always:
            return None
        return cls(lambda: cls.document_of(result, report))

    @classmethod
    def document_of(cls, result: Any, report: AnyReport) -> Mapping[str, Any]:
        """Return the entries of a result; of None, what the report itself says.

        By default the one entry is the result's `document()`.
        """
        del report
        return {next(iter(cls.entries)): result.document()}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> "AbstractSection | None":
        """Return the section that a report's files hold; None if they hold none."""
        entries = {
            name: value
            for name, value in document.items()
            if name in cls.entries and isinstance(value, cls.entries[name])
        }
        return cls(lambda: entries) if entries or cls.always else None

    def result(self, name: str, report: AnyReport) -> Any:
        """Return the result that the section was made of, from `data`.

        **Raises**

        - `AttributeError`: files do not hold all of it.
        - `ValueError`: `data` hold something else.
        """
        raise AttributeError(
            f"{name}: a loaded report does not have it; report.section({self.name!r}).data has what"
            " its files hold"
        )

    def text(self, report: AnyReport) -> Iterator[Sequence[str]]:
        """Yield paragraphs of lines, for `print`: by default the entry `NAME_text`."""
        del report
        if f"{self.name}_text" in self.entries:
            yield self.data.get(f"{self.name}_text", ())

    def notes(self) -> Sequence[str]:
        """Return what stands among the report's notes, a sentence each."""
        return ()

    def messages(self, report: AnyReport) -> Iterator[Message]:
        """Yield what the section says about whether the model can be used."""
        del report
        yield from ()

    def blocks(self, report: AnyReport, charts: bool) -> Iterator[Section]:
        """Yield parts of the page; those of one heading become one.

        - `charts`: whether the page has drawings; sections of other files are asked only if so.
        """
        del report, charts
        yield from ()

    def tables(self, report: AnyReport) -> Mapping[str, Sequence[Mapping[str, Any]]]:
        """Return CSV files' rows by file name."""
        del report
        return {}

    @classmethod
    def compared(cls, first: Mapping[str, Any], second: Mapping[str, Any]) -> Section | None:
        """Return how two reports differ in the section's data, as a part of a page."""
        del first, second
        return None


def open_errors(value: Any) -> Any:
    """Return plain data with infinite numbers where entries named `…error` have none.

    >>> open_errors({"change": 0.1, "change_error": None})
    {'change': 0.1, 'change_error': inf}
    """
    if isinstance(value, list):
        return [open_errors(entry) for entry in value]
    if not isinstance(value, Mapping):
        return value
    return {
        name: float("inf") if entry is None and name.endswith("error") else open_errors(entry)
        for name, entry in value.items()
    }


def listed(names: Sequence[str]) -> str:
    """Return names as a sentence has them.

    >>> listed(["shoulder"]), listed(["shoulder", "elbow", "wrist"])
    ('shoulder', 'shoulder, elbow and wrist')
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def validation_first(recordings: Iterable[str]) -> list[str]:
    """Return names of recordings, that of the training data last.

    >>> validation_first(["training", "validation"])
    ['validation', 'training']
    """
    return sorted(recordings, key=lambda name: name == "training")


def axis_title(name: str, unit: str) -> str:
    """Return a quantity's name with its unit, if it has one."""
    return f"{name} [{unit}]" if unit else name
