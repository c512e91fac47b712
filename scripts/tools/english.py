"""Check the English of pages: sentence lengths, phrases, symbols and headings.

    python -m scripts.tools.english              every page that `make check` holds to the rules
    python -m scripts.tools.english docs/x.md    one page, with its figures

The rules are those of plain technical English. A sentence of a guide has at most 30 words, and
the mean of a page is at most 17. Phrases that a reader has to translate have a better one, which
the message names. A heading names a topic or a task: it is no clause, question or sentence. A page
defines each Greek letter where it uses it first: in words, or next to the quantity's name. A guide
has no dates and no studies: they belong on evidence pages, whose sentences may have any length. Of
`jaxcslc`, the first sentences of docstrings and the errors that are
raised are checked for the worst phrases.
"""

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


ROOT = Path(__file__).parents[2]
LONGEST, MEAN = 30, 17  # words

# Pages with figures of studies: their tables and disclosures are not held to a length.
EVIDENCE = frozenset(
    {
        "benchmarks.md",
        "estimators.md",
        "experiment.md",
        "generalisation.md",
        "peral.md",
        "puma_a_b.md",
        "real_robots.md",
        "thesis.md",
        "ultrasound.md",
    }
)
# Pages that are written by programs from texts that stand elsewhere.
GENERATED = frozenset({"command.md", "experiment.md", "puma_a_b.md", "thesis.md"})

# A phrase, as a regular expression, and what to write instead.
PHRASES: dict[str, str] = {
    r"\bin place of\b": "instead of",
    r"\bleft[- ]out\b": "held-out, excluded or omitted",
    r"\bmakes? up for\b": "compensates",
    r"\bbut for\b": "except",
    r"\bfree fit\b": "unconstrained fit",
    r"\bpossible bod(?:y|ies)\b": "physically consistent",
    r"\bgears that give way\b": "elastic joint",
    r"\bbefore (?:it|they|joints) slides?\b": "pre-sliding",
    r"\bcounts? of an encoder\b": "encoder ticks",
    r"\ba joint\b(?=[,.;:)])": "per joint",
    r"\bmends?\b|\bmended\b": "fixes, corrects",
    r"\btells? of\b": "says about",
    r"\bnobody knows\b": "a subject that can do what the verb says",
    r"\bas ever\b": "as usual",
    r"\bbeside\b": "next to",
    r"\bhardly\b": "little, barely",
    r"\bto and fro\b": "back and forth, alternates",
    r"\bgo(?:es)? astray\b": "fails",
}
# Of first sentences of docstrings, and of errors.
_IN_CODE = re.compile(
    r"\b(?:left out|in place of|but for|as ever|to and fro|makes? up for|hardly|goes? astray"
    r"|of these)\b"
)
# What a page of figures has, and a guide has not.
_EVIDENCE_SIGN = re.compile(r"\b20\d\d-[01]\d-[0-3]\d\b|scripts[./]studies\b")
# The page for developers may name studies.
_WITH_STUDIES = frozenset({"CONTRIBUTING.md"})
# Headings that are clauses, questions or sentences; and long ones.
_CLAUSE = re.compile(
    r"^(?:what|how|why|which|where|when|who|whether|before|after)\b|\b(?:that|which)\b|[.?!:]$",
    re.IGNORECASE,
)
_LONGEST_HEADING = 9  # words
# Greek letters that need a definition: π, Σ for a sum and µ for micro are everybody's.
_SYMBOL = re.compile(r"(?<![\w_])[α-ξρ-ωΓΔΘΛΞΦΨΩ][₀-₉]*")
# "ε is the ...", "ε: a ...", "σ_q and σ_τ are noise ...", "with δ the lag", "the speed γ".
_DEFINITION = (
    r"{symbol}(?:_\w+)?[`*]*(?: and \S+)?(?:,|:| is| are)? (?:the|a|an|that|its|joint|noise)\b"
    r"|\b(?:angle|damping|deviation|frequency|speed) {symbol}"
)
_NEAR = 400  # characters after the first use: the sentences around a formula


