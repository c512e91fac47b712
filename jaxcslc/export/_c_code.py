import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float

from ..identification.friction import checked_lengths
from ..network import CSLC
from ._c_file import header_file, source_file
from ._c_functions import c_functions


_RESERVED = {
    *("auto", "break", "case", "char", "const", "continue", "default", "do"),
    *("double", "else", "enum", "extern", "float", "for", "goto", "if"),
    *("inline", "int", "long", "register", "restrict", "return", "short", "signed"),
    *("sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void"),
    *("volatile", "while"),
    "math",  # its header would stand before <math.h> where its folder is searched
}


@dataclass(frozen=True)
class CCode:
    """C99 for one robot with one set of coefficients.

    **Attributes**

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


def c_code(
    network: CSLC,
    k: Float[Array | np.ndarray, " coefficients"],
    *,
    name: str | None = None,
    lengths: Float[Array | np.ndarray, " joints"] | None = None,
) -> CCode:
    """Self-contained C99 for torque, mass matrix, gravity and regressor.

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

    With `lengths`, torque and regressor take states `const double w[n]` of contacts before their
    output, and the caller, who keeps them, updates them by

        void NAME_pre_sliding(const double dq[n], const double w[n], double next[n])

    with what joints have moved by, as `identification.pre_sliding` does.

    **Arguments**

    - `network`, `k`: (p,) its coefficients, such as `fit.k`.
    - `name`: a C identifier; made of the robot's name if omitted.
    - `lengths`: (n,) of pre-sliding [rad or m], 0 where dry friction follows the sign of velocity,
      such as `report.pre_sliding.lengths` beside `k=report.pre_sliding.fit.k`; zeros if None.

    **Returns**

    - The code, and how many operations its functions need.

    **Raises**

    - `ValueError`: for a name that is no C identifier or is `math`, for coefficients that are not
      finite or not p, for lengths that are not n from 0 up, or of joints without dry friction, and
      for numbers so large, or lengths so small, that constants of the code overflow.

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
    if values.shape != (network.size,):
        raise ValueError(
            f"k: expected {network.size} finite coefficients, got an array of {values.shape}"
        )
    if not np.all(np.isfinite(values)):
        raise ValueError(
            f"k: expected {network.size} finite coefficients, got an array of {values.shape}"
            " that are not all finite"
        )
    name = identifier(network.robot.name) if name is None else name
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or name in _RESERVED:
        raise ValueError(f"name: expected a C identifier, got {name!r}")
    sizes = checked_lengths(network, np.zeros(network.joint_count) if lengths is None else lengths)
    functions = c_functions(network, values, sizes)
    return CCode(
        name,
        header_file(name, network, functions, sizes),
        source_file(name, network, values, functions),
        {function.operation.name: function.cost for function in functions},
    )


def identifier(text: str) -> str:
    """A C identifier that reads like a name: `puma_560` of `PUMA 560`."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return name if name[:1].isalpha() and name not in _RESERVED else f"robot_{name}".rstrip("_")
