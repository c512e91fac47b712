"""Equations of rotors and links: quadrature, differences, and two masses integrated literally."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.likelihood import EquationPoint, MotionEquations, TorqueRecord
from scripts.studies.likelihood.elastic_gears import ElasticEquations, Stencil


TIME = np.array([0.0, 0.4, 1.0, 1.3])


@pytest.fixture(scope="module")
def two_joints() -> jc.CSLC:
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (0.3, 0, 0, 0)], gravity=(0, -9.81, 0)
    ).with_friction("viscous", "dry", "static")
    return jc.derive(robot, lengths="numeric")


def equations_of(
    network: jc.CSLC, time: np.ndarray, joints: list[int], width: float
) -> ElasticEquations:
    friction = np.zeros(network.size, bool)
    friction[network.layout.friction] = True
    rigid = MotionEquations(network, np.diff(time))
    return ElasticEquations(
        rigid,
        np.array(joints),
        time,
        friction,
        np.full(len(joints), width),
    )


def triangle(row: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants of an equation's two intervals, and the weights of a triangle over them."""
    start, middle, end = TIME[row : row + 3]
    t = np.linspace(start, end, 200_001)
    weights = np.minimum((t - start) / (middle - start), (end - t) / (end - middle))
    return t, weights / np.sum(weights)


class TestStencil:
    def test_mean_rate_and_acceleration_of_a_parabola(self) -> None:
        parabola = np.polynomial.Polynomial([1.0, -2.0, 3.0])
        stencil = Stencil.of(TIME)
        for row in range(2):
            part = parabola(TIME[row : row + 3])
            applied = [
                float(weights[:, row] @ part)
                for weights in (stencil.mean, stencil.rate, stencil.acceleration)
            ]
            t, weights = triangle(row)
            expected = [float(weights @ x) for x in (parabola(t), parabola.deriv()(t))]
            assert_allclose(applied, [*expected, 6.0], rtol=1e-8)

    def test_windup_is_the_mean_beyond_the_play(self) -> None:
        values = np.array([-0.6, -0.1, 0.5, 0.9])[:, None]
        windup = Stencil.of(TIME).windup(values, np.array([0.4]), np.array([1e-9]))
        t, weights = triangle(0)
        parabola = np.polynomial.Polynomial.fit(TIME[:3], values[:3, 0], 2)
        beyond = parabola(t) - np.clip(parabola(t), -0.2, 0.2)
        # Four nodes an interval, and edges amid them.
        assert_allclose(windup.value[0, 0], weights @ beyond, atol=2e-3)

    def test_derivatives_of_windup(self) -> None:
        values = np.array([-0.6, -0.1, 0.5, 0.9])[:, None]
        stencil, play, width, step = Stencil.of(TIME), np.array([0.4]), np.array([0.05]), 1e-6
        windup = stencil.windup(values, play, width)
        for index in range(3):
            moved = [values + sign * step * (np.arange(4) == index)[:, None] for sign in (1, -1)]
            up, down = (stencil.windup(x, play, width).value[0] for x in moved)
            assert_allclose(windup.by_difference[index, 0], (up - down) / (2 * step), rtol=1e-6)
        up, down = (stencil.windup(values, play + s, width).value for s in (step, -step))
        assert_allclose(windup.by_play, (up - down) / (2 * step), rtol=1e-6)


class TestElasticEquations:
    def test_derivatives(self, two_joints: jc.CSLC, rng: np.random.Generator) -> None:
        """Against central differences, at uneven intervals; joint 2 has gears that give way."""
        time = np.cumsum(rng.uniform(0.8, 1.2, 12)) * 2e-3
        equations = equations_of(two_joints, time, [1], 1e-3)
        k = rng.uniform(0.3, 1.0, two_joints.size)
        laws = np.array([3.0, 3.0, 1e-3, 2e-3, 5e-3, 0.2])
        q = np.stack([np.sin(20 * time), np.sin(13 * time), np.sin(13 * time)], axis=1)
        q[:, 2] += 4e-3 * np.sin(200 * time)
        signs = np.ones((10, 2))
        at = EquationPoint(k, laws, q, -signs, signs)
        obtained = equations.linearised(at)
        assert_allclose(obtained.torque, equations.torque(at))
        by_position = np.asarray(obtained.by_position).reshape(10, 3, 3, 3)
        for series in range(3):
            step = 1e-7 * (np.arange(12) == 6)[:, None] * (np.arange(3) == series)
            up, down = (np.asarray(equations.torque(at._replace(q=q + s * step))) for s in (1, -1))
            expected = (up - down) / 2e-7
            for index in range(3):
                row = 6 - index
                scale = np.abs(expected).max() * 1e-6
                assert_allclose(by_position[row, :, index, series], expected[row], atol=scale)
        unknowns, by_law = np.concatenate([k, laws]), obtained.by_coefficient.dense
        for index in [*range(two_joints.size), *range(two_joints.size + 1, len(unknowns))]:
            step = 1e-5 * np.abs(unknowns[index]) * (np.arange(len(unknowns)) == index)
            up, down = (
                np.asarray(equations.torque(at._replace(k=x[: len(k)], laws=x[len(k) :])))
                for x in (unknowns + step, unknowns - step)
            )
            expected = (up - down) / (2 * step[index])
            scale = 1e-5 * np.abs(expected).max() + 1e-12
            assert_allclose(by_law[:, :, index], expected, atol=scale)

    @pytest.mark.parametrize("motion", ["with_play", "without_play"])
    def test_true_motion_leaves_nothing(
        self, network: jc.CSLC, motion: str, request: pytest.FixtureRequest
    ) -> None:
        """Of two masses integrated literally; what gears bear has an RMS of 30 N m."""
        true = request.getfixturevalue(motion)
        equations = equations_of(network, true.time, [0], 1e-6)
        lag = true.damping / true.stiffness
        of_gears = 1 / true.stiffness, lag, true.play, true.rotor_inertia
        laws = np.array([0.0, *of_gears])
        q = np.concatenate([true.rotor, true.link], axis=1)
        direction = np.where(true.rotor[2:] < true.rotor[:-2], -1.0, 1.0)
        turn = -np.ones_like(direction)
        predicted = equations.torque(EquationPoint(true.k, laws, q, turn, direction))
        recording = jc.Recording(true.time, true.rotor, true.torque)
        held = TorqueRecord.of([recording], "held").averaged
        assert np.sqrt(np.mean((predicted[:, :1] - held) ** 2)) < 2e-3
        assert np.sqrt(np.mean(predicted[:, 1] ** 2)) < 2e-2
