"""Mutations of files: of text, of bytes and of plain data, as slips and damage make them."""

import copy
import json
import random
import re
from collections.abc import Callable
from typing import Any


NUMBERS = (
    *("0.5", "3", "10", "-0.1", "1e-3", "1e-9", "1e-12", "1e3", "1e6", "1e9", "1e15", "0.30000001"),
    *("nan", "inf", "-inf", "0", "-0.0", "-1", "1", "2.5", "1e300", "-1e300", "1e-300", "1e160"),
    *("99999999999999999999999999", "1,5", "0x10", "1e", "--1", "1_000", "٣", "true", "null", ""),
)
WORDS = ("", "x", "joint", "é", "a b", '"', "'", "<", "&amp;", "[", "]]", "{}", "\\", "\x00")
NAMES = (
    *("=1+1", "+1", "@SUM(1)", "-2+3|x!A1", "a,b", "a;b", "a\tb", "a\nb", "\r", " ", "a  b", ""),
    *(
        "\x1b[31mred",
        "\x1b]0;title\x07",
        "\x9b2J",
        "\u202eabc",
        "\u200b",
        "\x7f",
        "\x01",
        "e\u0301",
    ),
    *("*/ int x; /*", "**/ /", "a*\\", "??/", "//", "#if", "int", "main", "6dof arm", "_", "__A"),
    *("<script>alert(1)</script>", '"><b>', "&amp;", "</td>", "]]>", "<!--", "'", '"', "`", "\\"),
    *("..", ".", "../x", "/etc/passwd", "~", "-", "--help", "-o", "$(id)", "${HOME}", "%s%n", "%"),
    *("{0}", "{}", "{{x}}", "{% x %}", "[red]x[/red]", "[/]", "\\u0041", "\\N", "$x_1$"),
    *(
        "__debug__",
        "__class__",
        "lambda",
        "None",
        "True",
        "pi",
        "sin",
        "e",
        "I",
        "t",
        "dot",
        "ddot",
    ),
    *("joint 1", "joint_1", "1", "-0", "torque_1", "time", "position", "base", "world", "universe"),
    *(
        "é",
        "关节",
        "🤖",
        "ı",
        "ß",
        "x" * 300,
        "x" * 20_000,
        "a b" * 50,
        "kv1",
        "m1",
        "Ixx1",
        "null",
    ),
)
"""Names that are formulas, code, markup, paths, options, escapes, or somebody else's."""
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2.5, 1e300, -1e300, 1e-300, 10**26, float("nan"), float("inf")),
    *(0.5, 3, 10, 100, -0.1, 1e-3, 1e-9, 1e6, 1e9, [0.5], [1, 2], [0.1, 10.0], "huber", "auto"),
    *("", "x", "1e999", "1", [], {}, [0], [[1]], ["a1"], [["a1"]], {"x": 1}, [None], [1e300], [[]]),
)

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[A-Za-z_]\w*")


def mutated_text(text: str, draw: random.Random) -> bytes:
    """A text after one to three mutations, in UTF-8 or, rarely, in another encoding."""
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        text = draw.choice(_TEXT)(text, draw)
    encoding = draw.choices(("utf-8", "utf-8-sig", "utf-16", "latin-1"), (94, 2, 2, 2))[0]
    return text.encode(encoding, errors="replace")


def mutated_bytes(data: bytes, draw: random.Random) -> bytes:
    """Bytes after one to three changes: single ones, cuts, repeats, insertions."""
    for _ in range(draw.choice((1, 1, 2, 3))):
        if not data:
            return data
        start = draw.randrange(len(data))
        end = min(len(data), start + draw.choice((1, 1, 4, 16, 256)))
        changed = bytes(draw.randrange(256) for _ in range(end - start))
        lengths = draw.choice((b"\xff", b"\x7f", b"\x00", b"\x01\x00\x00\x00")) * (end - start)
        kept = (
            changed,
            b"",
            data[start:end] * 2,
            changed + data[start:end],
            lengths[: end - start],
        )
        data = data[:start] + draw.choice(kept) + data[end:]
        data = data[:start] if draw.random() < 0.1 else data
    return data


def mutated_document(document: Any, draw: random.Random) -> Any:
    """Plain data (of JSON) after one to three entries were replaced, removed, added or moved."""
    document = json.loads(json.dumps(document))
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        parents = [x for x in _containers(document) if x]
        if not parents:
            return document
        # The outermost entries are few among the thousands of a covariance: every depth counts.
        parent = draw.choice(parents if draw.random() < 0.5 else parents[:4])
        keys = list(parent) if isinstance(parent, dict) else list(range(len(parent)))
        key, kind = draw.choice(keys), draw.random()
        if kind < 0.7:
            parent[key] = copy.deepcopy(draw.choice(VALUES))
        elif kind < 0.85:
            del parent[key]
        elif isinstance(parent, dict):
            name = draw.choice((*map(str, keys), "unknown"))
            parent[name] = copy.deepcopy(draw.choice(VALUES))
        else:
            parent.append(copy.deepcopy(draw.choice((*VALUES, parent[key]))))
    return document


