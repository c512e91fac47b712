"""Pages: blocks of text, tables and details in sections, and their HTML from templates."""

import abc
import dataclasses
import html
import importlib.util
import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from .._environment import require
from .._text_table import number_text


if TYPE_CHECKING:
    import jinja2


Tone = Literal["good", "caution", "bad", "plain"]
"""Tone of a sentence: good or bad news."""
Value = str | float | int | None
"""Content of a table's cell."""


class AbstractBlock(abc.ABC):
    """A part of a section of a page, drawn by the template of its kind.

    **Attributes**

    - `kind`: names the template.

    >>> from jaxcslc.report import AbstractBlock, Paragraph
    >>> isinstance(Paragraph("Joint 1"), AbstractBlock)
    True
    """

    kind: ClassVar[str]


@dataclasses.dataclass(frozen=True)
class Paragraph(AbstractBlock):
    """A paragraph of text.

    **Attributes**

    - `text`: is escaped.

    >>> Paragraph("Joint <1>").kind
    'paragraph'
    """

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclasses.dataclass(frozen=True)
class Message:
    """A sentence, and whether it is good or bad news.

    **Attributes**

    - `text`: the sentence.
    - `tone`: `"good"`, `"caution"`, `"bad"` or `"plain"`.

    >>> Message("The gripper was not modelled.").tone
    'caution'
    """

    text: str
    tone: Tone = "caution"


@dataclasses.dataclass(frozen=True)
class Messages(AbstractBlock):
    """A list of messages.

    **Attributes**

    - `messages`: in the order in which they are read.
    - `empty`: what stands there if there are none.

    >>> Messages((), empty="No warnings.").messages
    ()
    """

    kind: ClassVar[str] = "messages"
    messages: tuple[Message, ...]
    empty: str = ""


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a `Table`.

    **Attributes**

    - `title`: of the column, its unit included.
    - `explanation`: shown under the pointer.
    - `digits`: of its numbers.
    - `decimals`: of its numbers, instead of digits.
    - `numeric`: aligned right.
    - `tones`: of its texts, which are then drawn as marks.
    - `wide`: text that may wrap.
    - `longest`: characters of a text that wraps; what is beyond them is shown on a click.

    >>> Column("value", digits=3).text(1234.5)
    '1.23e+03'
    >>> Column("value").text(float("inf")), Column("value").text(None)
    ('∞', '')
    """

    title: str
    explanation: str = ""
    digits: int = 4
    decimals: int | None = None
    numeric: bool = True
    tones: Mapping[str, Tone] = dataclasses.field(default_factory=dict)
    wide: bool = False
    longest: int = 140

    @property
    def heading(self) -> str:
        """The title; units are not broken over lines."""
        return re.sub(
            r"\[[^\]]*\]", lambda unit: unit[0].replace(" ", "\N{NO-BREAK SPACE}"), self.title
        )

    def text(self, value: Value) -> str:
        """Return a value as it is shown."""
        if value is None:
            return ""
        if not isinstance(value, float):
            return str(value)
        if self.decimals is None or not math.isfinite(value):
            return number_text(value, self.digits)
        text = f"{value:.{self.decimals}f}"
        return text.removeprefix("-") if float(text) == 0 else text

    def beginning(self, value: Value) -> str | None:
        """Return the beginning of a text that is too long, shown at first; None for others."""
        text = self.text(value)
        return f"{text[: self.longest - 10]} …" if self.wide and len(text) > self.longest else None

    def order(self, value: Value) -> str:
        """Return the sort key of a value: numbers by their size, NaN last."""
        if isinstance(value, float | int) and not isinstance(value, bool):
            return "" if math.isnan(value) else repr(float(value))
        return "" if value is None else str(value)

    def tone(self, value: Value) -> Tone | None:
        """Return the tone that marks a text; None for plain text."""
        return self.tones.get(value) if isinstance(value, str) else None


@dataclasses.dataclass(frozen=True)
class Table(AbstractBlock):
    """Rows under columns, which a click on a title sorts.

    **Attributes**

    - `columns`: one `Column` each.
    - `rows`: of texts and numbers, one a column; None for an empty cell.
    - `caption`: above the table.
    - `name`: of the table in its page, for links.

    >>> table = Table((Column("joint", numeric=False), Column("RMS [N m]")), (("elbow", 0.25),))
    >>> len(table.rows)
    1
    >>> Table((Column("joint"),), ((1, 2),))
    Traceback (most recent call last):
    ...
    ValueError: table '', row 1: expected 1 entries, got 2
    """

    kind: ClassVar[str] = "table"
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    caption: str = ""
    name: str = ""

    def __post_init__(self) -> None:
        for number, row in enumerate(self.rows, 1):
            if len(row) != len(self.columns):
                raise ValueError(
                    f"table {self.name!r}, row {number}: expected {len(self.columns)} entries,"
                    f" got {len(row)}"
                )

    @classmethod
    def from_columns(
        cls, columns: Iterable[tuple[Column, Iterable[Value]]], caption: str = "", name: str = ""
    ) -> "Table":
        """Return a table of columns, each with its values.

        **Raises** `ValueError` for columns of different lengths.

        >>> Table.from_columns([(Column("joint"), (1, 2)), (Column("RMS [N m]"), (0.3, 0.2))]).rows
        ((1, 0.3), (2, 0.2))
        """
        heads, values = zip(*columns, strict=True)
        return cls(heads, tuple(zip(*values, strict=True)), caption, name)


@dataclasses.dataclass(frozen=True)
class Code(AbstractBlock):
    """Text of fixed width: a command, a program, a file.

    **Attributes**

    - `text`: with its line breaks.

    >>> Code("jaxcslc identify arm.toml log.csv").kind
    'code'
    """

    kind: ClassVar[str] = "code"
    text: str


@dataclasses.dataclass(frozen=True)
class Picture(AbstractBlock):
    """A picture in a file beside the page.

    **Attributes**

    - `source`: the file, relative to the page.
    - `caption`: below the picture, and its text for those who do not see it.

    >>> Picture("figure.png", "Measured torque").source
    'figure.png'
    """

    kind: ClassVar[str] = "picture"
    source: str
    caption: str


@dataclasses.dataclass(frozen=True)
class Link(AbstractBlock):
    """A link to a file beside the page.

    **Attributes**

    - `target`: the file, relative to the page.
    - `text`: of the link; the file's name if omitted.

    >>> Link("coefficients.csv").label
    'coefficients.csv'
    """

    kind: ClassVar[str] = "link"
    target: str
    text: str = ""

    @property
    def label(self) -> str:
        """Text that is shown."""
        return self.text or self.target


@dataclasses.dataclass(frozen=True)
class Details(AbstractBlock):
    """Blocks that a click on their summary shows.

    **Attributes**

    - `summary`: that is always shown.
    - `blocks`: that are shown when opened.
    - `opened`: whether they are shown at first.

    >>> Details("All trials", (Paragraph("forty"),)).kind
    'details'
    """

    kind: ClassVar[str] = "details"
    summary: str
    blocks: tuple[AbstractBlock, ...]
    opened: bool = False


@dataclasses.dataclass(frozen=True)
class Grid(AbstractBlock):
    """Blocks side by side, as many as the screen is wide.

    **Attributes**

    - `blocks`: in the order of reading.

    >>> len(Grid((Paragraph("left"), Paragraph("right"))).blocks)
    2
    """

    kind: ClassVar[str] = "grid"
    blocks: tuple[AbstractBlock, ...]


@dataclasses.dataclass(frozen=True)
class Section:
    """A heading, what the section shows in a sentence or two, and its blocks.

    **Attributes**

    - `title`: the heading.
    - `lead`: explains what follows, and terms where they first stand.
    - `blocks`: in order.

    >>> Section("Torque errors", "RMS: root mean square.", ()).anchor
    'torque-errors'
    """

    title: str
    lead: str
    blocks: Sequence[AbstractBlock]

    @property
    def anchor(self) -> str:
        """The section's name in links."""
        letters = (c if c.isalnum() else " " for c in self.title.lower())
        return "-".join("".join(letters).split())