@dataclass(frozen=True)
class Finding:
    """What is wrong at a line of a page."""

    page: Path
    line: int
    problem: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}: {self.problem}"


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Prose of a page with its line: no code, tables, headings, pictures or HTML."""
    kept: list[str] = []
    start, fenced = 1, False
    for number, line in enumerate([*text.splitlines(), ""], 1):
        if line.lstrip().startswith("```"):
            fenced = not fenced
            line = ""
        prose = not fenced and not re.match(r"\s*(#|\||!\[|<|:::|- \[|    \S)", line)
        item = re.match(r"\s*(?:[-*]|\d+\.)\s+", line)
        if kept and (not prose or not line.strip() or item):
            yield start, " ".join(kept)
            kept = []
        if prose and line.strip():
            if not kept:
                start = number
            kept.append(line[item.end() :] if item else line.strip())
    if kept:
        yield start, " ".join(kept)


def sentences(paragraph: str) -> list[str]:
    """Sentences of a paragraph; code counts as one word, a link as its text."""
    plain = re.sub(r"`[^`]*`", "Code", paragraph)
    plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", plain)
    plain = re.sub(r"[*_]{1,2}", "", plain)
    plain = re.sub(r"\b(e\.g|i\.e|Eqn|Fig|Figs|Sec|vs|Dr|al|cf)\.", r"\1", plain)
    return [part for part in re.split(r"(?<=[.!?:])\)?\s+(?=[A-Z(`0-9])", plain) if part.strip()]


def words(sentence: str) -> int:
    """Number of words, numbers with a unit counting once."""
    return len(re.findall(r"[A-Za-zÀ-ÿ][\w'’-]*", sentence))


def lengths(text: str) -> list[int]:
    """Words of each sentence of a page that has at least three."""
    counts = (words(s) for _, paragraph in paragraphs(text) for s in sentences(paragraph))
    return [count for count in counts if count > 2]


def is_evidence(page: Path) -> bool:
    """Return whether a page holds figures of studies."""
    return page.name in EVIDENCE or page.stem.endswith("_evidence")


def findings(page: Path) -> list[Finding]:
    """Everything that the rules find on a page."""
    text = page.read_text("utf-8")
    found: list[Finding] = []
    for number, paragraph in paragraphs(text):
        for phrase, better in PHRASES.items():
            if match := re.search(phrase, paragraph):
                found.append(Finding(page, number, f"'{match.group(0)}': write '{better}'"))
        if is_evidence(page):
            continue
        for sentence in sentences(paragraph):
            if (count := words(sentence)) > LONGEST:
                start = " ".join(sentence.split()[:6])
                found.append(
                    Finding(page, number, f"'{start} ...' has {count} words; at most {LONGEST}")
                )
    if not is_evidence(page) and page.name not in _WITH_STUDIES:
        for number, line in enumerate(text.splitlines(), 1):
            if match := _EVIDENCE_SIGN.search(line):
                found.append(
                    Finding(page, number, f"'{match.group(0)}': belongs on an evidence page")
                )
    found += [*_headings(page, text), *_symbols(page, text)]
    counts = lengths(text)
    if not is_evidence(page) and counts and (mean := sum(counts) / len(counts)) > MEAN:
        found.append(Finding(page, 1, f"mean sentence has {mean:.1f} words; at most {MEAN}"))
    return found


def _without_blocks(text: str) -> str:
    """Text with empty lines for those of fenced blocks, so that lines keep their numbers."""
    return re.sub(
        r"^ *```.*?^ *```", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL | re.MULTILINE
    )


def _headings(page: Path, text: str) -> Iterator[Finding]:
    for number, line in enumerate(_without_blocks(text).splitlines(), 1):
        if match := re.match(r"#+ +(.+)", line):
            heading = match[1].strip()
            if _CLAUSE.search(heading):
                yield Finding(page, number, f"heading '{heading}': name a topic or a task")
            elif (count := words(heading)) > _LONGEST_HEADING:
                problem = f"heading of {count} words; at most {_LONGEST_HEADING}"
                yield Finding(page, number, problem)


def _symbols(page: Path, text: str) -> Iterator[Finding]:
    plain = _without_blocks(text)
    first: dict[str, re.Match[str]] = {}
    for match in _SYMBOL.finditer(plain):
        first.setdefault(match[0], match)
    for symbol, match in first.items():
        known = plain[: match.end() + _NEAR]
        if not re.search(_DEFINITION.format(symbol=symbol), known):
            line = plain[: match.start()].count("\n") + 1
            problem = f"{symbol} is not defined in words where it is used first"
            yield Finding(page, line, problem)


def code_findings(module: Path) -> list[Finding]:
    """What the rules find in docstrings and errors of a module."""
    texts: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = (ast.get_docstring(node) or "").partition("\n\n")[0]
            if first := sentences(" ".join(text.split()))[:1]:
                texts.append((node.body[0].lineno, first[0]))
        elif isinstance(node, ast.Raise) and node.exc is not None:
            parts = (part for part in ast.walk(node.exc) if isinstance(part, ast.Constant))
            texts += [(part.lineno, part.value) for part in parts if isinstance(part.value, str)]
    return [
        Finding(module, line, f"'{match.group(0)}' in: {text}")
        for line, text in texts
        if (match := _IN_CODE.search(text))
    ]


def pages() -> list[Path]:
    """Pages that people write."""
    docs = (path for path in (ROOT / "docs").glob("*.md") if path.name not in GENERATED)
    return [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(docs)]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("pages", nargs="*", type=Path)
    arguments = parser.parse_args()
    chosen = [path.resolve() for path in arguments.pages] or pages()
    found = [finding for page in chosen for finding in findings(page)]
    if not arguments.pages:
        modules = sorted((ROOT / "jaxcslc").rglob("*.py"))
        found += [finding for module in modules for finding in code_findings(module)]
    print(*found, sep="\n")
    for page in arguments.pages:
        counts = lengths(page.read_text("utf-8"))
        print(f"{page}: {len(counts)} sentences, {sum(counts) / max(1, len(counts)):.1f} words")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
