"""Plain-text tables with aligned columns, for reports in a terminal."""

from collections.abc import Sequence


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
