"""The minimal parameter sets: their size, by algebra and by rank, and their combinations."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sympy import QQ
from sympy.polys.matrices import DomainMatrix

import jaxcslc
import jaxcslc as jc
from jaxcslc.derivation import Algebra, PositionRing, derive_algebra, link_twists
from jaxcslc.derivation._chain import exact_number
from jaxcslc.derivation._lagrange import InertialTerm, gravity_vector, inertial_terms, mass_matrix
from jaxcslc.manipulator import LinkParameters, Manipulator


# Without and with motor inertias, full tensors.
SIZES = {"puma560": (36, 40), "panda": (43, 48), "ur5": (36, 40), "stanford": (33, 37)}


@pytest.mark.parametrize("motors", [False, True], ids=["bare", "motors"])
@pytest.mark.parametrize("name", list(SIZES))
def test_exact_size(literature: dict[str, Manipulator], name: str, motors: bool) -> None:
    robot = literature[name].with_inertia("full", motor_inertia=motors)
    algebra = derive_algebra(robot, "numeric")
    assert len(algebra.coefficients) == len(algebra.base_terms) == SIZES[name][motors]


@pytest.mark.parametrize("motors", [False, True], ids=["bare", "motors"])
@pytest.mark.parametrize("name", list(SIZES))
def test_rank_of_pinocchios_regressor(
    literature: dict[str, Manipulator],
    pinocchio_chain: Callable[[Manipulator], Any],
    regressor_rank: Callable[..., int],
    rng: np.random.Generator,
    name: str,
    motors: bool,
) -> None:
    model = pinocchio_chain(literature[name])
    assert regressor_rank(model, rng, motors=motors) == SIZES[name][motors]


@pytest.mark.parametrize("motors", [False, True], ids=["bare", "motors"])
@pytest.mark.parametrize(
    ("name", "file", "joints"), [("ur5", "ur5_robot.urdf", 6), ("panda", "panda.urdf", 7)]
)
def test_rank_with_published_kinematics(
    pinocchio_file: Callable[[str, int], Any],
    regressor_rank: Callable[..., int],
    rng: np.random.Generator,
    name: str,
    file: str,
    joints: int,
    motors: bool,
) -> None:
    """The same counts from others' files, whose frames are not placed as ours."""
    assert regressor_rank(pinocchio_file(file, joints), rng, motors=motors) == SIZES[name][motors]


def in_order_of_choice(terms: tuple[InertialTerm, ...]) -> list[int]:
    """Terms by preference: Iyy, third first moments and masses are what is regrouped."""

    def key(index: int) -> tuple[int, bool, int]:
        factors = terms[index].factors
        regrouped: dict[tuple[str, ...], int] = {("Iyy",): 1, ("m", "rz"): 2, ("m",): 3}
        return regrouped.get(factors, 0), factors == ("motor",), index

    return sorted(range(len(terms)), key=key)


def expanded_forms(robot: Manipulator, terms: tuple[InertialTerm, ...]) -> list[dict[int, Any]]:
    """The constant part of every monomial in every element of M and G, over all terms."""
    chain = derive_algebra(robot, "numeric").chain
    ring = PositionRing(chain, ())
    numbers = [
        (exact_number(joint.a.value or 0.0), exact_number(joint.d.value or 0.0))
        for joint in robot.joints
    ]
    twists = link_twists(
        chain,
        cosines=ring.cosines,
        sines=ring.sines,
        a=[a for a, _ in numbers],
        d=[
            d + ring.joint_variable(i) if joint.kind == "P" else d
            for i, (joint, (_, d)) in enumerate(zip(robot.joints, numbers, strict=True))
        ],
        b=[0] * len(robot.joints),
        gravity=tuple(exact_number(g) for g in robot.gravity),  # type: ignore[arg-type]
        reduce=ring.normal_form,
    )
    elements = [
        *mass_matrix(ring, twists, terms).values(),
        *gravity_vector(ring, twists, terms).values(),
    ]
    return [
        {index: value for (index, _), value in form.items()}
        for element in elements
        for form in element.values()
    ]


@pytest.mark.parametrize("name", ["puma560", "ur5", "stanford"])
def test_sampling_finds_the_echelon_form_of_the_tables(
    literature: dict[str, Manipulator], name: str
) -> None:
    robot = literature[name]
    algebra = derive_algebra(robot, "numeric")
    terms = inertial_terms(robot)
    order = in_order_of_choice(terms)
    rows = [[form.get(index, QQ(0)) for index in order] for form in expanded_forms(robot, terms)]
    echelon, pivots = DomainMatrix(rows, (len(rows), len(terms)), QQ).rref()
    expected = {
        order[pivot]: {order[column]: value for column, value in enumerate(row) if value}
        for pivot, row in zip(pivots, echelon.to_ddm().to_list()[: len(pivots)], strict=True)
    }
    assert terms == algebra.terms
    assert set(algebra.base_terms) == set(expected)
    for index, coefficient in zip(algebra.base_terms, algebra.coefficients, strict=True):
        combination = {
            terms.index(addend.term): QQ(addend.factor.numerator, addend.factor.denominator)
            for addend in coefficient.addends
        }
        assert combination == expected[index]


