"""A vehicle as a bicycle: one wheel an axle, tyres whose side force grows with their slip angle.

The truth is integrated in the frame of the road, the system is written by Kane's method in that of
the vehicle. `SATURATING_TYRES` have a greatest side force, reached over a slip angle that enters
nonlinearly.
"""

from collections.abc import Callable, Sequence

import numpy as np
import sympy as sp
from sympy.physics.mechanics import (
    KanesMethod,
    Point,
    ReferenceFrame,
    RigidBody,
    dynamicsymbols,
    inertia,
)

import jaxcslc as jc
from jaxcslc.systems import Constant, System, Variable, mechanics_equations
from scripts.studies.systems.example import Example
from scripts.studies.systems.signals import Columns, Multisine, integrate


MASS, FRONT, REAR = 1500.0, 1.2, 1.4  # [kg], axles before and behind the centre of gravity [m]
TRUTH = {"Iz": 2600.0, "Cf": 8.0e4, "Cr": 9.5e4}  # [kg m²], [N/rad]
SATURATION = {"Pf": 5.5e3, "Pr": 6.0e3, "sf": 0.07, "sr": 0.06}  # [N], [rad]
_INTERVAL = 0.01

Tyre = Callable[[np.ndarray], np.ndarray]


def _linear(stiffness: float) -> Tyre:
    return lambda slip: stiffness * slip


def _saturating(peak: float, angle: float) -> Tyre:
    return lambda slip: peak * np.tanh(slip / angle)


def simulate(
    seeds: Sequence[int],
    validation: bool,
    tyres: tuple[Tyre, Tyre] = (_linear(TRUTH["Cf"]), _linear(TRUTH["Cr"])),
    steering: float = 0.02,
) -> list[Columns]:
    """Newton's law in the frame of the road; the drive holds the speed near a reference.

    - `steering`: root mean square of the wheels' angle [rad].
    """
    stream = "validation" if validation else "training"
    time = np.arange(0.0, 8.0 if validation else 60.0, _INTERVAL)
    wheel = Multisine.random(seeds, stream + " steering", (0.1, 1.2), steering)
    reference = Multisine.random(seeds, stream + " speed", (0.03, 0.1), 1.5, lines=3, mean=20.0)

    def body(t: float, state: np.ndarray) -> tuple[np.ndarray, ...]:
        """Speeds in the vehicle's frame, and the side forces of both axles."""
        _, _, heading, east, north, yaw_rate = state
        forward = np.cos(heading) * east + np.sin(heading) * north
        side = -np.sin(heading) * east + np.cos(heading) * north
        front = tyres[0](wheel(t) - np.arctan2(side + FRONT * yaw_rate, forward))
        rear = tyres[1](-np.arctan2(side - REAR * yaw_rate, forward))
        return forward, side, front, rear

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        _, _, heading, east, north, yaw_rate = state
        forward, _, front, rear = body(t, state)
        angle = wheel(t)
        along = 800.0 * (reference(t) - forward) - front * np.sin(angle)
        across = front * np.cos(angle) + rear
        return np.stack(
            [
                east,
                north,
                yaw_rate,
                (np.cos(heading) * along - np.sin(heading) * across) / MASS,
                (np.sin(heading) * along + np.cos(heading) * across) / MASS,
                (FRONT * front * np.cos(angle) - REAR * rear) / TRUTH["Iz"],
            ]
        )

    start = np.zeros((6, len(seeds)))
    start[3] = reference(0.0)
    state = integrate(derivative, start, np.concatenate([[-2.0], time]))[1:]
    speeds = np.array([body(t, sample)[:2] for t, sample in zip(time, state, strict=True)])
    angle = wheel.sampled(time)
    return [
        {
            "time": time,
            "vx": speeds[:, 0, i],
            "vy": speeds[:, 1, i],
            "yaw_rate": state[:, 5, i],
            "delta": angle[:, i],
        }
        for i in range(len(seeds))
    ]


