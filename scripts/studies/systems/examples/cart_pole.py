"""A cart with a pole that swings, with friction in the hinge; MuJoCo computes the truth."""

from collections.abc import Sequence

import mujoco
import numpy as np
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc.systems import Constant, System, Variable, lagrange_equations
from scripts.studies.systems.example import Example
from scripts.studies.systems.mujoco_runs import run
from scripts.studies.systems.signals import Columns, Multisine, generator


TRUTH = {
    "M": 1.0,  # mass of the cart [kg]
    "m": 0.25,  # of the pole [kg]
    "l": 0.3,  # from the hinge to its centre of gravity [m]
    "J": 8e-3,  # its inertia about the centre of gravity [kg m²]
    "b": 0.6,  # viscous friction of the rail [N s/m]
    "v": 3e-3,  # viscous friction of the hinge [N m s]
    "d": 8e-3,  # its dry friction [N m]
}
GRAVITY = 9.81
_STEP, _EVERY = 0.002, 2
_RETURN = 3.0  # of the force to the cart's position, so that it stays on its rail [N/m]

# Dry friction is a soft constraint: with the shortest time constant that two steps allow, the hinge
# turns with all of it above some mrad/s.
_MODEL = f"""
<mujoco>
  <option timestep="{_STEP}" integrator="RK4" gravity="0 0 -{GRAVITY}"/>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0" damping="{TRUTH["b"]}"/>
      <inertial pos="0 0 0" mass="{TRUTH["M"]}" diaginertia="0.01 0.01 0.01"/>
      <body>
        <joint name="hinge" type="hinge" axis="0 -1 0" damping="{TRUTH["v"]}"
               frictionloss="{TRUTH["d"]}" solreffriction="{2 * _STEP} 1"/>
        <inertial pos="0 0 -{TRUTH["l"]}" mass="{TRUTH["m"]}"
                  diaginertia="{TRUTH["J"]} {TRUTH["J"]} 1e-4"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def simulate(seeds: Sequence[int], validation: bool) -> list[Columns]:
    """A random force, and a weak one back to the middle of the rail; the pole starts hanging."""
    stream = "validation force" if validation else "training force"
    force = Multisine.random(seeds, stream, (0.3, 2.0), 3.5, lines=10)
    model = mujoco.MjModel.from_xml_string(_MODEL)
    return [_recording(model, force, i, seed, stream, validation) for i, seed in enumerate(seeds)]


def _recording(
    model: mujoco.MjModel, force: Multisine, index: int, seed: int, stream: str, validation: bool
) -> Columns:
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0, generator(seed, stream + " angle").uniform(-1.0, 1.0)

    def push(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        del model
        data.qfrc_applied[0] = force(data.time)[index] - _RETURN * data.qpos[0]

    def observe(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        del model
        return np.array([data.time, *data.qpos, data.qfrc_applied[0]])

    duration = 5.0 if validation else 20.0
    rows = run(model, data, push, round(duration / _STEP), observe, every=_EVERY)
    return dict(zip(("time", "x", "theta", "F"), rows.T, strict=True))


def system() -> System:
    """Return the system from the Lagrangian; viscous friction by Rayleigh's function, dry friction
    as a force.
    """
    x, theta, F = dynamicsymbols("x theta F")
    t = dynamicsymbols._t
    M, m, l, J, b, v, d, g = sp.symbols("M m l J b v d g")
    xd, thetad = x.diff(t), theta.diff(t)
    # The pole's centre of gravity hangs l below the hinge, at angles forwards of it.
    east, up = x + l * sp.sin(theta), -l * sp.cos(theta)
    kinetic = M * xd**2 / 2 + m * (east.diff(t) ** 2 + up.diff(t) ** 2) / 2 + J * thetad**2 / 2
    return System(
        "cart-pole",
        lagrange_equations(
            kinetic - m * g * up,
            (x, theta),
            forces={x: F, theta: -d * sp.sign(thetad)},
            dissipation=b * xd**2 / 2 + v * thetad**2 / 2,
        ),
        variables=(Variable(x, unit="m"), Variable(theta, unit="rad"), Variable(F, unit="N")),
        constants=(
            Constant(M, unit="kg", sign="positive"),
            Constant(m, unit="kg", sign="positive"),
            Constant(l, unit="m", sign="positive"),
            Constant(J, unit="kg m²", sign="positive"),
            Constant(b, unit="N s/m", sign="positive"),
            Constant(v, unit="N m s", sign="positive"),
            Constant(d, unit="N m", sign="positive"),
            Constant(g, unit="m/s²", value=GRAVITY),
        ),
    )


CART_POLE = Example(
    name="cart-pole",
    source="Lagrangian; MuJoCo",
    description=system,
    truth=TRUTH,
    simulate=simulate,
    noise={"x": 1e-5, "theta": 2e-5, "F": 0.05},
    # Acceleration jumps where dry friction does: no window reaches over a reversal.
    settings=jc.Settings(
        jc.Preparation(jc.SavitzkyGolay(15, 5), threshold_fraction=0.05, reversal_margin=8),
        jc.LeastSquares(cutoff=14.0),
    ),
)
