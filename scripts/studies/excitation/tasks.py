"""What the study computes, a row a task: tasks run in processes of their own."""

import dataclasses
import time
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxcslc as jc
import sim
from jaxcslc.excitation import (
    BSplines,
    Design,
    Effort,
    Knowledge,
    Limits,
    Noise,
    Planner,
    Surroundings,
)
from jaxcslc.selection import FRICTION_CANDIDATES, choose_friction
from scripts.studies.excitation.motions import (
    DIRECTIONAL,
    TORQUE_NOISE,
    Designs,
    fourier_planner,
    network,
    performed,
    puma_design,
    thesis_coefficients,
)
from scripts.studies.excitation.plans import seconds_to_goal
from scripts.studies.truth import epsilon, moving_patterns, true_coefficients


jc.enable_x64()

SETTINGS = jc.Settings(jc.Preparation(torque_alignment="mean"), jc.LeastSquares(cutoff=15.0))
ARMS_PER_STRUCTURE = 20


def designed(name: str, seed: int, quick: bool) -> dict[str, Any]:
    """A design's parameters, and the processor time that it took."""
    begun = time.process_time()
    design = puma_design(name, seed, quick)
    return {
        "parameters": design.parameters.round(12).tolist(),
        "seconds": time.process_time() - begun,
        "value": design.value,
        "condition": design.prediction.condition,
        "feasible": design.use.feasible,
    }


def sequence(seed: int, steps: int) -> dict[str, Any]:
    """Seconds of recordings until 5 % on every coefficient, in sequence and of one repeated."""
    return seconds_to_goal(seed, steps, lambda _: None)


@lru_cache(maxsize=1)
def comparison(seed: int) -> jc.Patterns:
    """The comparison trajectory, the same for all motions of a seed.

    Without disturbances: static and asymmetric friction, which no coefficient of the thesis
    describes, leave 0.53 N m of ε on any.
    """
    machine = sim.undisturbed(sim.disturbed(sim.puma560()))
    return moving_patterns(sim.simulate(machine, sim.comparison(), seed=10_000 + seed))


def compared(part: str, name: str, seed: int, designs: Designs) -> dict[str, Any]:
    """A motion with all disturbances: ε on the comparison trajectory, errors of coefficients.

    **Arguments**

    - `part`: `"compare"`; the others, in which friction of each joint is larger forwards or
      backwards by chance: `"directions"`; `"directional"`, with designs for a model that has
      friction of each direction, and that model; `"auto"`, with the terms that the data ask for.
    """
    directional = part == "directional"
    machine = sim.disturbed(sim.puma560())
    if part != "compare":
        signs = np.random.default_rng([seed, len(machine.asymmetry)]).choice([-1.0, 1.0], 6)
        asymmetry = tuple((signs * machine.asymmetry).tolist())
        machine = dataclasses.replace(machine, asymmetry=asymmetry)
    motion = DIRECTIONAL.get(name, name) if directional else name
    recording, _ = performed(machine, motion, designs, seed)
    net = network(directional)
    if part == "auto":
        candidates = [kind for kind in FRICTION_CANDIDATES if "load" not in kind]  # linear terms
        net = choose_friction(net, recording, SETTINGS, candidates=candidates).network
    fit = SETTINGS.fit(net, SETTINGS.patterns(recording))
    k, true = np.asarray(fit.k), np.asarray(true_coefficients(network(), machine))
    shared = thesis_coefficients(net)
    reported = np.sqrt(np.diag(shared @ np.asarray(fit.covariance) @ shared.T))
    error = np.abs(shared @ k - true)
    size, absolute = fourier_planner().problem.information.size, np.abs(true)
    if directional:  # on the judged motion, friction is alike in both directions
        net, k = network(), shared @ k
    # The judged motion is without what these terms are for.
    disturbances = {"offset", "static"} & set(net.layout.kinds)
    without = np.concatenate([np.r_[net.layout.term_slice(kind)] for kind in disturbances] or [[]])
    judged_k = np.where(np.isin(np.arange(net.size), without), 0.0, k)
    return {
        "epsilon": epsilon(net, judged_k, comparison(seed)),
        "added": [coefficient for coefficient in net.names if coefficient not in network().names],
        "standard error": float(np.mean(reported / size)),
        "error": float(np.mean(error / size)),
        "median error": float(np.median(error / absolute)),
        "standard error over value": float(np.mean(reported / absolute)),
        "error over value": float(np.mean(error / absolute)),
        "condition": float(fit.condition),
    }


def repeated(estimator: str, seed: int, designs: Designs) -> dict[str, Any]:
    """The designed motion with noise of encoders and torques: errors and standard errors."""
    machine = sim.disturbed(sim.puma560(), "quantisation")
    recording, _ = performed(machine, "overall", {"overall": designs["overall"][:1]}, seed)
    rng = np.random.default_rng(seed)
    torque = recording.torque + np.array(TORQUE_NOISE) * rng.normal(size=recording.torque.shape)
    recording = dataclasses.replace(recording, torque=torque)
    if estimator == "likelihood":
        fit = jc.MaximumLikelihood().fit(network(), recording).fit
    else:
        fit = SETTINGS.fit(network(), SETTINGS.patterns(recording))
    true = np.asarray(true_coefficients(network(), machine))
    return {
        "errors": (np.asarray(fit.k) - true).tolist(),
        "standard errors": np.asarray(fit.standard_error).tolist(),
    }


