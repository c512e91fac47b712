"""MuJoCo's toolbox for system identification, `mujoco.sysid`, on an arm's training recording.

It fits by simulation: parameters of an MJCF model are searched for such that the model, driven by
the recorded torques, moves as the arm did. It needs what a regression does not: bodies, motor
inertias and friction to start from, bounds, states to start simulations from, and a length for
these, because an arm under torque control leaves its recorded motion sooner or later whatever its
parameters are. Here it starts from equal bodies of the arm's mass on the data sheet; states are
those of the recording through the usual pipeline's 20 Hz low pass. The table has errors as of
`study.py`, over all samples: 100 |e| / |torque| of each joint, of the raw torque.

The toolbox needs the package `tabulate`.
"""

import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import sysid

import jaxcslc as jc
import sim
from jaxcslc.recordings import Patterns
from scripts.studies import command
from scripts.studies.real_robots import by_arm
from scripts.studies.real_robots.arms import Arm
from scripts.studies.real_robots.methods import LOW_PASS, Model, without_static
from scripts.studies.real_robots.study import errors_of


jc.enable_x64()

# Of the moving links, about, from data sheets [kg].
MASSES = {"KUKA KR300": 1000.0, "Franka Panda": 15.0, "Stäubli TX40": 20.0}
# The balls that the search starts from: radius over the length of the longest link.
_RADIUS = 0.2
# Friction and motor inertia of a joint start at this part of its torque, each.
_SHARE = 0.1
# Bounds: factors of a body's mass and stretch, and of numbers of a joint; its centre and shear are
# within so many metres.
_FACTOR, _DISTANCE = 100.0, 1.0
_FIELDS = ("armature", "damping", "frictionloss")


def simulation_fit(
    network: jc.CSLC,
    patterns: Patterns,
    start: float | Sequence[jc.LinkParameters],
    stretch: float,
    steps: int,
) -> tuple[Float[np.ndarray, " coefficients"], int]:
    """Coefficients of the network's terms and the number of parameters that were searched for.

    - `network`: with viscous and dry friction, offsets and coupled joints, or some of these.
    - `patterns`: of the training recording, smoothed.
    - `start`: of the search: bodies of all links, or the mass of equal ones together [kg].
    - `stretch`: length of a simulation [s], each from a state of the recording.
    - `steps`: of the search, at most.
    """
    robot = network.robot
    equal = isinstance(start, int | float)
    links = equal_bodies(robot, start, patterns) if equal else start
    spec = arm_model(robot, links, patterns)
    model = spec.compile()
    parameters = start_parameters(spec, model, network, patterns)
    trajectories = list(_trajectories(model, patterns, stretch))
    n = network.joint_count
    scale = np.std(np.concatenate([patterns.q, patterns.qd], axis=1), axis=0)

    def of_stretch(*arguments: Any, state: np.ndarray) -> tuple[Any, Any, Any]:
        _, predicted, measured, *_ = arguments
        return (state[:, 1 : 1 + 2 * n] - measured.data[1:]) / scale, predicted, measured

    def residual(
        x: np.ndarray, parameters: sysid.ParameterDict
    ) -> tuple[list[np.ndarray], Any, Any]:
        errors, predicted, measured = sysid.model_residual(
            x,
            parameters,
            lambda values: sysid.apply_param_modifiers(values, spec),
            trajectories,
            modify_residual=of_stretch,
            resample_true=False,
        )
        # Of several points it returns a column a stretch, not one a point.
        points = 1 if x.ndim == 1 else x.shape[1]
        errors = errors.ravel() if x.ndim == 1 else errors.T.reshape(points, -1).T
        return [errors], predicted, measured

    best, _ = sysid.optimize(parameters, residual, verbose=False, max_iters=steps, x_scale="jac")
    return coefficients_of(network, sysid.apply_param_modifiers(best, spec), best), best.size


def equal_bodies(
    robot: jc.Manipulator, total: float, patterns: Patterns
) -> list[jc.LinkParameters]:
    """Equal balls at the links' frames, of a total mass [kg]."""
    n = robot.joint_count
    reach = max(abs(float(x.value or 0.0)) for joint in robot.joints for x in (joint.a, joint.d))
    mass = total / n
    tensor = 0.4 * mass * (_RADIUS * (reach or 1.0)) ** 2 * np.eye(3)
    torque, qdd = _rms(patterns.torque), _rms(patterns.qdd)
    return [
        jc.LinkParameters(mass, np.zeros(3), tensor, float(_SHARE * torque[i] / qdd[i]))
        for i in range(n)
    ]


