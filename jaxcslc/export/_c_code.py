import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from jaxtyping import Array, Float

from ..derivation import BODY
from ..inertia import body_map
from ..network import CSLC
from ._c_friction import coupled_inertias, friction_entries
from ._c_payload import payload_bodies
from ._c_text import definitions, statements
from ._closed_form import ClosedForm
from ._expressions import Expressions, Value
from ._rigid_bodies import RigidBodies


# Coefficients that bodies can have are reproduced by bodies to this part of the largest.
_ROUNDING = 1e-13
_RESERVED = {
    *("auto", "break", "case", "char", "const", "continue", "default", "do"),
    *("double", "else", "enum", "extern", "float", "for", "goto", "if"),
    *("inline", "int", "long", "register", "restrict", "return", "short", "signed"),
    *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void"),
    *("volatile", "while"),
}


@dataclass(frozen=True)
class CCode:
    """C99 for one robot with one set of coefficients.

    - `name`: what every function's name begins with.
    - `header`, `source`: contents of `NAME.h` and `NAME.c`.
    - `operations`: additions, multiplications and function calls of each function.

    >>> import numpy as np, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> code = jc.c_code(network, np.array([0.5, 0.3, -0.1, 0.2, 0.05]), name="arm")
    >>> "void arm_gravity(const double q[1], double tau[1]);" in code.header
    True
    """

    name: str
    header: str
    source: str
    operations: dict[str, int]


@dataclass(frozen=True)
class _Function:
    name: str
    what: str
    inputs: tuple[str, ...]
    output: str
    size: str
    graph: Expressions
    values: list[tuple[str, Value]]


def c_code(
    network: CSLC, k: Float[Array | np.ndarray, " coefficients"], *, name: str | None = None
) -> CCode:
    """Self-contained C99 for torque, mass matrix, gravity and regressor.

    Straight-line functions of joint positions, velocities and accelerations: no allocation, no
    state, nothing but `math.h`. The coefficients are numbers in the text; sines, cosines and all
    common products are computed once. Rigid-body torque comes from Newton-Euler recursion
    over the coefficients, unrolled for this robot, or from the closed form, whichever needs fewer
    operations; friction, offsets, springs and couplings are all of the network's. A payload
    (`network.with_payload()`) is one body with the link that carries it.

    Functions, for n joints and p coefficients:

        void NAME_torque(const double q[n], const double qd[n], const double qdd[n], double tau[n])
        void NAME_mass_matrix(const double q[n], double mass[n * n])             row by row
        void NAME_gravity(const double q[n], double tau[n])
        void NAME_regressor(const double q[n], const double qd[n], const double qdd[n],
                            double regressor[n * p])                            row by row

    **Arguments**

    - `network`, `k`: (p,) its coefficients, such as `fit.k`.
    - `name`: a C identifier; made of the robot's name if omitted.

    **Raises**

    - `ValueError`: for a name that is no C identifier, and for coefficients that are not finite
      or not p.

    >>> import jax.numpy as jnp, jaxcslc as jc
    >>> pendulum = jc.Manipulator.from_modified_dh([(0, 0, 0, 0)], gravity=(0, -9.81, 0))
    >>> network = jc.derive(pendulum, lengths="numeric")
    >>> code = jc.c_code(network, jnp.array([0.5, 0.3, 0.0, 0.2, 0.05]), name="pendulum")
    >>> print(code.source[code.source.index("void pendulum_gravity"):].split(chr(10) * 2)[0])
    void pendulum_gravity(const double q[1], double tau[1])
    {
        tau[0] = cos(q[0]) * 2.943;
    }
    """
    values = np.asarray(k, float)
    if values.shape != (network.size,) or not np.all(np.isfinite(values)):
        raise ValueError(
            f"k: expected {network.size} finite coefficients, got an array of {values.shape}"
            + ("" if values.shape != (network.size,) else " that are not all finite")
        )
    name = identifier(network.robot.name) if name is None else name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name in _RESERVED:
        raise ValueError(f"name: expected a C identifier, got {name!r}")
    functions = _functions(network, values)
    return CCode(
        name,
        _header(name, network, functions),
        _source(name, network, values, functions),
        {f.name: f.graph.cost(value for _, value in f.values) for f in functions},
    )


