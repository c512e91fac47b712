"""Torque errors of the true model of arms with compliant gears: the limit of identification.

PUMA A and PUMA B with every disturbance of Section 7.2. Nothing is identified: links, friction,
stiffness and motion are the simulator's.

- **Comparison recording**, judged as in `transmission`: ε [N m] on smoothed readings of the
  encoders, for rigid transmissions with more and more of the true friction, and for rotors and
  links that move separately, with the links' true motion smoothed alike. `smoothing` is the part of
  the torque itself that smoothing removes. One row leaves the friction of joint 2 equal in both
  directions: its training motion does not tell the difference between directions from gravity.
- **Training recording**: medians of the modulus of the residuals of the equations of motion [N m]
  at the true motion, averaged over 12 ms as `every=3` does, for rigid transmissions on the rotors'
  motion and for rotors and links separately.
"""

import argparse
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

import jaxcslc as jc
import sim
from jaxcslc._text_table import text_table
from jaxcslc.report import write_csv
from jaxcslc.training import half_rms
from scripts.studies import command
from scripts.studies.puma560.machines import MOVING, machines
from scripts.studies.stored import store
from scripts.studies.tables import stacked
from scripts.studies.truth import true_coefficients


jc.enable_x64()

_SMOOTHING = jc.AveragedSplines(17)
# Joint 2 of the machines, counted from 0.
_JOINT_2 = 1
# Over six samples: the triangle's weights of what is held between them, and of samples.
_EVERY = 3
_HELD = np.array([1, 3, 5, 5, 3, 1]) / 18
_SAMPLED = np.array([0, 1, 2, 3, 2, 1, 0]) / 9

Samples = Float[np.ndarray, "samples joints"]
Motion = tuple[Samples, Samples, Samples]


@dataclasses.dataclass(frozen=True)
class TrueArm:
    """Torque of a machine's true links, rotors and links together or separately.

    **Attributes**

    - `network`: of n joints; `k`: (p,) its true coefficients, zeros for friction.
    - `motor_inertia`: (n,) of rotors, seen at the joints [kg m²].
    - `link_share`: (n,) the part of each joint's friction that acts on the link.
    """

    network: jc.CSLC
    k: Float[np.ndarray, " coefficients"]
    motor_inertia: Float[np.ndarray, " joints"]
    link_share: Float[np.ndarray, " joints"]

    @classmethod
    def of(cls, network: jc.CSLC, machine: sim.Machine) -> "TrueArm":
        """Return that of a network with viscous and dry friction."""
        k = np.array(true_coefficients(network, machine))
        for kind in ("viscous", "dry"):
            k[network.layout.indices(kind)] = 0.0
        inertia = [float(link.motor_inertia) for link in machine.links]
        return cls(network, k, np.array(inertia), np.array(machine.link_share))

    def rigid(self, motion: Motion, friction: Samples) -> Samples:
        """Rotors and links as one body."""
        return np.asarray(self.network.torque(self.k, *motion)) + friction

    def compliant(self, rotor: Motion, link: Motion, friction: Samples) -> Samples:
        """The motors' torque for rotors and links that move separately."""
        return self.rigid(link, friction) + self.motor_inertia * (rotor[2] - link[2])


def epsilon(error: Samples, mask: Bool[np.ndarray, "samples joints"]) -> float:
    """The mean error cost [N m] (7.5), as `jaxcslc.compare` has it."""
    return float(half_rms(jnp.asarray(error.T), jnp.asarray(mask.T, float)))


def comparison_rows(machine: sim.Machine, seed: int) -> Iterator[tuple[str, float]]:
    """ε of each model on the comparison recording."""
    recording, truth = sim.simulate(machine, sim.comparison(), seed=2 * seed + 1)
    judged = jc.prepare(recording, smoothing=_SMOOTHING, torque_alignment="mean", thresholds=MOVING)
    mask, torque = np.asarray(judged.mask), np.asarray(judged.torque)
    index = np.searchsorted(recording.time, np.asarray(judged.time) - 1e-6)
    arm = TrueArm.of(jc.derive(jc.puma560()), machine)
    rotor: Motion = (np.asarray(judged.q), np.asarray(judged.qd), np.asarray(judged.qdd))
    link = _smooth(recording.time, truth.position, index)
    but_joint_2 = tuple(0.0 if i == _JOINT_2 else a for i, a in enumerate(machine.asymmetry))
    friction = {
        "viscous and dry friction": {"static": machine.dry, "asymmetry": ()},
        "and static friction": {"asymmetry": ()},
        "and asymmetric friction, but of joint 2": {"asymmetry": but_joint_2},
        "and of joint 2": {},
    }
    for name, changes in friction.items():
        law = sim.Friction.of(dataclasses.replace(machine, **changes))
        yield f"rigid, {name}", epsilon(torque - arm.rigid(rotor, law.torque(rotor[1])), mask)
    for name in list(friction)[2:]:
        law = sim.Friction.of(dataclasses.replace(machine, **friction[name]))
        shared = (1 - arm.link_share) * law.torque(rotor[1])
        shared = shared + arm.link_share * law.torque(link[1])
        yield f"compliant, {name}", epsilon(torque - arm.compliant(rotor, link, shared), mask)
    means = np.asarray(recording.torque).copy()
    means[1:] = 0.5 * (means[1:] + means[:-1])
    yield "smoothing", epsilon(torque - _smooth(recording.time, means, index)[0], mask)