def system(*, saturating: bool = False) -> System:
    """Side and yaw motion by Kane's method; forward speed and steering are measured."""
    vx, vy, r, delta, heading, side = dynamicsymbols("vx vy yaw_rate delta heading side")
    t = dynamicsymbols._t
    m, Iz, a, b, Cf, Cr = sp.symbols("m Iz a b Cf Cr")
    Pf, Pr, sf, sr = sp.symbols("Pf Pr sf sr")
    road, frame = ReferenceFrame("road"), ReferenceFrame("vehicle")
    frame.orient_axis(road, road.z, heading)
    frame.set_ang_vel(road, r * road.z)
    centre = Point("centre")
    centre.set_vel(road, vx * frame.x + vy * frame.y)
    front, rear = centre.locatenew("front", a * frame.x), centre.locatenew("rear", -b * frame.x)
    for point in (front, rear):
        point.v2pt_theory(centre, road, frame)

    def side_force(
        slip: sp.Expr, stiffness: sp.Symbol, peak: sp.Symbol, angle: sp.Symbol
    ) -> sp.Expr:
        return peak * sp.tanh(slip / angle) if saturating else stiffness * slip

    front_force = side_force(delta - sp.atan((vy + a * r) / vx), Cf, Pf, sf)
    rear_force = side_force(-sp.atan((vy - b * r) / vx), Cr, Pr, sr)
    body = RigidBody("body", centre, frame, m, (inertia(frame, 0, 0, Iz), centre))
    direction = -sp.sin(delta) * frame.x + sp.cos(delta) * frame.y
    # The forward speed is prescribed: side and yaw speed alone are generalised speeds. The vehicle
    # measures them, and not the coordinates that they are the rates of.
    kane = KanesMethod(
        road,
        q_ind=[side, heading],
        u_ind=[vy, r],
        kd_eqs=[side.diff(t) - vy, heading.diff(t) - r],
        bodies=[body],
        forcelist=[(front, front_force * direction), (rear, rear_force * frame.y)],
    )
    kane.kanes_equations()
    equations = mechanics_equations(kane)
    measured = [
        *((q.diff(t, 2), u.diff(t)) for q, u in ((side, vy), (heading, r))),
        *((q.diff(t), u) for q, u in ((side, vy), (heading, r))),
    ]
    constants = [
        Constant(m, unit="kg", value=MASS),
        Constant(a, unit="m", value=FRONT),
        Constant(b, unit="m", value=REAR),
        Constant(Iz, unit="kg m²", sign="positive"),
    ]
    if saturating:
        constants += [
            Constant(Pf, unit="N", sign="positive"),
            Constant(Pr, unit="N", sign="positive"),
            Constant(sf, unit="rad", bounds=(0.01, 0.5)),
            Constant(sr, unit="rad", bounds=(0.01, 0.5)),
        ]
    else:
        constants += [
            Constant(Cf, unit="N/rad", sign="positive"),
            Constant(Cr, unit="N/rad", sign="positive"),
        ]
    return System(
        "vehicle",
        {
            "side": equations["side"].subs(measured).doit(),
            "yaw": equations["heading"].subs(measured).doit(),
        },
        variables=(
            Variable(vx, unit="m/s"),
            Variable(vy, unit="m/s"),
            Variable(r, unit="rad/s"),
            Variable(delta, unit="rad"),
        ),
        constants=tuple(constants),
        output_units={"side": "N", "yaw": "N m"},
    )


_NOISE = {"vx": 0.01, "vy": 0.004, "yaw_rate": 5e-4, "delta": 1.5e-4}
_SETTINGS = jc.Settings(jc.Preparation(jc.SavitzkyGolay(41, 5)), jc.LeastSquares(cutoff=4.0))

VEHICLE = Example(
    name="vehicle",
    source="Kane's method; Newton's law in the road's frame by SciPy",
    description=system,
    truth=TRUTH,
    simulate=simulate,
    noise=_NOISE,
    settings=_SETTINGS,
)

SATURATING_TYRES = Example(
    name="vehicle, saturating tyres",
    source=VEHICLE.source,
    description=lambda: system(saturating=True),
    truth={"Iz": TRUTH["Iz"], **SATURATION},
    simulate=lambda seeds, validation: simulate(
        seeds,
        validation,
        (
            _saturating(SATURATION["Pf"], SATURATION["sf"]),
            _saturating(SATURATION["Pr"], SATURATION["sr"]),
        ),
        steering=0.05,
    ),
    noise=_NOISE,
    settings=_SETTINGS,
)