def renamed(text: str, name: str, draw: random.Random, quote: Callable[[str], str]) -> str:
    """A text with a hostile name in place of one of its own, wherever that stands, or once.

    - `name`: the text's own.
    - `quote`: escapes a name as the text's format needs it; most times it is used.
    """
    other = draw.choice(NAMES)
    if draw.random() < 0.9:
        other = quote(other)
    return re.sub(rf"\b{name}\b", lambda _: other, text, count=draw.choice((0, 0, 0, 1)))


def formula(draw: random.Random, symbols: tuple[str, ...], depth: int = 4) -> str:
    """A formula of symbols, numbers and functions; some need years, or are none."""
    kind = draw.random()
    if depth == 0 or kind < 0.2:
        return draw.choice((*symbols, *symbols, *_ATOMS))

    def part() -> str:
        return formula(draw, symbols, depth - 1)

    if kind < 0.55:
        return f"{part()} {draw.choice(_OPERATORS)} {part()}"
    if kind < 0.75:
        return f"({part()})"
    if kind < 0.95:
        return f"{draw.choice(_FUNCTIONS)}({part()})"
    return draw.choice(_HOSTILE_FORMULAS).replace("?", part())


_ATOMS = ("0", "1", "2", "0.5", "1e300", "1e-300", "9" * 40, "pi", "x1", "dot(x)", "ddot(x)", "t")
_OPERATORS = ("+", "-", "*", "*", "/", "**", "^", "%", "//", "==", "<", ",", "and", "@", ".")
_FUNCTIONS = (
    *("sin", "cos", "tan", "exp", "log", "sqrt", "abs", "sign", "tanh", "dot", "ddot", "-", "atan"),
    *("factorial", "gamma", "eval", "__import__", "lambda", "Integral", "min", "x", ""),
)
_HOSTILE_FORMULAS = (
    *("9**9**9*?", "(?)**500", "(?)**0.5", "(?)**-1", "(?)**(1/3)", "2**(?)", "10**(10**?)"),
    *(
        "-" * 5000 + "?",
        "(" * 500 + "?" + ")" * 500,
        "sin(" * 60 + "?" + ")" * 60,
        "+".join("?" * 50),
    ),
    *("*".join(["(1+?)"] * 12), "1/(?-?)", "log(0*?)", "0/0*?", "[?]", "?.real", "? if ? else ?"),
    *(
        "__import__('os').system('id')",
        "?;?",
        "?=?",
        "'?'",
        "?!",
        "1e999*?",
        "?\n+?",
        "().__class__",
    ),
)


def _containers(document: Any) -> list[Any]:
    """Every list and mapping in a document, from the outside inwards."""
    listed, position = [document], 0
    while position < len(listed):
        entry = listed[position]
        values = entry.values() if isinstance(entry, dict) else entry
        listed += [value for value in values if isinstance(value, dict | list)]
        position += 1
    return [entry for entry in listed if isinstance(entry, dict | list)]


def _replace(pattern: re.Pattern[str], words: tuple[str, ...]) -> Callable[..., str]:
    def mutate(text: str, draw: random.Random) -> str:
        spans = [match.span() for match in pattern.finditer(text)]
        if not spans:
            return text
        start, end = draw.choice(spans)
        other = draw.choice(spans)
        word = draw.choice((*words, text[other[0] : other[1]]))
        return text[:start] + word + text[end:]

    return mutate


def _lines(text: str, draw: random.Random) -> str:
    """A line is removed, repeated, moved or indented."""
    lines = text.splitlines(keepends=True)
    if not lines:
        return text
    i, j = draw.randrange(len(lines)), draw.randrange(len(lines))
    kind = draw.randrange(4)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(j, lines[i])
    elif kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    else:
        lines[i] = draw.choice(("  ", "\t", "#", ";")) + lines[i]
    return "".join(lines)


def _span(text: str, draw: random.Random) -> str:
    """Some characters are removed, repeated or replaced."""
    start = draw.randrange(len(text) + 1)
    end = min(len(text), start + draw.choice((1, 1, 3, 10, 100)))
    return text[:start] + draw.choice(("", text[start:end] * 2, draw.choice(WORDS))) + text[end:]


def _whole(text: str, draw: random.Random) -> str:
    """The end is cut off, or lines end otherwise."""
    return draw.choice(
        (
            text[: draw.randrange(len(text) + 1)],
            text.replace("\n", "\r\n"),
            text.replace("\n", "\r"),
            text.rstrip(),
            text.replace(",", ";"),
            text.replace(".", ","),
        )
    )


_numbers, _words = _replace(_NUMBER, NUMBERS), _replace(_WORD, WORDS)
_TEXT: tuple[Callable[[str, random.Random], str], ...] = (
    *(_numbers, _numbers, _numbers, _numbers, _words, _words, _lines, _lines, _span, _whole),
)