def training_rows(machine: sim.Machine, seed: int, samples: int) -> dict[str, np.ndarray]:
    """Medians of the modulus of residuals at the true motion, (n,) for each model [N m]."""
    trajectory = sim.training(samples=samples, robot=machine.robot)
    recording, truth = sim.simulate(machine, trajectory, seed=2 * seed)
    # True links have tilted axes, which the network with principal axes leaves out.
    robot = jc.puma560().with_inertia("full")
    arm = TrueArm.of(jc.derive(robot, lengths="numeric"), machine)
    span = _EVERY * float(np.mean(np.diff(recording.time)))
    rotor, link = (_over(positions, span) for positions in (truth.rotor_position, truth.position))
    # A demand acts a delay after its sample; until then the one before does.
    part = machine.torque_delay * _EVERY / span
    demand = np.asarray(recording.torque)
    demand = (1 - part) * demand + part * np.concatenate([demand[:1], demand[:-1]])
    torque = _averaged(demand, _HELD)[: len(rotor[0])]
    friction = _averaged(truth.friction, _SAMPLED)
    return {
        "rigid": np.median(np.abs(torque - arm.rigid(rotor, friction)), axis=0),
        "compliant": np.median(np.abs(torque - arm.compliant(rotor, link, friction)), axis=0),
    }


def _smooth(time: np.ndarray, values: Samples, index: np.ndarray) -> Motion:
    first, second, third = (np.asarray(x)[index] for x in _SMOOTHING.smooth(time, values))
    return first, second, third


def _over(position: Samples, span: float) -> Motion:
    """Motion at every third sample but the ends, from differences over `span` [s]."""
    q = np.asarray(position)[::_EVERY]
    second = (q[2:] - 2 * q[1:-1] + q[:-2]) / span**2
    return q[1:-1], (q[2:] - q[:-2]) / (2 * span), second


def _averaged(values: Samples, weights: np.ndarray) -> Samples:
    columns = [np.convolve(column, weights[::-1], "valid") for column in np.asarray(values).T]
    return np.stack(columns, axis=1)[::_EVERY]


def study(options: argparse.Namespace) -> int:
    """Prints both tables and writes the rows."""
    both = machines()
    seeds = command.seeds_of(options)
    rows: list[dict[str, Any]] = []
    tables: dict[str, list[list[str]]] = {}
    for name, machine in both.items():
        residuals: dict[str, list[np.ndarray]] = {}
        for seed in command.progress(seeds, desc=name, unit="seed"):
            for model, value in comparison_rows(machine, seed):
                rows.append({"machine": name, "seed": seed, "model": model, "epsilon": value})
            for model, values in training_rows(machine, seed, options.samples).items():
                residuals.setdefault(model, []).append(values)
        tables[name] = _comparison_table(name, [row for row in rows if row["machine"] == name])
        print(text_table(tables[name][0], tables[name][1:]), end="\n\n")
        print(_training_table(name, residuals), end="\n\n")
    stored = {"remaining": stacked("machine", tables)}
    store(options, "limits", f"seeds {seeds[0]} to {seeds[-1]}", stored)
    options.output.mkdir(parents=True, exist_ok=True)
    write_csv(options.output / "seeds.csv", rows)
    print(f"wrote {options.output / 'seeds.csv'}")
    return 0


def _comparison_table(machine: str, rows: Sequence[dict[str, Any]]) -> list[list[str]]:
    lines: list[list[str]] = []
    for model in dict.fromkeys(row["model"] for row in rows):
        values = [row["epsilon"] for row in rows if row["model"] == model]
        lines.append([model, *(f"{f(values):.4f}" for f in (np.median, np.min, np.max))])
    return [[f"{machine}: comparison", "ε [N m], median", "least", "greatest"], *lines]


def _training_table(machine: str, residuals: dict[str, list[np.ndarray]]) -> str:
    lines = [
        [model, *(f"{value:.2g}" for value in np.median(values, axis=0))]
        for model, values in residuals.items()
    ]
    joints = [f"joint {i + 1} [N m]" for i in range(len(lines[0]) - 1)]
    return text_table([f"{machine}: training", *joints], lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "limits")
    command.add_seeds(parser, 5)
    parser.add_argument("--samples", type=int, default=3300, help="of training, 2 ms apart")
    command.add_store(parser)
    options = command.parse(parser, argv, seeds=1, samples=600)
    command.require_least(parser, options, seeds=1, first=0, samples=600)
    return command.run(parser, lambda: study(options), seconds=15.0 + 12.0 * options.seeds)


if __name__ == "__main__":
    raise SystemExit(main())
