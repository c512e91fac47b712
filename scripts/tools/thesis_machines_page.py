"""Writes docs/puma_a_b.md: changes of the presets `puma_a` and `puma_b` to Appendix B, and why.

    .venv/bin/python -m scripts.tools.thesis_machines_page

Every figure of the page is computed here; a test fails when the page and the code disagree.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

import jaxcslc as jc
import sim
from sim.machine._nearest_links import nearest_links
from sim.machine._thesis_machines import puma_a, puma_b, thesis_coefficients


jc.enable_x64()

PAGE = Path(__file__).parents[2] / "docs" / "puma_a_b.md"
_CONFIGURATIONS = 1000
_FAR = 0.2  # m
_MACHINES = {"A": puma_a(), "B": puma_b()}

_INTRODUCTION = """\
# PUMA A and PUMA B

- `puma_a` and `puma_b` are the physically consistent machines nearest to the thesis's printed
  coefficients.
- No machine has the printed coefficients: several of them contradict each other.
- The torque of each preset, RMS of all joints, is nearer to that of the printed coefficients than
  the torque of Armstrong's machine.

![Bars: torque differences from PUMA A's printed coefficients](images/evidence/puma_a_b.svg)

The presets `puma_a` and `puma_b` approximate the two machines on which the thesis identified its
coefficients. The presets are physically consistent. Their friction is Appendix B's as printed. The
thesis identified 31 mass and gravity coefficients one by one, and no machine has the printed
values. The presets have the links of the consistent machine with the nearest coefficients. Each
difference is weighted by its printed output sensitivity, in N m. The result is the least change of
torque. Spread along a joint's axis may first be moved between neighbouring links (see
`possible_links`). Each link of a candidate has

- positive mass, and a spread of mass that is not negative in any direction, ∫ x xᵀ dm ≥ 0;
- principal axes along the frame's, and the zeros of Fig. 2.6-4, so that the thesis's network with
  the preset's coefficients is exact;
- a mass and a motor inertia from a half to twice Armstrong's;
- spreads of mass no less than half of Armstrong's;
- a centre of gravity within 0.1 m of Armstrong's in each direction.

No motor inertia is below half of Armstrong's. So the mass matrix is positive definite everywhere.

`scripts/tools/thesis_machines_page.py` writes this page.
"""

_WHY = """\
## Contradictions of the printed coefficients

