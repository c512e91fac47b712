"""A quadrotor with drag and four rotors that have inertia; MuJoCo computes the truth.

Rotors are bodies of their own in MuJoCo, so that it computes their gyroscopic torques; thrust and
drag are applied as forces. Measured are the pose, as by cameras, and the speeds of the rotors.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc.systems import Constant, System, Variable
from scripts.studies.systems.example import Example
from scripts.studies.systems.mujoco_runs import run
from scripts.studies.systems.signals import Columns, Multisine


MASS, ARM, GRAVITY = 0.8, 0.17, 9.81
_ROTOR_MASS, _ROTOR_RADIAL = 0.01, 3e-5  # of a rotor [kg], about an axis across its own [kg m²]
_BODY = (4.5e-3, 5.0e-3, 8.5e-3)  # inertia without rotors [kg m²]
TRUTH = {
    # With the rotors as point masses at the ends of the arms, and turning with the body.
    "Jx": _BODY[0] + 2 * _ROTOR_MASS * ARM**2 + 4 * _ROTOR_RADIAL,
    "Jy": _BODY[1] + 2 * _ROTOR_MASS * ARM**2 + 4 * _ROTOR_RADIAL,
    "Jz": _BODY[2] + 4 * _ROTOR_MASS * ARM**2 + 4 * 6e-5,
    "Jr": 6e-5,  # a rotor about its axis [kg m²]
    "kf": 1.0e-5,  # thrust per squared speed [N s²]
    "km": 1.6e-7,  # torque of the air per squared speed [N m s²]
    "dx": 0.30,  # drag per speed along the body's axes [N s/m]
    "dy": 0.35,
    "dz": 0.45,
}
_STEP, _EVERY = 0.004, 1
_HOVER = float(np.sqrt(MASS * GRAVITY / 4 / TRUTH["kf"]))
# Two rotors turn to the left, two to the right.
_SENSE = np.array([1.0, -1.0, 1.0, -1.0])
_ARMS = ARM * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])

_ROTORS = "".join(
    f"""<body pos="{x} {y} 0"><joint name="rotor{i}" type="hinge" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{_ROTOR_MASS}"
                  diaginertia="{_ROTOR_RADIAL} {_ROTOR_RADIAL} {TRUTH["Jr"]}"/></body>"""
    for i, (x, y) in enumerate(_ARMS, 1)
)
_MODEL = f"""
<mujoco>
  <option timestep="{_STEP}" integrator="RK4" gravity="0 0 -{GRAVITY}"/>
  <worldbody>
    <body name="body"><freejoint/>
      <inertial pos="0 0 0" mass="{MASS - 4 * _ROTOR_MASS}"
                diaginertia="{_BODY[0]} {_BODY[1]} {_BODY[2]}"/>
      {_ROTORS}
    </body>
  </worldbody>
