"""The study of the robot's file as prior: what its tables count."""

from typing import Any

from scripts.studies.file_prior.study import _intervals, _links, _tables


def row(motion: str, *errors: float, named: bool = False) -> dict[str, Any]:
    """One coefficient, and torque errors: with the file, of it, of the fit alone, and before."""
    ours, file, alone, before = errors
    return {
        **{"motion": motion, "file": "usual", "torque": [1.0], "named": named},
        **{"with": [ours], "file_error": [file], "without": [alone], "today": [before]},
        **{"change": [0.02], "inside": [True], "inside_noise": [motion == "rich"], "share": [0.0]},
        **{"body_error": [[0.1, 0.01]], "file_body_error": [[0.2, 0.01]]},
    }


def test_the_table_judges_weak_motions_and_names_by_the_rich_one() -> None:
    rows = [
        row("slow", 0.2, 0.4, 0.8, 0.2),
        row("small", 0.2, 0.4, 0.8, 0.2),
        row("rich", 0.02, 0.4, 0.02, 0.02, named=True),
    ]
    text = "\n".join(_tables(rows))
    (line,) = (line for line in text.splitlines() if line.startswith("usual: "))
    expected = "usual: masses 20 %, centres 2 cm 2 0.50, 0.50 0.25, 0.25 1.00, 1.00 100 100 0 100"
    assert line.split() == expected.split()
    assert _links(rows)[1] == ["slow", "0.50", "1.00"]
    assert _intervals(rows)[1][1:] == ["1", "100.0", "100.0", "0.020, 0.020"]
    assert "usual, rich motion, 1 coefficients of which the file is less than 10 %" in text
    assert "median 0.020, 95 % 0.020 standard errors" in text
    assert "inside their intervals 100.0 %, and inside those of the standard error alone" in text
    assert (
        "identified masses over the file's errors: root mean square over links, median 0.50" in text
    )


def test_recordings_that_are_too_short_are_counted_apart() -> None:
    failed = {"motion": "short", "file": "usual", "failed": "too short"}
    text = "\n".join(_tables([failed, row("slow", 0.2, 0.4, 0.1, 0.2)]))
    assert text.startswith("1 recordings too short to be fitted")
    (line,) = (line for line in text.splitlines() if line.startswith("usual: "))
    assert line.split()[-4:] == ["0", "0", "0", "-"]