def identifier(text: str) -> str:
    """A C identifier that reads like a name: `puma_560` of `PUMA 560`."""
    word = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return word if word[:1].isalpha() and word not in _RESERVED else f"robot_{word}".rstrip("_")


def _functions(network: CSLC, k: Float[np.ndarray, " coefficients"]) -> list[_Function]:
    n, p = network.joint_count, network.size
    inertial = k[: len(network.algebra.coefficients)]
    load = payload_bodies(network, k)
    given = _bodies(network, inertial)
    if given is not None:
        given = given[0] + load, given[1]
    tables = network.algebra.lengths != "numeric" or hasattr(network.evaluator, "ring")

    def cheapest(
        of_bodies: Callable[[RigidBodies, np.ndarray, np.ndarray], list[tuple[str, Value]]],
        of_tables: Callable[[ClosedForm], list[tuple[str, Value]]],
        *,
        bodies_only: bool = False,
    ) -> tuple[Expressions, list[tuple[str, Value]]]:
        found: list[tuple[Expressions, list[tuple[str, Value]]]] = []
        if given is not None:
            graph = Expressions()
            found.append((graph, of_bodies(RigidBodies(graph, network.robot), *given)))
        if given is None or (tables and not bodies_only):
            graph = Expressions()
            found.append((graph, of_tables(ClosedForm(graph, network.algebra))))
        return min(found, key=lambda way: way[0].cost(value for _, value in way[1]))

    def loaded(closed: ClosedForm, own: list[Value], of: Callable[[RigidBodies], list[Value]]):
        """What the tables say, which have no payload, and what it adds."""
        if not np.any(load):
            return own
        added = of(RigidBodies(closed.graph, network.robot))
        return [x + y for x, y in zip(own, added, strict=True)]

    def torque_of(dynamics: RigidBodies | ClosedForm, rigid: list[Value]):
        graph = dynamics.graph
        for joint, place, value in friction_entries(
            network, graph, dynamics.q, dynamics.qd, dynamics.qdd
        ):
            rigid[joint] = rigid[joint] + value * float(k[place])
        return _vector("tau", rigid)

    def mass_of(rows: list[list[Value]]):
        for i, j, value in coupled_inertias(network, k):
            rows[i][j] = rows[i][j] + value
            rows[j][i] = rows[i][j]
        return _matrix("mass", rows)

    def regressor_of(dynamics: RigidBodies | ClosedForm, rows: list[list[Value]]):
        zero = dynamics.graph.constant(0.0)
        wide = [[*row, *([zero] * (p - len(row)))] for row in rows]
        for joint, place, value in friction_entries(
            network, dynamics.graph, dynamics.q, dynamics.qd, dynamics.qdd
        ):
            wide[joint][place] = wide[joint][place] + value
        if network.carrying_link is not None:
            link = network.carrying_link - 1
            rigid = RigidBodies(dynamics.graph, network.robot)
            for row, own in zip(wide, rigid.columns([(link, x) for x in np.eye(10)]), strict=True):
                row[p - 10 :] = own
        return _matrix("regressor", wide)

    motion, still, column = ("q", "qd", "qdd"), np.zeros(n), _unit_columns(network)
    torque = cheapest(
        lambda rigid, bodies, motors: torque_of(rigid, rigid.torque(bodies, motors)),
        lambda closed: torque_of(
            closed, loaded(closed, closed.torque(inertial), lambda x: x.torque(load, still))
        ),
    )
    mass = cheapest(
        lambda rigid, bodies, motors: mass_of(rigid.mass_matrix(bodies, motors)),
        lambda closed: mass_of(
            [
                loaded(closed, row, lambda x, i=i: x.mass_matrix(load, still)[i])
                for i, row in enumerate(closed.mass_matrix(inertial))
            ]
        ),
    )
    gravity = cheapest(
        lambda rigid, bodies, motors: _vector("tau", rigid.gravity(bodies)),
        lambda closed: _vector(
            "tau", loaded(closed, closed.gravity(inertial), lambda x: x.gravity(load))
        ),
    )
    if column is None:
        graph = Expressions()
        closed = ClosedForm(graph, network.algebra)
        regressor = graph, regressor_of(closed, closed.columns())
    else:
        graph = Expressions()
        rigid = RigidBodies(graph, network.robot)
        regressor = graph, regressor_of(rigid, _columns(rigid, *column))
        if tables:
            graph = Expressions()
            closed = ClosedForm(graph, network.algebra)
            other = graph, regressor_of(closed, closed.columns())
            regressor = min(
                regressor, other, key=lambda way: way[0].cost(value for _, value in way[1])
            )
    n_text, square, wide = str(n), str(n * n), str(n * p)
    return [
        _Function("torque", "Torque of every joint.", motion, "tau", n_text, *torque),
        _Function("mass_matrix", "Mass matrix, row by row.", ("q",), "mass", square, *mass),
        _Function("gravity", "Torque that gravity takes.", ("q",), "tau", n_text, *gravity),
        _Function(
            "regressor",
            "What the coefficients are multiplied by: joint by joint, one entry a coefficient.",
            motion,
            "regressor",
            wide,
            *regressor,
        ),
    ]


