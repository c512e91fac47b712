"""Plain-text tables, and texts of users where they could do harm: in terminals and spreadsheets.

Names of robots, joints, columns and files come from files of strangers. A terminal obeys control
characters in them, and a spreadsheet computes what looks like a formula.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any


def number_text(value: float, digits: int = 4) -> str:
    """A number as text; what has no bound is ∞, and what has no value is empty.

    >>> number_text(0.12345), number_text(-math.inf), number_text(math.nan)
    ('0.1235', '-∞', '')
    """
    if math.isnan(value):
        return ""
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return f"{value:.{digits}g}"


def counted(number: int, noun: str) -> str:
    """Return a number and its noun.

    >>> counted(1, "joint"), counted(6, "joint")
    ('1 joint', '6 joints')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def readable(expression: str) -> str:
    """Return an expression to read: three digits per number, no signs of multiplication.

    >>> readable("Ixx2 + 0.17327300000157975*m4 - 1e-05*m3*rz3 + m2*rx2**2")
    'Ixx2 + 0.173 m4 - 1e-05 m3 rz3 + m2 rx2²'
    """
    number = r"(?<![\w.])\d+\.?\d*(?:e[+-]?\d+)?"
    text = re.sub(number, lambda found: f"{float(found[0]):.3g}", expression.replace("**2", "²"))
    return re.sub(r"(?<!\*)\*(?!\*)", " ", text)


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, left: Sequence[str] = ()
) -> str:
    """Columns of text, the first and those in `left` aligned left, the others right.

    A cell is one line, whatever names it holds.

    >>> print(text_table(["joint", "error"], [["1", "0.25"], ["2", "10.5"]]))
    joint  error
    1       0.25
    2       10.5
    """
    header, *rows = ([cell.replace("\n", "\\n") for cell in row] for row in (header, *rows))
    widths = [max(len(row[i]) for row in (header, *rows)) for i in range(len(header))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 or header[i] in left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (header, *rows)
    )


def first_of(names: Sequence[str], most: int) -> str:
    """Return names for a message, of which a number stands for those beyond the first.

    >>> first_of(["base", "elbow", "wrist"], 2)
    'base, elbow and 1 more'
    """
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


# Control characters, except the end of a line, and those that change the direction of writing.
_CONTROLS = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]"
)
_FORMULA = re.compile(r"[=+@\t\r]|-.*[(|!]", re.DOTALL)


def printable(text: str) -> str:
    r"""Return a text, of one line or more, with all that a terminal would obey as JSON escapes it.

    >>> printable("joint \x1b[2J\u202e")
    'joint \\u001b[2J\\u202e'
    """
    return _CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def csv_line(cells: Iterable[Any]) -> str:
    """Return a line of CSV without its end: quoted where it must be, and no formulas.

    Texts that a spreadsheet would compute begin with an apostrophe, which it takes for a text's.
    Numbers that are not finite are empty cells, as JSON has null for them.

    >>> print(csv_line(["joint 1", "left,right", "=1+1", -2.5]))
    joint 1,"left,right",'=1+1,-2.5
    """
    texts = [f"'{x}" if isinstance(x, str) and _FORMULA.match(x) else x for x in cells]
    texts = ["" if isinstance(x, float) and not math.isfinite(x) else x for x in texts]
    line = io.StringIO()
    csv.writer(line).writerow(texts)  # which quotes the characters of its line's end, too
    return line.getvalue().removesuffix("\r\n")
