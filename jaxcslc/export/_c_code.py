"""C99 for a robot: what each function computes, and the text of header and source."""

import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Array, Float

from .._scratch import all_together
from ..codegen import (
    Expressions,
    KernelText,
    Motion,
    Value,
    comment_text,
    identifier,
    is_identifier,
)
from ..friction import checked_distance, state_after
from ..network import CSLC, ExpressionFunctions
from ._rigid_body import RigidBodies, rigid_bodies


def input_entries(
    network: CSLC, motion: Motion, contacts: Mapping[int, Value]
) -> list[tuple[int, int, Value]]:
    """Return the regressor's entries that are not the rigid body's: joint, coefficient and value.

    They are of friction, offsets, springs and coupled joints. `contacts` has, by joint, the state
    that replaces the sign of dry friction.
    """
    entries: list[tuple[int, int, Value]] = []
    for term in network.input_terms:
        indices = network.layout.indices(term.kind).tolist()
        states = contacts if term.kind == "dry" else {}
        entries += [
            (joint, indices[i], states.get(joint, value))
            for joint, i, value in term.entries(motion)
        ]
    return entries


def input_inertias(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> list[tuple[int, int, float]]:
    """Return what other terms than the rigid body add to the mass matrix: row, column and value.

    Entries are on and above the diagonal.
    """
    entries: list[tuple[int, int, float]] = []
    for term in network.input_terms:
        total = np.tensordot(k[network.layout.term_slice(term)], term.inertia_matrices, 1)
        entries += [
            (int(i), int(j), float(total[i, j]))
            for i, j in zip(*np.triu_indices(len(total)), strict=True)
            if total[i, j]
        ]
    return entries


@dataclass(frozen=True)
class Dynamics:
    """Network with coefficients, and one way to compute its operations.

    **Attributes**

    - `network`, `k`: (p,) its coefficients.
    - `motion`: the joints' positions, velocities and accelerations.
    - `rigid_body`: the rigid-body part, payload included.
    - `presliding_distance`: (n,) [rad or m]; 0 where dry friction follows the sign of velocity.
    """

    network: CSLC
    k: Float[np.ndarray, " coefficients"]
    motion: Motion
    rigid_body: RigidBodies
    presliding_distance: Float[np.ndarray, " joints"]

    @property
    def contacts(self) -> dict[int, Value]:
        """State of each pre-sliding contact, by joint."""
        joints = np.flatnonzero(self.presliding_distance).tolist()
        return {joint: self.motion.graph.input(f"w[{joint}]") for joint in joints}


def torque(dynamics: Dynamics) -> list[Value]:
    total = dynamics.rigid_body.torque()
    entries = input_entries(dynamics.network, dynamics.motion, dynamics.contacts)
    for joint, index, value in entries:
        total[joint] = total[joint] + value * float(dynamics.k[index])
    return total


def mass_matrix(dynamics: Dynamics) -> list[Value]:
    rows = dynamics.rigid_body.mass_matrix()
    for i, j, value in input_inertias(dynamics.network, dynamics.k):
        rows[i][j] = rows[i][j] + value
        rows[j][i] = rows[i][j]
    return [value for row in rows for value in row]


def gravity(dynamics: Dynamics) -> list[Value]:
    return dynamics.rigid_body.torque(("gravity",))


def regressor(dynamics: Dynamics) -> list[Value] | None:
    network, motion = dynamics.network, dynamics.motion
    rigid = dynamics.rigid_body.regressor()
    if rigid is None:
        return None
    layout = network.layout
    rows = [[motion.graph.constant(0.0)] * layout.size for _ in rigid]
    inertial = layout.inertial.stop
    for row, values in zip(rows, rigid, strict=True):
        row[layout.inertial], row[layout.payload] = values[:inertial], values[inertial:]
    for joint, index, value in input_entries(network, motion, dynamics.contacts):
        rows[joint][index] = rows[joint][index] + value
    return [value for row in rows for value in row]


def pre_sliding(dynamics: Dynamics) -> list[Value]:
    motion, functions = dynamics.motion, ExpressionFunctions(dynamics.motion)
    states = [motion.graph.constant(0.0)] * dynamics.network.joint_count
    for joint, w in dynamics.contacts.items():
        change = motion.graph.input(f"dq[{joint}]")
        states[joint] = state_after(
            w, change, float(dynamics.presliding_distance[joint]), functions
        )
    return states


@dataclass(frozen=True)
class RobotFunction:
    """Function of the C code.

    **Attributes**

    - `name`: of the function, after the robot's.
    - `summary`: the comment above it.
    - `inputs`: which of `q`, `qd`, `qdd` it takes.
    - `output`: name of the array that it fills.
    - `values`: of that array; None where `Dynamics.rigid_body` cannot say.
    - `has_friction`: whether it takes states of contacts, too, where there are any.
    """

    name: str
    summary: str
    inputs: tuple[str, ...]
    output: str
    values: Callable[[Dynamics], list[Value] | None]
    has_friction: bool = False


OPERATIONS = (
    RobotFunction(
        "torque", "Torque of every joint.", ("q", "qd", "qdd"), "tau", torque, has_friction=True
    ),
    RobotFunction("mass_matrix", "Mass matrix, row by row.", ("q",), "mass", mass_matrix),
    RobotFunction("gravity", "Torque of every joint against gravity.", ("q",), "tau", gravity),
    RobotFunction(
        "regressor",
        "What the coefficients are multiplied by: joint by joint, one entry a coefficient.",
        ("q", "qd", "qdd"),
        "regressor",
        regressor,
        has_friction=True,
    ),
)
"""Functions of the C code of every network: a new function is one entry and what computes it."""

STATE_OPERATIONS = (
    RobotFunction(
        "pre_sliding",
        "States of contacts after joints moved by dq. Both states may be one array.",
        ("dq", "w"),
        "next",
        pre_sliding,
    ),
)
"""Functions of networks with pre-sliding friction."""


@dataclass(frozen=True)
class ExportedFunction:
    """An operation with its inputs and expressions."""

    operation: RobotFunction
    inputs: tuple[str, ...]
    graph: Expressions
    values: list[Value]

    @property
    def cost(self) -> int:
        """Additions, multiplications and calls of functions."""
        return self.graph.cost(self.values)

    @property
    def is_finite(self) -> bool:
        """True if all constants are numbers that C can write."""
        operations = self.graph.operations
        return all(np.isfinite(operations[i].number) for i in self.graph.needed(self.values))


def c_functions(
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    presliding_distance: Float[np.ndarray, " joints"],
) -> list[ExportedFunction]:
    """Return every function, computed in the way that needs the fewest operations."""
    ways = list(rigid_bodies(network, k))
    yields = bool(np.any(presliding_distance))
    functions: list[ExportedFunction] = []
    for operation in (*OPERATIONS, *(STATE_OPERATIONS if yields else ())):
        inputs = (*operation.inputs, *(("w",) if yields and operation.has_friction else ()))
        candidates: list[ExportedFunction] = []
        for rigid_body in ways:
            motion = Motion(network.joint_count)
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                values = operation.values(
                    Dynamics(network, k, motion, rigid_body(motion), presliding_distance)
                )
            if values is not None:
                candidates.append(ExportedFunction(operation, inputs, motion.graph, values))
        function = min(candidates, key=lambda candidate: candidate.cost)
        if not function.is_finite:
            raise ValueError(
                f"{operation.name}: a constant overflows; expected coefficients and distances whose"
                " products and reciprocals are finite numbers"
            )
        functions.append(function)
    return functions


_WIDTH = 100  # of a line of declarations [characters]
_COMMENT_WIDTH = 96  # of a line of comments [characters]
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
    functions: Sequence[ExportedFunction],
    presliding_distance: Float[np.ndarray, " joints"],
) -> str:
    """Return the declarations: contents of `NAME.h`."""
    guard = f"{name.upper()}_H"
    lines = [f"#ifndef {guard}", f"#define {guard}", "", "/*"]
    lines += [*_about(network), *_about_states(name, network, presliding_distance), "*/", ""]
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
    functions: Sequence[ExportedFunction],
) -> str:
    """Return the definitions: contents of `NAME.c`."""
    lines = ["/*", *_about(network), ""]
    lines += ["Coefficients, in the order of the regressor's columns:", ""]
    width = max(len(c.name) for c in network.coefficients)
    for c, value in zip(network.coefficients, k, strict=True):
        lines.append(f"  {c.name:<{width}} = {value:.17g} {comment_text(c.unit)}")
    lines += ["*/", "", "#include <math.h>", "", f'#include "{name}.h"', ""]
    used = {operation.name for function in functions for operation in function.graph.operations}
    lines += sorted(text for name, text in _DEFINITIONS.items() if name in used)
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


