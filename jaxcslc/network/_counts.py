from collections.abc import Sequence

from ..derivation import Algebra, derive_algebra
from .terms import AbstractInputTerm, JointProjection, carrier


def counts_of(
    algebra: Algebra, terms: Sequence[AbstractInputTerm], carrying_link: int | None
) -> dict[str, dict[str, int]]:
    """Size of each subnetwork: inputs, links and coefficients (thesis 5.1, Appendix B).

    - `algebra`: of the rigid body; `terms`: of everything beside it.
    - `carrying_link`: of a payload, counted from 1; None without one.
    """
    counts = _rigid_body_counts(algebra)
    for term in terms:
        n = len(term.input_joints)
        nodes = len(set(term.input_joints))
        counts[term.kind] = {"inputs": n, "links": n, "nodes": nodes, "coefficients": term.size}
    for payload in _payload_algebra(algebra, carrying_link):
        parts = _rigid_body_counts(payload).values()
        total = {name: sum(part[name] for part in parts) for name in ("inputs", "links", "nodes")}
        counts["payload"] = total | {"coefficients": len(payload.coefficients)}
    return counts


def order_per_joint(
    algebra: Algebra, terms: Sequence[AbstractInputTerm], carrying_link: int | None
) -> tuple[int, ...]:
    """How many independent coefficients each joint's torque depends on (thesis 4.2, 5.2.5).

    For a network whose output is linear in its coefficients and whose hidden nodes feed one
    context-sensitive product each, the order of an output is the number of coefficients that
    reach it. Arguments as of `counts_of`.
    """
    projection, n = JointProjection.of(algebra.robot), algebra.robot.joint_count
    moved = [[i] for i in range(n)]
    if projection is not None:
        moved = [[joint for joint, _ in shares] for shares in projection.shares]
    orders = [0] * len(moved)
    for rigid in (algebra, *_payload_algebra(algebra, carrying_link)):
        reach: list[set[int]] = [set() for _ in range(n)]
        for link in rigid.mass.links:
            for joint in rigid.mass.columns[link.column]:
                reach[joint] |= {index for index, _ in link.weights}
        for table in (rigid.velocity, rigid.gravity):
            for link in table.links:
                reach[table.columns[link.column][0]] |= {index for index, _ in link.weights}
        for output, joints in enumerate(moved):
            orders[output] += len({index for joint in joints for index in reach[joint]})
    for term in terms:
        for joint in term.input_joints:
            orders[joint] += 1
    return tuple(orders)


def _payload_algebra(algebra: Algebra, carrying_link: int | None) -> tuple[Algebra, ...]:
    """The closed form of a payload's torque in base parameters; empty without a payload."""
    if carrying_link is None:
        return ()
    return (derive_algebra(carrier(algebra.robot, carrying_link), "numeric"),)


def _rigid_body_counts(algebra: Algebra) -> dict[str, dict[str, int]]:
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