@dataclasses.dataclass(frozen=True)
class Page:
    """A page of sections, with its verdict in the first lines.

    **Attributes**

    - `title`, `subtitle`: the heading.
    - `headline`: the verdict in a sentence.
    - `tone`: of the headline.
    - `summary`: sentences below it.
    - `sections`: of the page.

    >>> page = Page("Identification of arm", "", "The model can be used.", "good", (), ())
    >>> page.headline
    'The model can be used.'
    """

    title: str
    subtitle: str
    headline: str
    tone: Tone
    summary: tuple[Message, ...]
    sections: tuple[Section, ...]


# Values below this part of the largest are rounding: of frames, 1e-16, and of solvers, 1e-9.
_ROUNDING = 1e-8


def without_rounding(values: Iterable[float], largest: float) -> list[float]:
    """Return values to show, zero where only rounding makes them differ from it.

    - `largest`: magnitude of such values.

    >>> without_rounding([0.28, -4.3e-35], 0.28)
    [0.28, 0.0]
    """
    return [x if abs(x) > _ROUNDING * largest else 0.0 for x in values]


def render(page: Page) -> str:
    """Return a page as one HTML file that needs no other file but those that it names.

    Texts are escaped: a robot may have any name. Charts are drawn by plotly.js, which is then part
    of the page (5 MB). Without the extra `report` a line says how to install it.

    **Arguments**

    - `page`: with its sections.

    **Returns** the file's text.

    >>> from jaxcslc.report import Page, Paragraph, Section, render
    >>> section = Section("Errors", "", (Paragraph("below 1 N m"),))
    >>> page = Page("Arm <1>", "", "", "plain", (), (section,))
    >>> "<h1>Arm &lt;1&gt;</h1>" in render(page)
    True
    """
    charts = any(_has_chart(section.blocks) for section in page.sections)
    drawn = charts and importlib.util.find_spec("plotly") is not None
    return _template().render(
        page=page,
        script=require("plotly.offline", "report").get_plotlyjs() if drawn else None,
        charts=charts,
        number=itertools.count(1).__next__,
    )


def notebook_frame(page: Page) -> str:
    """Return a page as notebooks show it: in a frame of its own, below other output."""
    text = html.escape(render(page))
    return f'<iframe srcdoc="{text}" style="width: 100%; height: 40em; border: 0"></iframe>'


def _has_chart(blocks: Sequence[AbstractBlock]) -> bool:
    """Return whether there is a chart among blocks, or in those inside them."""
    inside = (getattr(block, "blocks", ()) for block in blocks)
    return any(block.kind == "chart" for block in blocks) or any(map(_has_chart, inside))


@cache
def _template() -> "jinja2.Template":
    import jinja2  # most users write no page

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("page.html")