def _bodies(
    network: CSLC, inertial: Float[np.ndarray, " inertial"]
) -> tuple[Float[np.ndarray, "links 10"], Float[np.ndarray, " links"]] | None:
    """Ten numbers a link and motor inertias that have these coefficients, most of them zero.

    They need not be possible bodies: what is regrouped into a base parameter is zero. None if no
    numbers have them: symbolic coefficients that were identified one by one rarely belong
    together.
    """
    of_bodies, of_motors = body_map(network.algebra)
    n = network.joint_count
    bodies, motors = np.zeros((n, 10)), np.zeros(n)
    columns = _unit_columns(network)
    if columns is not None:
        for (link, body), place in zip(*columns[:2], strict=True):
            bodies[link] += inertial[place] * body
        for joint, place in columns[2]:
            motors[joint] += inertial[place]
        return bodies, motors
    matrix = np.concatenate([of_bodies.reshape(len(inertial), -1), of_motors], axis=1)
    # A basic solution: as many numbers as the matrix has rank. Later ones are preferred last.
    _, triangle, order = scipy.linalg.qr(matrix, mode="economic", pivoting=True)
    diagonal = np.abs(np.diag(triangle))
    rank = int(np.sum(diagonal > 1e-10 * diagonal[0]))
    basic = np.linalg.lstsq(matrix[:, order[:rank]], inertial)[0]
    numbers = np.zeros(matrix.shape[1])
    numbers[order[:rank]] = basic
    if np.max(np.abs(matrix @ numbers - inertial)) > _ROUNDING * np.max(np.abs(inertial)):
        return None
    return numbers[: 10 * n].reshape(n, 10), numbers[10 * n :]


def _unit_columns(
    network: CSLC,
) -> tuple[list[tuple[int, Float[np.ndarray, "10"]]], list[int], list[tuple[int, int]]] | None:
    """For numeric lengths, the body that each coefficient alone is: (link, ten numbers) and place
    in `k`; motors as (joint, place). Torque is what the chosen link parameters alone produce."""
    algebra = network.algebra
    if algebra.lengths != "numeric":
        return None
    directions: list[tuple[int, np.ndarray]] = []
    places: list[int] = []
    motors: list[tuple[int, int]] = []
    for place, index in enumerate(algebra.chosen):
        term = algebra.terms[index]
        if term.factors == ("motor",):
            motors.append((term.link, place))
            continue
        body = np.zeros(10)
        for entry, multiple in term.body:
            body[BODY.index(entry)] += multiple
        directions.append((term.link, body))
        places.append(place)
    return directions, places, motors


def _columns(
    rigid: RigidBodies,
    directions: list[tuple[int, Float[np.ndarray, "10"]]],
    places: list[int],
    motors: list[tuple[int, int]],
) -> list[list[Value]]:
    found = rigid.columns(directions)
    zero = rigid.graph.constant(0.0)
    rows = [[zero] * (len(places) + len(motors)) for _ in found]
    for row, own in zip(rows, found, strict=True):
        for place, value in zip(places, own, strict=True):
            row[place] = value
    for joint, place in motors:
        rows[joint][place] = rigid.qdd[joint]
    return rows


