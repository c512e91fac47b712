from ..derivation import Algebra
from ..manipulator import Manipulator
from .terms import friction_terms


def order_per_joint(algebra: Algebra, robot: Manipulator) -> tuple[int, ...]:
    """How many independent coefficients each joint's torque depends on (thesis 4.2, 5.2.5).

    For a network whose output is linear in its coefficients and whose hidden nodes feed one
    context-sensitive product each, the order of an output is the number of coefficients that
    reach it.
    """
    reach: list[set[int]] = [set() for _ in robot.joints]
    for link in algebra.mass.links:
        for joint in algebra.mass.columns[link.column]:
            reach[joint] |= {index for index, _ in link.weights}
    for table in (algebra.velocity, algebra.gravity):
        for link in table.links:
            reach[table.columns[link.column][0]] |= {index for index, _ in link.weights}
    inputs = [joint for term in friction_terms(robot) for joint in term.joints]
    return tuple(len(indices) + inputs.count(joint) for joint, indices in enumerate(reach))
