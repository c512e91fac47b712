from collections.abc import Sequence

from ..derivation import Algebra
from .terms import AbstractInputTerm


def rigid_body_counts(algebra: Algebra) -> dict[str, dict[str, int]]:
    """Sizes of the mass, velocity and gravity subnetworks (thesis 5.1, Appendix B)."""
    tables = {name: getattr(algebra, name) for name in ("mass", "velocity", "gravity")}
    return {
        name: {
            "inputs": len(table.inputs),
            "links": len(table.links),
            "nodes": len(table.columns),
            "coefficients": len(table.coefficients),
        }
        for name, table in tables.items()
    }


def payload_counts(algebra: Algebra) -> dict[str, int]:
    """Sizes of the three subnetworks of a payload's `carrier`, added up."""
    counts = rigid_body_counts(algebra).values()
    total = {name: sum(count[name] for count in counts) for name in ("inputs", "links", "nodes")}
    return total | {"coefficients": len(algebra.coefficients)}


def input_counts(term: AbstractInputTerm) -> dict[str, int]:
    """Size of the subnetwork of a term."""
    n = len(term.input_joints)
    return {
        "inputs": n,
        "links": n,
        "nodes": len(set(term.input_joints)),
        "coefficients": term.size,
    }


def order_per_joint(
    algebras: Sequence[Algebra], terms: Sequence[AbstractInputTerm]
) -> tuple[int, ...]:
    """How many independent coefficients each joint's torque depends on (thesis 4.2, 5.2.5).

    For a network whose output is linear in its coefficients and whose hidden nodes feed one
    context-sensitive product each, the order of an output is the number of coefficients that
    reach it.

    - `algebras`: of the robot and, with a payload, of its `carrier`.
    """
    orders = [0] * algebras[0].robot.joint_count
    for algebra in algebras:
        reach: list[set[int]] = [set() for _ in orders]
        for link in algebra.mass.links:
            for joint in algebra.mass.columns[link.column]:
                reach[joint] |= {index for index, _ in link.weights}
        for table in (algebra.velocity, algebra.gravity):
            for link in table.links:
                reach[table.columns[link.column][0]] |= {index for index, _ in link.weights}
        orders = [total + len(indices) for total, indices in zip(orders, reach, strict=True)]
    for term in terms:
        for joint in term.input_joints:
            orders[joint] += 1
    return tuple(orders)
