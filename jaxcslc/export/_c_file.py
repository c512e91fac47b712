"""Header and source of exported C code."""

import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..codegen import Expressions, KernelText
from ..network import CSLC
from ._c_functions import CFunction


_WIDTH = 100  # of a line of declarations [characters]
_COMMENT_WIDTH = 95
_LONGEST = 90  # of an expression that is written where it is used [characters]
# What is not a number stays none, as in Python: a friction of 0 would hide a velocity that is lost.
_DEFINITIONS = {
    "sign": "static double sign_of(double x)\n{\n"
    "    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;\n}\n",
    "positive": "static double positive_part(double x)\n{\n    return x < 0.0 ? 0.0 : x;\n}\n",
    "negative": "static double negative_part(double x)\n{\n    return x > 0.0 ? 0.0 : x;\n}\n",
}
_CALLS = {
    "sign": "sign_of({0})",
    "positive": "positive_part({0})",
    "negative": "negative_part({0})",
}


def header_file(
    name: str,
    network: CSLC,
    functions: Sequence[CFunction],
    lengths: Float[np.ndarray, " joints"],
) -> str:
    """The declarations: contents of `NAME.h`."""
    guard = f"{name.upper()}_H"
    lines = [f"#ifndef {guard}", f"#define {guard}", "", "/*"]
    lines += [*_about(network), *_about_states(name, network, lengths), "*/", ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for function in functions:
        declaration = f"{_signature(name, network.joint_count, function)};"
        lines += [f"/* {function.operation.summary} */", declaration, ""]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", "#endif"]
    return "\n".join(lines) + "\n"


def source_file(
    name: str,
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    functions: Sequence[CFunction],
) -> str:
    """The definitions: contents of `NAME.c`."""
    lines = ["/*", *_about(network), ""]
    lines += ["Coefficients, in the order of the regressor's columns:", ""]
    width = max(len(c.name) for c in network.coefficients)
    for c, value in zip(network.coefficients, k, strict=True):
        lines.append(f"  {c.name:<{width}} = {value:.17g} {_plain(c.unit)}")
    lines += ["*/", "", "#include <math.h>", "", f'#include "{name}.h"', ""]
    lines += sorted({text for function in functions for text in _definitions(function.graph)})
    for function in functions:
        lines += [
            f"/* {function.operation.summary} {function.cost} operations. */",
            _signature(name, network.joint_count, function),
            "{",
            *_unused(function),
            *_statements(function),
            "}",
            "",
        ]
    return "\n".join(lines)


def _signature(name: str, joints: int, function: CFunction) -> str:
    operation, size = function.operation, len(function.values)
    inputs = ", ".join(f"const double {argument}[{joints}]" for argument in function.inputs)
    text = f"void {name}_{operation.name}({inputs}, double {operation.output}[{size}])"
    if len(text) <= _WIDTH:
        return text
    return text.replace(f", double {operation.output}", f",\n    double {operation.output}")


def _definitions(graph: Expressions) -> list[str]:
    """Functions that C's library does not have and the expressions use."""
    used = {operation.name for operation in graph.operations}
    return [text for name, text in _DEFINITIONS.items() if name in used]


def _statements(function: CFunction) -> list[str]:
    output = function.operation.output
    stores = [(x, f"{output}[{i}] = {{0}};") for i, x in enumerate(function.values)]
    text = KernelText(function.graph, lambda x: x.text or None, _CALLS, constant="{0!r}")
    return [f"    {line}" for line in text.nested_statements(stores, _LONGEST)]


def _unused(function: CFunction) -> list[str]:
    """Statements that keep compilers from warning of inputs that nothing depends on."""
    needed = function.graph.needed(function.values)
    used = {function.graph.operations[index].text.partition("[")[0] for index in needed}
    return [f"    (void){name};" for name in function.inputs if name not in used]


def _about(network: CSLC) -> list[str]:
    robot = network.robot
    kinds = ", ".join(
        f"{joint} {'revolute [rad, N m]' if kind == 'R' else 'prismatic [m, N]'}"
        for joint, kind in zip(_joint_names(network), network.joint_kinds, strict=True)
    )
    return [
        f"Inverse dynamics of {_plain(robot.name)}, written by jaxcslc.",
        "",
        *_wrapped(f"Joints, in order: {kinds}."),
        "Positions q, velocities qd [1/s] and accelerations qdd [1/s^2] of every joint.",
        f"{network.size} coefficients, lengths {network.algebra.lengths}.",
    ]


def _about_states(name: str, network: CSLC, lengths: Float[np.ndarray, " joints"]) -> list[str]:
    """How to use states of contacts, where there are any."""
    if not np.any(lengths):
        return []
    units = {"R": "rad", "P": "m"}
    listed = ", ".join(
        f"{_plain(joint)} {length:.6g} {units[kind]}"
        for joint, kind, length in zip(
            network.output_names, network.joint_kinds, lengths, strict=True
        )
        if length > 0.0
    )
    return [
        "",
        *_wrapped(f"Dry friction yields before it slides, over a length of the path: {listed}."),
        *_wrapped(
            "The caller keeps its state w, from -1 to 1, an entry for every joint: zeros at first,"
            f" then what {name}_pre_sliding makes of it whenever joints have moved by dq; of joints"
            " that turn at constant velocity, qd times the interval. This is exact where each joint"
            " goes one way."
        ),
    ]


def _joint_names(network: CSLC) -> list[str]:
    return [_plain(label) for label in network.output_labels]


def _plain(text: str) -> str:
    """For a comment: what would end it, or is not ASCII, is replaced."""
    text = text.replace("²", "^2").replace("³", "^3").replace("*/", "* /").replace("\n", " ")
    text = text.encode("ascii", "replace").decode().replace("/*", "/ *")
    return re.sub(r"\?(?=\?)", "? ", text)  # of "???/", too, no trigraph is left


def _wrapped(text: str) -> list[str]:
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) > _COMMENT_WIDTH:
            lines.append("")
        lines[-1] += f"{' ' if lines[-1] else ''}{word}"
    return lines
