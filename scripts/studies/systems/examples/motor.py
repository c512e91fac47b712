"""A DC motor with cogging torque that turns a load through an elastic belt.

The motor turns forwards only, so that friction never changes its direction. Two further constants
enter nonlinearly: how often the cogging torque repeats in a turn, and the speed over which friction
falls from its value near rest (Stribeck); see `FREE_PERIOD` and `STRIBECK`.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

import jaxcslc as jc
from jaxcslc.systems import Constant, System, Variable
from scripts.studies.systems.example import Example
from scripts.studies.systems.signals import Columns, Multisine, integrate


TRUTH = {
    "R": 1.2,  # armature resistance [Ohm]
    "L": 6e-3,  # inductance [H]
    "ke": 0.05,  # torque per current, voltage per speed [N m/A]
    "Jm": 2e-4,  # inertia of the motor [kg m²]
    "bm": 2e-4,  # viscous friction [N m s]
    "cm": 6e-3,  # dry friction [N m]
    "As": 3e-3,  # cogging torque, sine and cosine [N m]
    "Ac": 1.5e-3,
    "K": 1.5,  # stiffness of the belt at the motor [N m/rad]
    "D": 4e-3,  # its damping [N m s]
    "Jl": 1e-3,  # inertia of the load [kg m²]
    "bl": 3e-3,  # viscous friction of the load [N m s]
}
RATIO = 2.0  # the load's pulley over the motor's
TEETH = 12.0  # periods of the cogging torque in a turn
STRIBECK_TORQUE, STRIBECK_SPEED = 2e-2, 4.0  # [N m], [rad/s]
_INTERVAL = 0.001


def simulate(seeds: Sequence[int], validation: bool, stribeck: float = 0.0) -> list[Columns]:
    """Hamilton's variables are integrated: flux linkage, angles and angular momenta.

    - `stribeck`: friction near rest beyond dry friction [N m].
    """
    stream = "validation voltage" if validation else "training voltage"
    time = np.arange(0.0, 2.0 if validation else 10.0, _INTERVAL)
    mean = 0.7 + stribeck / TRUTH["ke"] * TRUTH["R"] * 0.3
    voltage = Multisine.random(seeds, stream, (0.4, 12.0), 0.1, mean=mean)
    c = TRUTH

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        flux, motor, load, motor_momentum, load_momentum = state
        current = flux / c["L"]
        motor_speed, load_speed = motor_momentum / c["Jm"], load_momentum / c["Jl"]
        belt = c["K"] * (motor - RATIO * load) + c["D"] * (motor_speed - RATIO * load_speed)
        cogging = c["As"] * np.sin(TEETH * motor) + c["Ac"] * np.cos(TEETH * motor)
        dry = c["cm"] + stribeck * np.exp(-np.abs(motor_speed) / STRIBECK_SPEED)
        friction = c["bm"] * motor_speed + dry * np.sign(motor_speed)
        return np.stack(
            [
                voltage(t) - c["R"] * current - c["ke"] * motor_speed,
                motor_speed,
                load_speed,
                c["ke"] * current - cogging - friction - belt,
                RATIO * belt - c["bl"] * load_speed,
            ]
        )

    speed, current = 8.0, 0.3  # near those of the mean voltage
    momenta = c["Jm"] * speed, c["Jl"] * speed / RATIO
    start = np.array([c["L"] * current, 0.004, 0.0, *momenta])
    # The first half second, in which the belt comes under tension, is not recorded.
    settled = np.concatenate([[-0.5], time])
    state = integrate(derivative, np.tile(start[:, None], len(seeds)), settled)[1:]
    if np.min(state[:, 3]) <= 0.0:
        raise RuntimeError("the motor turned backwards; expected a higher mean voltage")
    inputs = voltage.sampled(time)
    return [
        {
            "time": time,
            "V": inputs[:, i],
            "i": state[:, 0, i] / c["L"],
            "motor": state[:, 1, i],
            "load": state[:, 2, i],
        }
        for i in range(len(seeds))
    ]


def system(*, free_period: bool = False, stribeck: bool = False) -> System:
    """Kirchhoff's law of the armature, Newton's of motor and load."""
    i, motor, load, V = dynamicsymbols("i motor load V")
    t = dynamicsymbols._t
    R, L, ke, Jm, bm, cm, As, Ac, K, D, Jl, bl = sp.symbols("R L ke Jm bm cm As Ac K D Jl bl")
    ratio, N, cs, vs = sp.symbols("ratio N cs vs")
    speed, load_speed = motor.diff(t), load.diff(t)
    belt = K * (motor - ratio * load) + D * (speed - ratio * load_speed)
    cogging = As * sp.sin(N * motor) + Ac * sp.cos(N * motor)
    friction = bm * speed + cm * sp.sign(speed)
    constants = [
        Constant(R, unit="Ohm", sign="positive"),
        Constant(L, unit="H", sign="positive"),
        Constant(ke, unit="N m/A", sign="positive"),
        Constant(Jm, unit="kg m²", sign="positive"),
        Constant(bm, unit="N m s", sign="positive"),
        Constant(cm, unit="N m", sign="positive"),
        Constant(As, unit="N m"),
        Constant(Ac, unit="N m"),
        Constant(K, unit="N m/rad", sign="positive"),
        Constant(D, unit="N m s", sign="positive"),
        Constant(Jl, unit="kg m²", sign="positive"),
        Constant(bl, unit="N m s", sign="positive"),
        Constant(ratio, value=RATIO),
        Constant(N, bounds=(3.0, 40.0)) if free_period else Constant(N, value=TEETH),
    ]
    if stribeck:
        friction += cs * sp.exp(-sp.Abs(speed) / vs) * sp.sign(speed)
        constants += [Constant(cs, unit="N m"), Constant(vs, unit="rad/s", bounds=(0.3, 30.0))]
    return System(
        "DC motor with a belt",
        equations={
            "voltage": sp.Eq(V, R * i + L * i.diff(t) + ke * speed),
            "motor": sp.Eq(0, Jm * motor.diff(t, 2) + cogging + friction + belt - ke * i),
            "load": sp.Eq(0, Jl * load.diff(t, 2) + bl * load_speed - ratio * belt),
        },
        variables=(
            Variable(V, unit="V"),
            Variable(i, unit="A"),
            Variable(motor, unit="rad"),
            Variable(load, unit="rad"),
        ),
        constants=tuple(constants),
        output_units={"voltage": "V", "motor": "N m", "load": "N m"},
    )


_NOISE: Mapping[str, float] = {"V": 2e-3, "i": 2e-4, "motor": 3e-6, "load": 3e-6}
_SETTINGS = jc.Settings(jc.Preparation(jc.SavitzkyGolay(21, 6)), jc.LeastSquares(cutoff=50.0))

DC_MOTOR = Example(
    name="motor",
    source="SymPy; Hamilton's equations by SciPy",
    description=system,
    truth=TRUTH,
    simulate=simulate,
    noise=_NOISE,
    settings=_SETTINGS,
)

FREE_PERIOD = Example(
    name="motor, free cogging period",
    source=DC_MOTOR.source,
    description=lambda: system(free_period=True),
    truth={**TRUTH, "N": TEETH},
    simulate=simulate,
    noise=_NOISE,
    settings=_SETTINGS,
)

STRIBECK = Example(
    name="motor, Stribeck friction",
    source=DC_MOTOR.source,
    description=lambda: system(stribeck=True),
    truth={**TRUTH, "cs": STRIBECK_TORQUE, "vs": STRIBECK_SPEED},
    simulate=lambda seeds, validation: simulate(seeds, validation, STRIBECK_TORQUE),
    noise=_NOISE,
    settings=_SETTINGS,
)