def _vector(target: str, values: Sequence[Value]) -> list[tuple[str, Value]]:
    return [(f"{target}[{i}]", value) for i, value in enumerate(values)]


def _matrix(target: str, rows: Sequence[Sequence[Value]]) -> list[tuple[str, Value]]:
    return _vector(target, [value for row in rows for value in row])


def _signature(name: str, n: int, function: _Function) -> str:
    inputs = ", ".join(f"const double {argument}[{n}]" for argument in function.inputs)
    text = f"void {name}_{function.name}({inputs}, double {function.output}[{function.size}])"
    if len(text) <= 100:
        return text
    return text.replace(f", double {function.output}", f",\n    double {function.output}")


def _header(name: str, network: CSLC, functions: list[_Function]) -> str:
    guard = f"{name.upper()}_H"
    n = network.joint_count
    lines = [f"#ifndef {guard}", f"#define {guard}", "", "/*", *_about(network), "*/", ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for function in functions:
        lines += [f"/* {function.what} */", f"{_signature(name, n, function)};", ""]
    lines += ["#ifdef __cplusplus", "}", "#endif", "", "#endif"]
    return "\n".join(lines) + "\n"


def _source(
    name: str,
    network: CSLC,
    k: Float[np.ndarray, " coefficients"],
    functions: list[_Function],
) -> str:
    lines = [
        "/*",
        *_about(network),
        "",
        "Coefficients, in the order of the regressor's columns:",
        "",
    ]
    width = max(len(c.name) for c in network.coefficients)
    for c, value in zip(network.coefficients, k, strict=True):
        lines.append(f"  {c.name:<{width}} = {value:.17g} {_plain(c.unit)}")
    lines += ["*/", "", "#include <math.h>", "", f'#include "{name}.h"', ""]
    used = {text for function in functions for text in definitions(function.graph)}
    lines += [text for text in sorted(used)]
    for function in functions:
        cost = function.graph.cost(value for _, value in function.values)
        lines += [
            f"/* {function.what} {cost} operations. */",
            _signature(name, network.joint_count, function),
            "{",
            *_unused(function),
            *statements(function.graph, function.values),
            "}",
            "",
        ]
    return "\n".join(lines)


def _unused(function: _Function) -> list[str]:
    """What a robot's torque does not depend on, said so that compilers do not warn."""
    needed = function.graph.needed(value for _, value in function.values)
    texts = {function.graph.operations[index].text.partition("[")[0] for index in needed}
    return [f"    (void){argument};" for argument in function.inputs if argument not in texts]


def _about(network: CSLC) -> list[str]:
    robot = network.robot
    kinds = ", ".join(
        f"{joint} {'revolute [rad, N m]' if kind == 'R' else 'prismatic [m, N]'}"
        for joint, kind in zip(_joint_names(network), robot.kinds, strict=True)
    )
    return [
        f"Inverse dynamics of {_plain(robot.name)}, written by jaxcslc.",
        "",
        *_wrapped(f"Joints, in order: {kinds}."),
        "Positions q, velocities qd [1/s] and accelerations qdd [1/s^2] of every joint.",
        f"{network.size} coefficients, lengths {network.algebra.lengths}.",
    ]


def _joint_names(network: CSLC) -> list[str]:
    source = getattr(network.robot, "source", None)
    names = getattr(source, "joints", ()) or range(1, network.joint_count + 1)
    return [_plain(str(name)) for name in names]


def _plain(text: str) -> str:
    """For a comment: what would end it, or is not ASCII, is replaced."""
    text = text.replace("²", "^2").replace("³", "^3").replace("*/", "* /").replace("\n", " ")
    return text.encode("ascii", "replace").decode().replace("??", "? ?").replace("/*", "/ *")


def _wrapped(text: str) -> list[str]:
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + len(word) > 95:
            lines.append("")
        lines[-1] += f"{' ' if lines[-1] else ''}{word}"
    return lines