def combinations(algebra: Algebra) -> np.ndarray:
    """The matrix L of k = L θ, θ being the values of all terms."""
    matrix = np.zeros((len(algebra.coefficients), len(algebra.terms)))
    for row, coefficient in enumerate(algebra.coefficients):
        for addend in coefficient.addends:
            matrix[row, algebra.terms.index(addend.term)] = float(addend.factor)
    return matrix


@pytest.mark.parametrize("name", list(SIZES))
def test_each_is_one_term_and_what_is_regrouped_into_it(
    literature: dict[str, Manipulator], name: str
) -> None:
    algebra = derive_algebra(literature[name], "numeric")
    assert np.array_equal(
        combinations(algebra)[:, algebra.base_terms], np.eye(len(algebra.base_terms))
    )
    for index, coefficient in zip(algebra.base_terms, algebra.coefficients, strict=True):
        assert coefficient.addends[0].term == algebra.terms[index]
        assert not coefficient.addends[0].constants
    assert [coefficient.name for coefficient in algebra.coefficients] == [
        f"kB{i}" for i in range(1, len(algebra.coefficients) + 1)
    ]


@pytest.mark.parametrize("name", list(SIZES))
def test_pinocchios_torque_needs_nothing_else(
    literature: dict[str, Manipulator],
    pinocchio_chain: Callable[[Manipulator], Any],
    rng: np.random.Generator,
    name: str,
) -> None:
    """A change of link parameters in the null space of L leaves Pinocchio's torque as it was."""
    import pinocchio as pin

    robot = literature[name].with_inertia("full", motor_inertia=False)
    algebra = derive_algebra(robot, "numeric")
    null = np.linalg.svd(combinations(algebra))[2][len(algebra.coefficients) :]
    model = pinocchio_chain(robot)
    data = model.createData()
    # Pinocchio's order: m, m r, Ixx Ixy Iyy Ixz Iyz Izz, about the frame's origin as ours.
    pinocchio_terms: list[tuple[str, ...]] = [
        *(("m",), ("m", "rx"), ("m", "ry"), ("m", "rz")),
        *(("Ixx",), ("Ixy",), ("Iyy",), ("Ixz",), ("Iyz",), ("Izz",)),
    ]
    columns = [10 * term.link + pinocchio_terms.index(term.factors) for term in algebra.terms]
    for _ in range(5):
        regressor = pin.computeJointTorqueRegressor(
            model, data, *rng.uniform(-3, 3, (3, model.nv))
        )[:, columns]
        assert np.max(np.abs(regressor @ null.T)) < 1e-12 * np.max(np.abs(regressor))


def test_gravity_decides_what_is_visible() -> None:
    planar = jc.examples.pendulum()
    assert [
        coefficient.expression for coefficient in derive_algebra(planar, "numeric").coefficients
    ] == [*("Izz1 + Im1", "m1*rx1", "m1*ry1")]
    weightless = planar.with_gravity((0, 0, 0))
    assert [
        coefficient.expression for coefficient in derive_algebra(weightless, "numeric").coefficients
    ] == ["Izz1 + Im1"]


def test_two_link_planar_arm() -> None:
    """The textbook case, by hand: m2 and m2 r2 are regrouped into the first link."""
    robot = Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, -9.81, 0), motor_inertia=False
    )
    assert [
        coefficient.expression for coefficient in derive_algebra(robot, "numeric").coefficients
    ] == [
        *("Izz1 + 0.25*m2", "m1*rx1 + 0.5*m2", "m1*ry1"),
        *("Izz2", "m2*rx2", "m2*ry2"),
    ]


def test_values_are_the_combinations_of_link_parameters(
    literature: dict[str, Manipulator],
    rng: np.random.Generator,
    random_links: Callable[..., tuple[LinkParameters, ...]],
) -> None:
    robot = literature["stanford"]
    network = jaxcslc.derive(robot, lengths="numeric")
    links = random_links(rng, 6)

    def value(term: InertialTerm) -> float:
        link = links[term.link]
        if term.factors == ("motor",):
            return float(link.motor_inertia)
        if term.factors[0] == "m":
            axis = "xyz".find(term.factors[-1][-1]) if len(term.factors) > 1 else None
            return float(link.mass if axis is None else link.mass * link.centre_of_gravity[axis])
        row, column = ("xyz".index(letter) for letter in term.factors[0][1:])
        return float(link.inertia_at_frame[row, column])

    theta = np.array([value(term) for term in network.algebra.terms])
    k = network.coefficients_from(links)[network.layout.inertial]
    np.testing.assert_allclose(k, combinations(network.algebra) @ theta, rtol=1e-13, atol=1e-14)
