from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ....page import Message, Tone
from ._quality import worst_joint


# A model that explains less than half of the variance of a joint's training torque is not one of
# this joint. (A good model may explain less of a validation torque that hardly changes.)
_LEAST_R_SQUARED = 0.5
# Errors in % of a joint's RMS torque.
_SMALL, _LARGE = 10.0, 50.0
# Above this share of signs that no body has, torque or positions are likely to have the wrong one.
_MANY_WRONG_SIGNS = 0.25

VERDICT_TONES: dict[str, Tone] = {
    "well determined": "good",
    "systematic error": "caution",
    "poorly determined": "caution",
    "indistinguishable from zero": "plain",
    "wrong sign": "bad",
    "not determined": "bad",
}

# Motion that was not fitted, by the source of held-out errors.
_MOTION = {
    "validation": "the validation recording",
    "cross-validation": "stretches of the training recording that were left out in turn",
    "left-out recording": "training recordings that were left out in turn",
    "held-out stretch": "the last part of the training recording, held out",
}

_MARKS: dict[Tone, str] = {"good": "✓", "caution": "!", "bad": "✗", "plain": " "}

HEADLINES: dict[Tone, str] = {
    "good": "The identified model can be used.",
    "caution": "The identified model can be used with care: see the points marked !.",
    "bad": "Do not rely on the identified model before the points marked ✗ are settled.",
}


def summary(data: Mapping[str, Any]) -> tuple[Tone, str, tuple[Message, ...]]:
    """A report's verdict in words.

    **Arguments**

    - `data`: of the report, from `report_data`.

    **Returns**

    - `"good"`, `"caution"` or `"bad"`: the worst of the messages.
    - The verdict in a sentence.
    - What it rests on, a sentence each.
    """
    messages = tuple(
        message
        for part in (_errors, _held_out, _coefficients, _condition, _warnings)
        for message in part(data)
    )
    tones = {message.tone for message in messages}
    tone: Tone = "bad" if "bad" in tones else "caution" if "caution" in tones else "good"
    return tone, HEADLINES[tone], messages


def summary_text(data: Mapping[str, Any]) -> str:
    """A report's verdict, and what it rests on, as lines to print.

    **Arguments**

    - `data`: of the report, from `report_data`.
    """
    _, headline, messages = summary(data)
    return "\n".join([headline, *(f"  {_MARKS[line.tone]} {line.text}" for line in messages)])


def judged_recording(data: Mapping[str, Any]) -> str:
    """The recording that a model is judged on: the validation recording, if there is one."""
    return "validation" if "validation" in data["recordings"] else "training"


def _errors(data: Mapping[str, Any]) -> Iterator[Message]:
    name = judged_recording(data)
    quality = data["recordings"][name]["quality"]
    worst = worst_joint(quality, "judged")
    if worst is None:
        yield Message(f"No sample of the {name} recording could be judged.", "bad")
        return
    percent = np.asarray(quality["judged"]["percent"], float)
    largest = float(np.nanmax(percent))
    tone: Tone = "bad" if largest > _LARGE else "caution" if largest > _SMALL else "good"
    everything = np.asarray(quality["all"]["percent"], float)
    yield Message(
        f"{data['quantity'].capitalize()} error on the {name} recording:"
        f" {_range(percent)} % of the RMS {data['quantity']} over the samples that masks leave in,"
        f" {_range(everything)} % over all; largest at {data['joints'][worst]}.",
        tone,
    )
    r_squared = data["recordings"]["training"]["quality"]["judged"]["r_squared"]
    low = np.flatnonzero(np.asarray(r_squared, float) < _LEAST_R_SQUARED).tolist()
    if low:
        names = [data["joints"][joint] for joint in low]
        yield Message(
            f"The model explains less than half of the training {data['quantity']}'s variance of"
            f" {_list(names)}: check units, signs and the model's terms.",
            "bad",
        )


def _held_out(data: Mapping[str, Any]) -> Iterator[Message]:
    held_out = data["held_out"]
    if held_out is None:
        yield Message("Not judged on motion that was not fitted.", "caution")
        return
    motion = _MOTION[held_out["source"]]
    beyond = [data["joints"][joint - 1] for joint in held_out["beyond_chance"]]
    if beyond:
        yield Message(
            f"Errors on {motion} are larger than noise explains at {_list(beyond)}: the model may"
            " lack a term.",
            "caution",
        )
    else:
        yield Message(f"Errors on {motion} are no larger than noise explains.", "good")


def _coefficients(data: Mapping[str, Any]) -> Iterator[Message]:
    rows = data["coefficients"]
    kinds = Counter(row["verdict"] for row in rows)
    others = ", ".join(
        f"{kinds[kind]} {kind}"
        for kind in VERDICT_TONES
        if kind != "well determined" and kinds[kind]
    )
    missing = kinds["not determined"]
    yield Message(
        f"{kinds['well determined']} of {counted(len(rows), 'coefficient')} well determined"
        + (f"; {others}." if others else "."),
        "caution" if missing or kinds["well determined"] < 0.5 * len(rows) else "good",
    )
    signed = sum(bool(row["positive"]) for row in rows)
    if wrong := kinds["wrong sign"]:
        many = wrong > _MANY_WRONG_SIGNS * signed
        names = [row["name"] for row in rows if row["verdict"] == "wrong sign"]
        yield Message(
            f"{_list(names)}: negative, and positive for every possible body"
            + ("; check the signs of torques and positions." if many else "."),
            "bad" if many else "caution",
        )


def _condition(data: Mapping[str, Any]) -> Iterator[Message]:
    if not data["meaningful"]:
        yield Message(
            f"Condition number {data['condition']:.2g}: the motion does not tell the coefficients"
            " apart, and no value means anything by itself.",
            "bad",
        )


def _warnings(data: Mapping[str, Any]) -> Iterator[Message]:
    count = len(data["warnings"]) + len(data["findings"])
    if count:
        yield Message(
            f"{counted(count, 'warning')} about data and fit.",
            "caution",
        )


def counted(number: int, noun: str) -> str:
    """A number and its noun.

    >>> counted(1, "joint"), counted(6, "joint")
    ('1 joint', '6 joints')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _range(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "-"
    low, high = f"{finite.min():.2g}", f"{finite.max():.2g}"
    return low if low == high else f"{low} to {high}"


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