**Several coefficients are one quantity times a fixed length.** A machine has one value of it.
"""

_OUTSIDE = """\
By Appendix B, the mass beyond the elbow is both negative and several times Armstrong's. The centre
of gravity of link 2 is a metre outside the link.
"""

_INEQUALITIES = """\
**Some differences cannot be negative.** They are sums of masses times squares; `sx4` is the spread
∫ x² dm of link 4 along its x axis.
"""


def constants() -> Mapping[str, float]:
    """Lengths [m] and gravity [m/s²]."""
    robot = sim.puma560().robot
    return {**robot.length_values(), "g": -robot.gravity[2]}


def quantities(k: Mapping[str, float]) -> list[tuple[str, str, str, float]]:
    """Physical quantities that coefficients imply: name, coefficient, unit, value."""
    c = constants()
    reach, moment = c["d2"] + c["d3"], k["kG1"] / c["g"]
    return [
        ("`m6*rz6`", "kM1", "kg m", -k["kM1"] / c["d4"]),
        ("", "kM2", "kg m", k["kM2"] / c["a3"]),
        ("", "kM3", "kg m", k["kM3"] / c["a2"]),
        ("", "kM7", "kg m", k["kM7"] / reach),
        ("", "kG2", "kg m", -k["kG2"] / c["g"]),
        ("`m4 + m5 + m6`", "kM10", "kg", k["kM10"] / (c["a2"] * c["a3"])),
        ("", "kM17", "kg", k["kM17"] / (reach * c["a3"])),
        ("", "kG3", "kg", -k["kG3"] / (c["a3"] * c["g"])),
        ("`m3*ry3 - m4*rz4 - d4*(m4 + m5 + m6)`", "kM14", "kg m", k["kM14"] / c["a2"]),
        ("", "kG5", "kg m", k["kG5"] / c["g"]),
        ("`rx2`", "kM5, kG1", "m", -k["kM5"] / (2 * moment)),
        ("`rz2`", "kM8, kG1", "m", k["kM8"] / moment - c["d2"]),
    ]


def spreads(k: Mapping[str, float]) -> list[tuple[str, str, float]]:
    """Differences of coefficients that no machine can have negative [kg m²]."""
    return [
        ("`kM9 - kM15`", "`2*sx5 + Izz6`", k["kM9"] - k["kM15"]),
        ("`kM13 - kM18`", "`2*sy4 + 2*sz5 + Izz6`", k["kM13"] - k["kM18"]),
        (
            "`kM22 - kM24`",
            "`2*sy3 + 2*m3*ry3^2 + 2*sz4 + 2*m4*(rz4 + d4)^2 + 2*sx5 + 2*(m5 + m6)*d4^2 + Izz6`",
            k["kM22"] - k["kM24"],
        ),
    ]


def page(performed: sim.Truth) -> str:
    """The page as text. `performed`: the training trajectory as Armstrong's machine performs it."""
    network = jc.derive(sim.puma560().robot)
    inertial = network.layout.inertial
    names = network.names[inertial]
    parts = [_INTRODUCTION]
    armstrong = _inertial(network, sim.puma560())
    thesis = {name: thesis_coefficients(name).coefficients[inertial] for name in _MACHINES}
    weight = {name: thesis_coefficients(name).sensitivity[inertial] for name in _MACHINES}
    preset = {name: _inertial(network, machine) for name, machine in _MACHINES.items()}

    parts.append(_WHY)
    columns = [*thesis.values(), *preset.values(), armstrong]
    implied = [quantities(dict(zip(names, k.tolist(), strict=True))) for k in columns]
    heads = ["thesis A", "thesis B", "`puma_a`", "`puma_b`", "Armstrong"]
    parts.append(
        _table(
            ["quantity", "from", "unit", *heads],
            [
                [*rows[0][:3], *(_number(value) for *_, value in rows)]
                for rows in zip(*implied, strict=True)
            ],
            text=3,
        )
    )
    parts.append(_OUTSIDE)
    parts.append(_INEQUALITIES)
    signs = [spreads(dict(zip(names, k.tolist(), strict=True))) for k in columns]
    parts.append(
        _table(
            ["at least 0", "is", *heads],
            [
                [*rows[0][:2], *(_number(value) for *_, value in rows)]
                for rows in zip(*signs, strict=True)
            ],
            text=2,
        )
    )
    parts.append("## Effect on the torque\n")
    parts.append(_cost(network, performed, thesis, preset, weight, armstrong))
    for name in _MACHINES:
        parts.append(f"## Coefficients of PUMA {name}\n")
        change = preset[name] - thesis[name]
        parts.append(
            _table(
                ["coefficient", "unit", "thesis", "preset", "change", "× sensitivity [N m]"],
                [
                    [k.name, k.unit, *(_number(value) for value in row[:3]), f"{row[3]:.4f}"]
                    for k, *row in zip(
                        network.coefficients[network.layout.inertial],
                        thesis[name].tolist(),
                        preset[name].tolist(),
                        change.tolist(),
                        (change * weight[name]).tolist(),
                        strict=True,
                    )
                ],
                text=2,
            )
        )
    parts.append("## Links\n")
    parts.append(
        "Units are kg, m and kg m². Moments of inertia are at the centre of gravity. For link 1,"
        " only `Izz + Im`\nenters the dynamics.\n"
    )
    parts.append(_links())
    return "\n".join(parts)