def random_arms(structure: int, count: int = ARMS_PER_STRUCTURE) -> dict[str, Any]:
    """Quick designs of a random arm under random limits, looked at on a fine grid."""
    planner = _arm_planner(structure)
    worst, scales, infeasible = [], [], []
    for index in range(count):
        rng = np.random.default_rng([structure, index])
        wish = _planner_within(planner, _random_limits(planner, rng))
        try:
            design = wish.design(Effort(1, 3, 12, seed=index))
        except ValueError as error:
            infeasible.append(str(error))
            continue
        worst.append(_most_used(design))
        scales.append(design.scale)
    jax.clear_caches()  # compiled for this arm alone
    return {"worst": worst, "scales": scales, "infeasible": infeasible}


def _planner_within(planner: Planner, limits: Limits) -> Planner:
    return Planner.of(
        planner.problem.information.network,
        limits,
        planner.noise,
        planner.family,
        knowledge=planner.knowledge,
    )


def _most_used(design: Design) -> float:
    """The largest part of any limit that a motion uses at 20,001 instants."""
    instants = np.linspace(0.0, design.family.duration, 20_001)
    values = [design.family.derivative(design.parameters, instants, i) for i in range(4)]
    used = [
        np.max(np.abs(x - middle) / half)
        for x, (middle, half) in zip(values, map(design.limits.symmetric, range(4)), strict=True)
    ]
    k = jnp.asarray(design.prediction.k)
    torque = design.network.torque(k, *(jnp.asarray(x) for x in values[:3]))
    return float(max(*used, np.max(np.abs(np.asarray(torque)) / design.limits.usable_torque)))


def _arm_planner(structure: int) -> Planner:
    rng = np.random.default_rng(structure)
    n = int(rng.integers(2, 5))
    rows = [
        (float(rng.choice([0, np.pi / 2, -np.pi / 2])), rng.uniform(0, 0.5), rng.uniform(0, 0.3), 0)
        for _ in range(n)
    ]
    arm = jc.Manipulator.from_modified_dh([tuple(map(float, row)) for row in rows])
    links = tuple(
        jc.LinkParameters(
            float(rng.uniform(1, 8)),
            rng.uniform(-0.2, 0.2, 3),
            np.diag(rng.uniform(0.02, 0.03, 3)),
            0.1,
        )
        for _ in range(n)
    )
    net = jc.derive(arm, lengths="numeric")
    friction = {"viscous": rng.uniform(0.5, 3, n).tolist(), "dry": rng.uniform(0.2, 4, n).tolist()}
    k = np.asarray(net.coefficients_from(links, **friction))
    known = Knowledge(k, None, np.full(net.size, np.inf))
    wide = {"position": [-3, 3], "velocity": 3, "torque": 1e3}
    return Planner.of(
        net, Limits.of(arm, wide), Noise(0.2, 1e-4), BSplines(4.0, 12), knowledge=known
    )


def _random_limits(planner: Planner, rng: np.random.Generator) -> Limits:
    net, k = planner.problem.information.network, planner.knowledge.k
    n = net.joint_count
    middle, half = rng.uniform(-1, 1, n), rng.uniform(0.5, 2.5, n)
    poses = rng.uniform(-np.pi, np.pi, (50, n))
    weight = np.abs(np.asarray(net.gravity_term(jnp.asarray(k), jnp.asarray(poses)))).max(0)
    velocity = rng.uniform(0.8, 4, n)
    return Limits.of(
        net.robot,
        {
            "position": np.stack([middle - half, middle + half], 1).tolist(),
            "velocity": velocity.tolist(),
            "acceleration": (velocity * rng.uniform(2, 10, n)).tolist(),
            "jerk": (velocity * rng.uniform(50, 200, n)).tolist(),
            "torque": (rng.uniform(1.3, 3, n) * (weight + 5)).tolist(),
        },
    )


def panda(seed: int, urdf: str, steps: int) -> dict[str, Any]:
    """A Panda beside its table, 20 s: feasible? condition numbers, time."""
    robot = jc.load_robot(Path(urdf), tip=["panda_link8"])
    if "panda" not in _pandas:
        of_maker = Limits.of(jc.panda())
        stated = {name: getattr(of_maker, name).tolist() for name in ("acceleration", "jerk")}
        _pandas["panda"] = Planner.of(
            jc.derive(robot, lengths="numeric"),
            Limits.of(robot, stated, Surroundings(floor=0.0)),
            Noise((0.3,) * 4 + (0.1,) * 3, 1e-5, rate=1000.0),
            BSplines(20.0, 57),
        )
    planner = _pandas["panda"]
    begun = time.process_time()
    design = planner.design(Effort(1, 5, steps, seed=seed))
    instants = np.linspace(0.0, 20.0, 2001)
    poses = np.asarray(design.family.derivative(design.parameters, instants))
    used = _most_used(design)
    assert planner.bodies is not None
    wanted = planner.bodies.wanted
    gap = min(float(np.min(planner.bodies.distances(pose, 0.3)[0] - wanted)) for pose in poses)
    return {
        "feasible": design.use.feasible and used <= 1.0 and gap >= 0.0,
        "used": used,
        "gap": gap,
        "scale": design.scale,
        "condition": design.prediction.condition,
        "scaled condition": design.prediction.scaled_condition,
        "value": design.value,
        "seconds": time.process_time() - begun,
    }


_pandas: dict[str, Planner] = {}