</mujoco>
"""


def simulate(seeds: Sequence[int], validation: bool) -> list[Columns]:
    """Attitude and height follow random references; the motion along the ground is left free."""
    stream = "validation " if validation else "training "
    bands = {"roll": (0.3, 1.5), "pitch": (0.35, 1.6), "yaw": (0.2, 1.0), "height": (0.1, 0.6)}
    sizes = {"roll": 0.25, "pitch": 0.25, "yaw": 0.5, "height": 0.4}
    references = [
        Multisine.random(seeds, stream + name, bands[name], sizes[name]) for name in bands
    ]
    model = mujoco.MjModel.from_xml_string(_MODEL)
    # 12 s have 8 stretches of independent noise: 94.1 % of coefficients within two standard errors.
    duration = 3.0 if validation else 30.0
    return [
        _recording(
            model,
            [
                Multisine(r.frequency, r.amplitude[i : i + 1], r.phase[i : i + 1])
                for r in references
            ],
            duration,
        )
        for i in range(len(seeds))
    ]


def _recording(model: mujoco.MjModel, references: Sequence[Multisine], duration: float) -> Columns:
    data = mujoco.MjData(model)
    data.qvel[6:] = _HOVER * _SENSE
    data.qpos[2] = 1.0

    def fly(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        del model
        rotors = data.qvel[6:]
        rotation = data.xmat[1].reshape(3, 3)
        thrust = TRUTH["kf"] * rotors**2
        drag = np.array([TRUTH["dx"], TRUTH["dy"], TRUTH["dz"]]) * (rotation.T @ data.qvel[:3])
        force = np.array([0.0, 0.0, np.sum(thrust)]) - drag
        torque = np.array(
            [
                _ARMS[:, 1] @ thrust,
                -_ARMS[:, 0] @ thrust,
                -TRUTH["km"] * np.sum(np.abs(rotors) * rotors),
            ]
        )
        data.xfrc_applied[1, :3] = rotation @ force
        data.xfrc_applied[1, 3:] = rotation @ torque
        data.qfrc_applied[6:] = 2e-3 * (_wanted_speeds(data, references) - rotors)

    def observe(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        del model
        return np.concatenate([[data.time], data.qpos[:3], _angles(data.qpos[3:7]), data.qvel[6:]])

    # The first second, in which it takes up the reference, is not recorded.
    rows = run(model, data, fly, round((1.0 + duration) / _STEP), observe, every=_EVERY)
    rows = rows[round(1.0 / _STEP / _EVERY) :]
    rows[:, 0] -= rows[0, 0]
    rows[:, 4:7] = np.unwrap(rows[:, 4:7], axis=0)
    names = ("time", "x", "y", "z", "roll", "pitch", "yaw", "w1", "w2", "w3", "w4")
    return dict(zip(names, rows.T, strict=True))


def _angles(quaternion: np.ndarray) -> np.ndarray:
    """Roll, pitch and yaw: about the body's x after its y after the world's z axis."""
    w, x, y, z = quaternion
    return np.array(
        [
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(2 * (w * y - z * x)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )


def _wanted_speeds(data: mujoco.MjData, references: Sequence[Multisine]) -> np.ndarray:
    """Return the wanted speeds of the rotors, by a PD controller of attitude and height."""
    roll, pitch, yaw, height = (float(reference(data.time)[0]) for reference in references)
    angles = _angles(data.qpos[3:7])
    rates = data.qvel[3:6]
    lift = MASS * (GRAVITY + 6.0 * (1.0 + height - data.qpos[2]) - 4.0 * data.qvel[2])
    moments = 0.6 * (np.array([roll, pitch, yaw]) - angles) - 0.1 * rates
    moments[2] *= 0.2
    thrust = lift / 4 + np.array(
        [
            -moments[1] / (2 * ARM),
            moments[0] / (2 * ARM),
            moments[1] / (2 * ARM),
            -moments[0] / (2 * ARM),
        ]
    )
    thrust = thrust - _SENSE * moments[2] / 4 * TRUTH["kf"] / TRUTH["km"]
    return _SENSE * np.sqrt(np.clip(thrust, 0.05, None) / TRUTH["kf"])


def system() -> System:
    """Newton's and Euler's laws along the body's axes; the mass was weighed."""
    position = sp.Matrix(dynamicsymbols("x y z"))
    roll, pitch, yaw = angles = sp.Matrix(dynamicsymbols("roll pitch yaw"))
    rotors = sp.Matrix(dynamicsymbols("w1 w2 w3 w4"))
    t = dynamicsymbols._t
    Jx, Jy, Jz, Jr, kf, km, dx, dy, dz = sp.symbols("Jx Jy Jz Jr kf km dx dy dz")
    m, arm, g = sp.symbols("m arm g")
    rotation = (
        sp.rot_ccw_axis3(yaw) * sp.rot_ccw_axis2(pitch) * sp.rot_ccw_axis1(roll)
    )  # from the body's frame to the world's
    # Of the body, along its axes.
    rate = sp.Matrix(
        [
            roll.diff(t) - yaw.diff(t) * sp.sin(pitch),
            pitch.diff(t) * sp.cos(roll) + yaw.diff(t) * sp.sin(roll) * sp.cos(pitch),
            -pitch.diff(t) * sp.sin(roll) + yaw.diff(t) * sp.cos(roll) * sp.cos(pitch),
        ]
    )
    squares = rotors.multiply_elementwise(rotors)
    thrust = kf * sum(squares)
    velocity = rotation.T * position.diff(t)
    weight = sp.Matrix([0, 0, -g])
    force = sp.Matrix([0, 0, thrust]) - sp.diag(dx, dy, dz) * velocity
    newton = m * rotation.T * (position.diff(t, 2) - weight) - force
    spin = sp.Matrix([0, 0, Jr * sum(rotors)])
    momentum = sp.diag(Jx, Jy, Jz) * rate + spin
    torque = sp.Matrix(
        [
            arm * kf * (squares[1] - squares[3]),
            arm * kf * (squares[2] - squares[0]),
            -km * (squares[0] - squares[1] + squares[2] - squares[3]),
        ]
    )
    euler = momentum.diff(t) + rate.cross(momentum) - torque
    names = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
    return System(
        "quadrotor",
        equations=dict(zip(names, [*newton, *euler], strict=True)),
        variables=(
            *(Variable(symbol, unit="m") for symbol in position),
            *(Variable(symbol, unit="rad") for symbol in angles),
            *(Variable(symbol, unit="rad/s") for symbol in rotors),
        ),
        constants=(
            *(Constant(J, unit="kg m²", sign="positive") for J in (Jx, Jy, Jz, Jr)),
            Constant(kf, unit="N s²", sign="positive"),
            Constant(km, unit="N m s²", sign="positive"),
            *(Constant(d, unit="N s/m", sign="positive") for d in (dx, dy, dz)),
            Constant(m, unit="kg", value=MASS),
            Constant(arm, unit="m", value=ARM),
            Constant(g, unit="m/s²", value=GRAVITY),
        ),
        output_units={name: "N" if "force" in name else "N m" for name in names},
    )


QUADROTOR = Example(
    name="quadrotor",
    source="SymPy; MuJoCo",
    description=system,
    truth=TRUTH,
    simulate=simulate,
    noise={
        **dict.fromkeys(("x", "y", "z"), 1e-4),
        **dict.fromkeys(("roll", "pitch", "yaw"), 2e-4),
        **dict.fromkeys(("w1", "w2", "w3", "w4"), 1.0),
    },
    settings=jc.Settings(jc.Preparation(jc.SavitzkyGolay(31, 6)), jc.LeastSquares(cutoff=6.0)),
    recorded=("w1", "w2", "w3", "w4"),
)