def _cost(
    network: jc.CSLC,
    performed: sim.Truth,
    thesis: Mapping[str, Float[np.ndarray, "31"]],
    preset: Mapping[str, Float[np.ndarray, "31"]],
    weight: Mapping[str, Float[np.ndarray, "31"]],
    armstrong: Float[np.ndarray, "31"],
) -> str:
    motion = performed.position, performed.velocity, performed.acceleration
    network_torque = jax.jit(network.torque)
    rows: list[list[str]] = []
    for name in _MACHINES:
        for what, change in (
            ("thesis's torque", thesis[name]),
            (f"`puma_{name.lower()}` against it", preset[name] - thesis[name]),
            ("Armstrong against it", armstrong - thesis[name]),
        ):
            torque = np.asarray(network_torque(_without_friction(network, change), *motion))
            over = np.sqrt(np.mean(torque**2, axis=0))
            distance = float(np.linalg.norm(weight[name] * change))
            rows.append(
                [
                    name,
                    what,
                    "" if what.endswith("torque") else _number(distance, 3),
                    *(_number(value, 3) for value in over.tolist()),
                    _number(float(np.sqrt(np.mean(torque**2))), 3),
                ]
            )
    far = [_distance_of_unlike(network, name) for name in _MACHINES]
    smallest = [_smallest_eigenvalue(network, machine) for machine in _MACHINES.values()]
    return (
        "The table has the RMS torque [N m] without friction. The motion is the training"
        " trajectory (7.4.1), as\nArmstrong's machine performs it. The distance [N m] is the"
        " minimised weighted norm.\n\n"
        + _table(
            ["PUMA", "", "distance", *(f"joint {i}" for i in range(1, 7)), "all"], rows, text=2
        )
        + f"\nThe smallest eigenvalue of M(q) over {_CONFIGURATIONS} configurations drawn from the"
        f" joints' ranges is\n{_number(smallest[0], 3)} kg m² for `puma_a` and"
        f" {_number(smallest[1], 3)} kg m² for `puma_b`.\n\n"
        "The limits of the deviation from Armstrong's machine are a choice with little effect."
        " Wider limits\nallow masses, motor inertias and spreads of a hundredth of his, and centres"
        f" {_FAR} m away. The\nnearest machine is then at a distance of {_number(far[0], 3)}"
        f" from PUMA A and {_number(far[1], 3)} from PUMA B.\n"
    )


def _distance_of_unlike(network: jc.CSLC, name: str) -> float:
    machine, thesis = sim.puma560(), thesis_coefficients(name)
    inertial = network.layout.inertial
    k, weight = thesis.coefficients[inertial], thesis.sensitivity[inertial]
    links = nearest_links(machine.robot, k, weight, least=0.01, shift=_FAR)
    difference = np.asarray(network.coefficients_from(links))[inertial] - k
    return float(np.linalg.norm(weight * difference))


def _smallest_eigenvalue(network: jc.CSLC, machine: sim.Machine) -> float:
    low, high = np.array(machine.position_range).T
    q = np.random.default_rng(0).uniform(low, high, (_CONFIGURATIONS, 6))
    k = _without_friction(network, _inertial(network, machine))
    return float(np.linalg.eigvalsh(np.asarray(network.mass_matrix(k, q))).min())


def _links() -> str:
    rows: list[list[str]] = []
    machines = {"Armstrong": sim.puma560(), "A": _MACHINES["A"], "B": _MACHINES["B"]}
    for i in range(6):
        for name, machine in machines.items():
            links = sim.possible_links(machine.robot, machine.robot.links or ())
            link = links[i]
            values = [
                float(link.mass),
                *np.asarray(link.centre_of_gravity).tolist(),
                *np.diag(np.asarray(link.inertia)).tolist(),
                float(link.motor_inertia),
            ]
            rows.append([str(i + 1), name, *(_number(value, 3) for value in values)])
    heads = ["m", "rx", "ry", "rz", "Ixx", "Iyy", "Izz", "Im"]
    return _table(["link", "machine", *heads], rows, text=2)


def _inertial(network: jc.CSLC, machine: sim.Machine) -> Float[np.ndarray, "31"]:
    assert machine.robot.links is not None  # a machine has them
    return np.asarray(network.coefficients_from(machine.robot.links))[network.layout.inertial]


def _without_friction(
    network: jc.CSLC, inertial: Float[np.ndarray, "31"]
) -> Float[np.ndarray, " coefficients"]:
    k = np.zeros(network.size)
    k[network.layout.inertial] = inertial
    return k


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}g}"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], *, text: int) -> str:
    """A Markdown table with `text` columns of text, and figures in the others."""
    rule = ["---"] * text + ["---:"] * (len(heads) - text)
    return "".join(f"| {' | '.join(row)} |\n" for row in (heads, rule, *rows))


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Write docs/puma_a_b.md.")
    parser.add_argument("-o", "--output", type=Path, default=PAGE)
    output = parser.parse_args(argv).output
    _, performed = sim.simulate(sim.puma560(), sim.training(), seed=3)
    output.write_text(page(performed), encoding="utf-8")
    print(f"wrote {output}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
