"""The checker of English: what it counts, what it finds, and what it leaves alone."""

from pathlib import Path

import pytest

from scripts.tools.english import code_findings, findings, lengths, paragraphs, sentences, words


def test_prose_is_told_from_code_tables_and_headings() -> None:
    text = (
        "# A heading\n\nOne line\nof prose.\n\n```sh\nnot prose\n```\n\n| a | b |\n\n- An item.\n"
    )
    assert list(paragraphs(text)) == [(3, "One line of prose."), (12, "An item.")]


def test_sentences_and_words() -> None:
    text = "Use `a.b` first. See [the page](x.md#y), e.g. this one. 3 of 4 hold."
    assert len(sentences(text)) == 3
    assert words("Use `a` and the arm's 3 joints") == 6


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("It uses a spline in place of a filter.", "write 'instead of'"),
        ("A wheel stands beside the arm.", "write 'next to'"),
        ("The report shows ε of the arm.", "ε is not defined"),
        ("The highest ε is below that of the mean modulus. ε = 3 is an error.", "ε is not defined"),
        ("`half_rms` (the ε of 7.5), `mean_modulus`.", "ε is not defined"),
        ("With δ the lag, τ̇ (δ − δ₀) is small.", "δ₀ is not defined"),
        ("# What limits it", "name a topic or a task"),
        ("## Terms that are chosen", "name a topic or a task"),
        ("## Is it slow?", "name a topic or a task"),
        ("# One two three four five six seven eight nine ten", "heading of 10 words"),
        ("A " + "very " * 45 + "long sentence.", "at most 30"),
    ],
)
def test_what_is_found(text: str, problem: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text + "\n", encoding="utf-8")
    assert any(problem in finding.problem for finding in findings(page))


def test_good_text_has_no_findings(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("The error is small.\n\nε is the mean error.\n", encoding="utf-8")
    assert findings(page) == []
    assert lengths(page.read_text("utf-8")) == [4, 4]


@pytest.mark.parametrize(
    "text",
    [
        "**ε** is that of the fit.",
        "`σ_q` and `σ_τ` are noise levels.",
        "    K = ω²\n\nHere ω is the natural frequency.",
        "With frequency ω and the speed γ, π/2 later.",
        "```sh\n# What is a comment here, and ε\n```",
        "# Choose an estimator, friction terms and settings",
    ],
)
def test_definitions_and_headings_that_are_good(text: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text + "\n", encoding="utf-8")
    assert findings(page) == []


def test_first_sentences_and_errors_of_code(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        'def f(x):\n    """Uses a in place of b.\n\n    Hardly any."""\n'
        '    raise ValueError(f"{x}: but for this")\n'
        '    return "hardly"\n'
    )
    assert [(found.line, found.problem[:10]) for found in code_findings(module)] == [
        (2, "'in place "),
        (5, "'but for' "),
    ]