def arm_model(
    robot: jc.Manipulator, links: Sequence[jc.LinkParameters], patterns: Patterns
) -> mujoco.MjSpec:
    """Bodies, the coupled shafts as tendons, and sensors."""
    n = robot.joint_count
    torque, qd = _rms(patterns.torque), _rms(patterns.qd)
    text = sim.mjcf(
        robot,
        links,
        viscous=(_SHARE * torque / qd).tolist(),
        breakaway=(_SHARE * torque).tolist(),
        time_step=float(np.median(np.diff(patterns.time))),
    )
    spec = mujoco.MjSpec.from_string(text)
    for i in range(1, n + 1):
        spec.actuator(f"drive_{i}").biastype = mujoco.mjtBias.mjBIAS_AFFINE
    for number, coupling in enumerate(robot.coupled):
        shaft = spec.add_tendon(name=f"shaft_{number}")
        shaft.wrap_joint(f"joint_{coupling.first}", 1.0)
        shaft.wrap_joint(f"joint_{coupling.second}", coupling.ratio)
        # As friction of joints: what sticks, sticks.
        joint = spec.joint(f"joint_{coupling.first}")
        shaft.solref_friction, shaft.solimp_friction = joint.solref_friction, joint.solimp_friction
        for field in _FIELDS:
            _write(shaft, field, float(np.ravel(getattr(joint, field))[0]))
    for kind in (mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL):
        for i in range(1, n + 1):
            spec.add_sensor(
                name=f"sensor_{int(kind)}_{i}",
                type=kind,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=f"joint_{i}",
            )
    return spec


def start_parameters(
    spec: mujoco.MjSpec, model: mujoco.MjModel, network: jc.CSLC, patterns: Patterns
) -> sysid.ParameterDict:
    """Ten numbers a body, and those of joints and shafts, from the start to bounds."""
    parameters = sysid.ParameterDict()
    factors = np.array([1.0 / _FACTOR, _FACTOR])
    distances = np.array([-_DISTANCE, _DISTANCE])
    for i in range(1, network.joint_count + 1):
        parameters.add(
            sysid.body_inertia_param(
                spec,
                model,
                f"link_{i}",
                sysid.InertiaType.Pseudo,
                mass_bound_mult=factors,
                stretch_bound_mult=factors,
                ipos_bound_off=distances,
                shear_bound_off=distances,
                modifier=lambda spec, parameter, name=f"link_{i}": _write_body(
                    spec.body(name), parameter.value
                ),
            )
        )
    elements = [(f"joint_{i}", "joint") for i in range(1, network.joint_count + 1)]
    elements += [(f"shaft_{number}", "tendon") for number in range(len(network.robot.coupled))]
    for name, kind in elements:
        for field in _FIELDS:
            value = float(np.ravel(getattr(getattr(spec, kind)(name), field))[0])

            write = partial(_write_number, name=name, kind=kind, field=field)
            parameters.add(
                sysid.Parameter(f"{name} {field}", value, 0.0, _FACTOR * value, modifier=write)
            )
    torque = _rms(patterns.torque)
    for i, kinds in enumerate(network.friction_per_joint, start=1):
        if "offset" in kinds:
            shift = partial(_write_offset, joint=i)
            bound = float(torque[i - 1])
            parameters.add(sysid.Parameter(f"offset {i}", 0.0, -bound, bound, modifier=shift))
    return parameters


def _write_number(
    spec: mujoco.MjSpec, parameter: sysid.Parameter, *, name: str, kind: str, field: str
) -> None:
    """Into a joint or a tendon."""
    _write(getattr(spec, kind)(name), field, float(parameter.value[0]))


def _write_offset(spec: mujoco.MjSpec, parameter: sysid.Parameter, *, joint: int) -> None:
    """A constant torque, which the drive overcomes."""
    spec.actuator(f"drive_{joint}").biasprm[0] = -float(parameter.value[0])


def _write(element: Any, field: str, value: float) -> None:
    """A number of a joint or a tendon; damping is a polynomial of the speed, of which it is
    the constant."""
    if np.ndim(getattr(element, field)):
        getattr(element, field)[0] = value
    else:
        setattr(element, field, value)