def _signature(name: str, joints: int, function: ExportedFunction) -> str:
    operation, size = function.operation, len(function.values)
    inputs = ", ".join(f"const double {argument}[{joints}]" for argument in function.inputs)
    text = f"void {name}_{operation.name}({inputs}, double {operation.output}[{size}])"
    if len(text) <= _WIDTH:
        return text
    return text.replace(f", double {operation.output}", f",\n    double {operation.output}")


def _statements(function: ExportedFunction) -> list[str]:
    output = function.operation.output
    stores = [(x, f"{output}[{i}] = {{0}};") for i, x in enumerate(function.values)]
    text = KernelText(function.graph, lambda x: x.text or None, _CALLS, constant="{0!r}")
    return [f"    {line}" for line in text.nested_statements(stores, _LONGEST)]


def _unused(function: ExportedFunction) -> list[str]:
    """Return statements that keep compilers from warning of inputs that nothing depends on."""
    needed = function.graph.needed(function.values)
    used = {function.graph.operations[index].text.partition("[")[0] for index in needed}
    return [f"    (void){name};" for name in function.inputs if name not in used]


def _about(network: CSLC) -> list[str]:
    robot = network.robot
    kinds = ", ".join(
        f"{comment_text(label)} {'revolute [rad, N m]' if kind == 'R' else 'prismatic [m, N]'}"
        for label, kind in zip(network.output_labels, network.joint_kinds, strict=True)
    )
    return [
        f"Inverse dynamics of {comment_text(robot.name)}, written by jaxcslc.",
        "",
        *_wrapped(f"Joints, in order: {kinds}."),
        "Positions q, velocities qd [1/s] and accelerations qdd [1/s^2] of every joint.",
        f"{network.size} coefficients, lengths {network.algebra.lengths}.",
    ]


