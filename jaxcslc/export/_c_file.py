import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..codegen import Value
from ..network import CSLC
from ._c_functions import CFunction
from ._c_text import definitions, statements


_WIDTH = 100  # of a line of declarations [characters]
_COMMENT_WIDTH = 95


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
    lines += sorted({text for function in functions for text in definitions(function.graph)})
    for function in functions:
        lines += [
            f"/* {function.operation.summary} {function.cost} operations. */",
            _signature(name, network.joint_count, function),
            "{",
            *_unused(function),
            *statements(function.graph, _assignments(function)),
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


def _assignments(function: CFunction) -> list[tuple[str, Value]]:
    return [(f"{function.operation.output}[{i}]", x) for i, x in enumerate(function.values)]


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