def _write_body(body: mujoco.MjsBody, theta: Float[np.ndarray, "10"]) -> None:
    """The toolbox's ten numbers of a body as mass, centre and principal moments.

    (Its own way to write them leaves a full tensor without axes, which MuJoCo 4.0 refuses to
    compile, and compiles the model once more for each body.)
    """
    mass, *others = sysid.model_modifier.pi_from_theta(theta)
    centre, about_frame = np.array(others[:3]) / mass, np.array(others[3:]).reshape(3, 3)
    inertia = about_frame - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, axes.ravel())
    body.mass, body.ipos, body.inertia, body.iquat = mass, centre, moments, quaternion


def _trajectories(
    model: mujoco.MjModel, patterns: Patterns, stretch: float
) -> Iterator[sysid.SystemTrajectory]:
    """The recording in stretches of equal length, each from a state of its own."""
    step = float(model.opt.timestep)
    length = round(stretch / step) + 1
    motion = np.concatenate([patterns.q, patterns.qd], axis=1)
    for first in range(0, patterns.samples - length, length - 1):
        rows = slice(first, first + length)
        times = step * np.arange(length)
        yield sysid.SystemTrajectory(
            model,
            sysid.TimeSeries.from_control_names(times, np.asarray(patterns.torque[rows]), model),
            sysid.TimeSeries.from_names(times, motion[rows], model),
            sysid.create_initial_state(
                model, np.asarray(patterns.q[first]), np.asarray(patterns.qd[first])
            ),
            None,
        )


def coefficients_of(
    network: jc.CSLC, model: mujoco.MjModel, parameters: sysid.ParameterDict
) -> Float[np.ndarray, " coefficients"]:
    """Return the coefficients of the model's bodies, friction and motor inertias."""
    n = network.joint_count
    links = []
    for i in range(n):
        body = model.body(f"link_{i + 1}")
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, body.iquat)
        axes = axes.reshape(3, 3)
        links.append(
            jc.LinkParameters(
                float(body.mass[0]),
                body.ipos.copy(),
                axes @ np.diag(body.inertia) @ axes.T,
                float(model.dof_armature[i]),
            )
        )
    friction = {"viscous": model.dof_damping.copy(), "dry": model.dof_frictionloss.copy()}
    kinds = network.robot.friction_terms
    if "offset" in kinds:
        friction["offset"] = np.array(
            [float(parameters[f"offset {i + 1}"].value[0]) for i in range(n)]
        )
    if network.robot.coupled:
        shafts = (model.tendon_armature, model.tendon_damping, model.tendon_frictionloss)
        friction["coupled"] = np.stack([np.ravel(shaft) for shaft in shafts], axis=1)
    return np.asarray(network.coefficients_from(links, **friction))


def _rms(values: Any) -> np.ndarray:
    return np.sqrt(np.mean(np.asarray(values) ** 2, axis=0))


def lines_of(name: str, arm: Arm, stretch: float, steps: int) -> list[list[str]]:
    """Return the lines of the table: errors on the fitted motion and on those that are judged."""
    network = without_static(arm)
    settings = jc.Settings(
        jc.Preparation(jc.Butterworth(LOW_PASS), torque_alignment="sample", threshold_fraction=0.0)
    )
    start = time.process_time()
    patterns = settings.patterns(arm.training)
    k, count = simulation_fit(network, patterns, MASSES[name], stretch, steps)
    seconds = time.process_time() - start
    model = Model("mujoco.sysid", network, k, settings, seconds, "")
    rows: list[list[str]] = []
    for motion, recording in {"fitted": arm.training, **arm.tests}.items():
        errors = errors_of(model, settings, recording)["all"]
        cells = [f"{count}", f"{seconds:.0f}", *(f"{error:.1f}" for error in errors)]
        rows.append([name, motion, *cells])
    return rows


def main(argv: Sequence[str] | None = None) -> int:
    parser = by_arm.new_parser(__doc__, "simulation_fit")
    parser.add_argument("--stretch", type=float, default=1.0, help="of a simulation [s]")
    parser.add_argument("--steps", type=int, default=50, help="of the search, at most")
    options = by_arm.parse(parser, argv, arms=["KUKA KR300"], steps=1, stretch=0.2)
    command.require_least(parser, options, steps=1, stretch=0.05)

    def rows_of(name: str, arm: Arm) -> list[list[str]]:
        return lines_of(name, arm, options.stretch, options.steps)

    return command.run(
        parser,
        lambda: by_arm.store_table(
            options,
            "simulation_fit",
            by_arm.print_table(options, rows_of, ["arm", "motion", "parameters", "processor [s]"]),
            name="errors",
        ),
        seconds=5.0 * options.steps * len(options.arms),
    )


if __name__ == "__main__":
    raise SystemExit(main())