def _about_states(
    name: str, network: CSLC, presliding_distance: Float[np.ndarray, " joints"]
) -> list[str]:
    """Explain the use of states of contacts, where there are any."""
    if not np.any(presliding_distance):
        return []
    units = {"R": "rad", "P": "m"}
    listed = ", ".join(
        f"{comment_text(joint)} {length:.6g} {units[kind]}"
        for joint, kind, length in zip(
            network.output_names, network.joint_kinds, presliding_distance, strict=True
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


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, _COMMENT_WIDTH, break_long_words=False, break_on_hyphens=False)


@dataclass(frozen=True)
class CCode:
    """C99 for one robot with one set of coefficients.

    **Attributes**

    - `name`: what every function's name begins with.
    - `header`, `source`: contents of `NAME.h` and `NAME.c`.
    - `operations`: additions, multiplications and function calls of each function.

    >>> import numpy as np, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> code = jc.c_code(network, np.array([0.5, 0.3, -0.1, 0.2, 0.05]), name="arm")
    >>> "void arm_gravity(const double q[1], double tau[1]);" in code.header
    True
    """

    name: str
    header: str
    source: str
    operations: dict[str, int]


def c_code(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    *,
    name: str | None = None,
    presliding_distance: Float[Array | np.ndarray, " joints"] | None = None,
) -> CCode:
    """Write self-contained C99 for torque, mass matrix, gravity and regressor.

    Straight-line functions of joint positions, velocities and accelerations: no allocation, no
    state of their own, nothing but `math.h`. The coefficients are numbers in the text; sines,
    cosines and all common products are computed once. Rigid-body torque comes from Newton-Euler
    recursion over the coefficients, unrolled for this robot, or from the closed form, whichever
    needs fewer operations; friction, offsets, springs and couplings are all of the network's. A
    payload (`network.with_payload()`) is one body with the link that carries it.

    Functions, for n joints and p coefficients:

        void NAME_torque(const double q[n], const double qd[n], const double qdd[n], double tau[n])
        void NAME_mass_matrix(const double q[n], double mass[n * n])             row by row
        void NAME_gravity(const double q[n], double tau[n])
        void NAME_regressor(const double q[n], const double qd[n], const double qdd[n],
                            double regressor[n * p])                            row by row

    With `presliding_distance`, torque and regressor take states `const double w[n]` of contacts
    before their output, and the caller, who keeps them, updates them by

        void NAME_pre_sliding(const double dq[n], const double w[n], double next[n])

    with what joints have moved by, as `jaxcslc.friction.contact_states` does.

    **Arguments**

    - `network`, `k`: (p,) its coefficients, such as `fit.k`.
    - `name`: a C identifier; made of the robot's name if omitted.
    - `presliding_distance`: (n,) [rad or m], 0 where dry friction follows the sign of velocity,
      such as `report.pre_sliding.presliding_distance` beside `k=report.pre_sliding.fit.k`; zeros if
      None.

    **Returns** the code, and how many operations its functions need.

    **Raises**

    - `ValueError`: for a name that is no C identifier or is `math`, for coefficients that are not
      finite or not p, for distances that are not n from 0 up, or of joints without dry friction,
      and for numbers so large, or distances so small, that constants of the code overflow.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    >>> code = jc.c_code(network, jnp.array([0.5, 0.3, 0.0, 0.2, 0.05]), name="pendulum")
    >>> print(code.source[code.source.index("void pendulum_gravity"):].split(chr(10) * 2)[0])
    void pendulum_gravity(const double q[1], double tau[1])
    {
        tau[0] = cos(q[0]) * 2.943;
    }
    """
    values = np.asarray(k, float)
    if values.shape != (network.size,) or not np.all(np.isfinite(values)):
        kind = " that are not all finite" if values.shape == (network.size,) else ""
        raise ValueError(
            f"k: expected {network.size} finite coefficients, got an array of {values.shape}{kind}"
        )
    name = identifier(network.robot.name) if name is None else name
    if not is_identifier(name):
        raise ValueError(f"name: expected a C identifier, got {name!r}")
    sizes = checked_distance(
        network,
        np.zeros(network.joint_count) if presliding_distance is None else presliding_distance,
    )
    functions = c_functions(network, values, sizes)
    return CCode(
        name,
        header_file(name, network, functions, sizes),
        source_file(name, network, values, functions),
        {function.operation.name: function.cost for function in functions},
    )


def write_c(code: CCode, path: str | Path | None = None) -> tuple[Path, Path]:
    """Write C code as a source file and the header that it includes.

    **Arguments**

    - `code`: from `c_code`.
    - `path`: of the source file; by default the code's name in the current folder.

    **Returns** the paths of source and header.

    **Raises**

    - `ValueError`: a name that does not end in .c, or that no `#include` can hold.
    - `OSError`: the files cannot be written.
    """
    source = Path(f"{code.name}.c" if path is None else path)
    if source.suffix != ".c":
        raise ValueError(f"{source}: expected a name ending in .c")
    if not re.fullmatch(r"[\w.+\- ]+", source.name, re.ASCII):
        raise ValueError(
            f"{source}: C code includes its header by name: expected letters, digits,"
            " '.', '_', '+', '-' and spaces"
        )
    header = source.with_suffix(".h")
    # The source includes its header by name.
    text = code.source.replace(f'#include "{code.name}.h"', f'#include "{header.name}"')
    source.parent.mkdir(parents=True, exist_ok=True)
    with all_together([header, source]) as (header_file, source_file):
        header_file.write_text(code.header, encoding="ascii")
        source_file.write_text(text, encoding="ascii")
    return source, header
