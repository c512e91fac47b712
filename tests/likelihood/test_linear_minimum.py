"""Steps among counts and joints that stick, whose laws are flat on one side and steep on the other:
where equations of motion are linear, a step is to the minimum of the laws as they are."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose

from jaxcslc.likelihood import MotionEquations, Point, Step, TorqueRecord
from jaxcslc.likelihood._blocks import MotionBlock, PriorBlock, ReadingBlock, ReversalBlock
from jaxcslc.likelihood._laws import Intervals, Sticking
from jaxcslc.likelihood._levenberg import LinearMinimum
from jaxcslc.likelihood._objective import Linear, Objective, Residuals
from jaxcslc.likelihood._signs import Signs
from tests import arms


SAMPLES = 60
STEP = 4e-3
NOISE = 1e-2


@pytest.fixture(scope="module")
def linear() -> Linear:
    """A pendulum's counts, with some equations that bound its friction."""
    network = arms.pendulum("viscous", "dry")
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(SAMPLES)
    q = np.sin(3 * time + 0.2)[:, None]
    signs = Signs.of(q, time, np.zeros((SAMPLES - 1, 1), bool), margin=1, modelled=True)
    border = network.size + 1 + 1  # a slope that nothing has, and an offset
    mask = np.zeros((SAMPLES - 2, 1), bool)
    mask[5:9] = True
    shape = (SAMPLES, 1)
    blocks = {
        "torque": MotionBlock(
            MotionEquations(network, np.diff(time)),
            TorqueRecord((time,), (rng.normal(size=shape),), "held"),
            signs,
            np.full((SAMPLES - 2, 1), NOISE**-2),
            Sticking(mask, np.ones(mask.shape), np.full(mask.shape, NOISE)),
        ),
        "position": ReadingBlock(
            STEP * np.round(q / STEP),
            np.zeros(SAMPLES, int),
            np.full(shape, 12.0 / STEP**2),
            Intervals(np.ones(shape), np.full(shape, STEP), np.full(shape, 0.02)),
        ),
        "turn": ReversalBlock(signs.turn, np.full(len(signs.samples), 4.0)),
        "border": PriorBlock(np.zeros(border), np.ones(border)),
    }
    values = {
        "k": rng.uniform(0.2, 1.0, network.size),
        "slopes": np.zeros(1),
        "offset": np.zeros(1),
    }
    return Linear.of(Objective(blocks, np.ones(border)), Point.of(values, q, signs.turn))


def derivative(linear: Linear, at: Residuals, along: Step, damping: float, step: Step) -> float:
    """Of the damped sum of squares at residuals that are linear in a step, in a direction."""
    size = 1e-6
    ends = (linear.after(along.scaled(sign * size), at) for sign in (1.0, -1.0))
    high, low = (linear.objective.value(end) for end in ends)
    weight = damping * linear.objective.weights["position"]
    return (high - low) / (2 * size) + 2.0 * float(np.sum(weight * step.position * along.position))


def test_parabolas_touch_the_laws(linear: Linear) -> None:
    rng = np.random.default_rng(1)
    there = {
        **linear.present,
        "position": rng.uniform(-0.6, 0.6, (SAMPLES, 1)) * STEP,
        "torque": rng.normal(size=(SAMPLES - 2, 1)) * NOISE,
    }
    bent = linear.about(there)
    change = {name: there[name] - linear.present[name] for name in linear.levels}
    assert set(change) == {"position", "torque"}
    for name in change:
        law = linear.objective.blocks[name].law
        weight, residual = bent.weights[name], bent.residuals[name]
        changed = weight != linear.weights[name]
        assert changed.any() and not changed.all()
        end, present = law(there[name]), law(linear.present[name])
        of_end = bent.levels[name] + weight * (residual + change[name]) ** 2
        slope = weight * (residual + change[name])
        assert_allclose(of_end[changed], end.value[changed], rtol=1e-9)
        assert_allclose(slope[changed], (end.weight * end.residual)[changed], rtol=1e-9)
        # Elsewhere those of before, which are not below the laws there.
        np.testing.assert_array_equal(residual[~changed], present.residual[~changed])
        assert np.all(of_end[~changed] >= end.value[~changed] - 0.11)


def test_a_step_is_to_the_minimum_of_the_laws(linear: Linear) -> None:
    # It may end before it is exact, and laws below their parabolas keep these: the next goes on.
    damping = 1e-4
    minimum = LinearMinimum.of(linear, damping, 0.0)
    for _ in range(7):
        bent = minimum.linear.about(minimum.after)
        minimum = LinearMinimum.of(linear, damping, 0.0, bent)
    assert minimum.promise > 0.0
    fall = linear.objective.value(linear.present) - linear.objective.value(minimum.after)
    assert_allclose(minimum.promise, fall, rtol=1e-6)
    rng = np.random.default_rng(2)
    undamped = dataclasses.replace(minimum.step, border=np.zeros(len(minimum.step.border)))
    for _ in range(5):
        along = Step(
            np.zeros(len(undamped.border)),
            STEP * rng.normal(size=(SAMPLES, 1)),
            rng.normal(size=minimum.step.turn.shape),
        )
        slopes = [
            abs(derivative(linear, at, along, damping, step))
            for at, step in ((linear.present, undamped.scaled(0.0)), (minimum.after, undamped))
        ]
        assert slopes[1] < 1e-2 * slopes[0]


def test_flat_sides_need_a_second_solution(linear: Linear) -> None:
    minimum = LinearMinimum.of(linear, 1e-3, 0.0)
    first = linear.step(linear.factored(1e-3), linear.residuals, 1e-3)
    value = linear.objective.value
    assert value(minimum.after) < value(linear.present)
    assert value(minimum.after) < value(linear.after(first, linear.present))
    # Nothing is solved again for what is not worth it.
    assert LinearMinimum.of(linear, 1e-3, np.inf).linear is linear


def test_where_solutions_go_up_a_part_of_the_first_step_goes_down(
    linear: Linear, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Laws that are steep although they should not be: parabolas a hundred times as steep, which
    # point the other way.
    def steep(linear: Linear, residuals: Residuals) -> Linear:
        position = -100.0 * linear.residuals["position"]
        return dataclasses.replace(linear, residuals={**linear.residuals, "position": position})

    monkeypatch.setattr(Linear, "about", steep)
    minimum = LinearMinimum.of(linear, 1e-3, 0.0)
    value = linear.objective.value
    assert minimum.promise > 0.0
    assert_allclose(minimum.promise, value(linear.present) - value(minimum.after))
    first = linear.step(linear.factored(1e-3), linear.residuals, 1e-3)
    ratio = minimum.step.position / first.position
    assert_allclose(ratio, ratio[0, 0], rtol=1e-6)
    assert 0.0 < ratio[0, 0] <= 0.5
