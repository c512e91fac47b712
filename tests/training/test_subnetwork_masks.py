"""Masks by subnetwork (thesis 7.2.2): friction learns from other pairs than the rest."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from jaxcslc.training import (
    HYPERBOLIC_TANGENT,
    LINEAR_COMBINER,
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    IdealPERAL,
    Layer,
    Links,
    PerceptronRule,
    Plan,
    Signals,
    Subnetwork,
    examples,
    fully_connected,
    half_rms,
    half_square,
    inverse_dynamics,
    linear_combiner,
    normal_equations,
    subnetwork_masks,
    train,
    with_normal_equations,
)
from tests.training import _transcription as thesis
from tests.training._problems import (
    Problem,
    change,
    five_subnetworks,
    problem,
    sparse,
    transcribed,
    two_adaptive_and_a_context,
)


SAMPLES = 40
RULES = (Backpropagation(), PERAL())
LITERALLY: dict[str, Callable[..., thesis.Moves]] = {
    "backpropagation": thesis.backpropagation,
    "PERAL": thesis.peral,
}
#: Sums in another order.
ROUNDING: Any = {"rtol": 1e-11, "atol": 1e-12}


@pytest.fixture(scope="module")
def cslc() -> jc.CSLC:
    """Two joints with friction; torques in a plane that gravity leaves upright."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)], gravity=(0, 0, -9.81)
    )
    return jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric")


@pytest.fixture(scope="module")
def arm(cslc: jc.CSLC) -> AdaptiveNetwork:
    return inverse_dynamics(cslc)


@pytest.fixture
def recorded(cslc: jc.CSLC, rng: np.random.Generator) -> jc.Patterns:
    """Torques with noise; a third of the pairs slow, a fifth in possible backlash."""
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, SAMPLES, 2))
    k = rng.uniform(0.5, 1.5, cslc.size)
    torque = np.asarray(cslc.torque(k, q, qd, qdd)) + 0.3 * rng.normal(size=q.shape)
    slow, backlash = rng.random((SAMPLES, 2)) < 0.35, rng.random((SAMPLES, 2)) < 0.2
    return jc.Patterns(np.arange(float(SAMPLES)), q, qd, qdd, torque, ~backlash, ~slow)


@pytest.fixture
def masked(arm: AdaptiveNetwork, recorded: jc.Patterns) -> Examples:
    return examples(arm, recorded, recorded.torque, subnetwork_masks(arm, recorded))


def random_masks(rng: np.random.Generator, case: Problem) -> np.ndarray:
    """Of each subnetwork; one pattern that counts for none, one that counts for the first alone."""
    shape = (len(case.network.subnetworks), *case.t.shape)
    masks = (rng.random(shape) < 0.6).astype(float)
    masks[:, 2] = 0.0
    masks[1:, 4], masks[0, 4] = 0.0, 1.0
    return masks


def test_friction_alone_leaves_slow_pairs(arm: AdaptiveNetwork, recorded: jc.Patterns) -> None:
    masks = subnetwork_masks(arm, recorded)
    for name, mask in zip(arm.groups, masks, strict=True):
        expected = recorded.mask if name in ("viscous", "dry") else recorded.backlash_mask
        assert_array_equal(mask, expected, err_msg=name)


def test_springs_are_no_friction_and_load_is(rng: np.random.Generator) -> None:
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)], gravity=(0, 0, -9.81)
    ).with_friction("viscous", "static", "spring", "load")
    arm = inverse_dynamics(jc.derive(robot, lengths="numeric"))
    motion, every = rng.normal(size=(3, 2)), np.ones((3, 2), bool)
    slow = jc.Patterns(np.arange(3.0), motion, motion, motion, motion, every, ~every)
    masks = subnetwork_masks(arm, slow)
    without = [name for name, mask in zip(arm.groups, masks, strict=True) if not mask.any()]
    assert without == ["viscous", "static", "load"]


def test_what_costs_and_what_learns(arm: AdaptiveNetwork, recorded: jc.Patterns) -> None:
    masks = subnetwork_masks(arm, recorded)
    training_set = examples(arm, recorded, recorded.torque, masks)
    assert_array_equal(training_set.counts, recorded.backlash_mask.T)
    assert_array_equal(training_set.learning_counts, np.swapaxes(masks, 1, 2))
    assert float(training_set.patterns) == recorded.backlash_mask.any(axis=1).sum()
    plain = examples(arm, recorded, recorded.torque, recorded.backlash_mask)
    assert plain.subnetwork_counts is None
    k = jnp.ones(arm.size)
    for one, other in zip(
        training_set.costs(arm, k, half_rms, half_square),
        plain.costs(arm, k, half_rms, half_square),
        strict=True,
    ):
        assert float(one) == float(other)


# PERAL's change of one pattern is that of a batch of one.
@pytest.mark.parametrize(
    ("rule", "order"),
    [(Backpropagation(), "batch"), (Backpropagation(), "sequential"), (PERAL(), "batch")],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_equal_masks_are_one_mask(
    arm: AdaptiveNetwork, recorded: jc.Patterns, rule: AbstractRule, order: Any
) -> None:
    """To the last digit, rates that follow costs included."""
    one_mask = np.asarray(recorded.mask)
    masks = np.broadcast_to(one_mask, (len(arm.groups), *one_mask.shape))
    plan = Plan(rule, AdaptedRates(0.01), order=order)
    alike, plain = (
        train(
            arm,
            examples(arm, recorded, recorded.torque, mask),
            np.full(arm.size, 0.5),
            plan,
            epochs=12,
            throw=False,
        )
        for mask in (masks, one_mask)
    )
    assert_array_equal(alike.history.weights, plain.history.weights)
    assert_array_equal(alike.history.cost, plain.history.cost)


def test_equal_masks_have_the_same_normal_equations(
    arm: AdaptiveNetwork, recorded: jc.Patterns
) -> None:
    one_mask = np.asarray(recorded.mask)
    masks = np.broadcast_to(one_mask, (len(arm.groups), *one_mask.shape))
    alike, plain = (
        normal_equations(arm, examples(arm, recorded, recorded.torque, mask))
        for mask in (masks, one_mask)
    )
    for one, other in zip(jax.tree.leaves(alike), jax.tree.leaves(plain), strict=True):
        assert_allclose(one, other, **ROUNDING)


CASES: dict[str, Callable[[np.random.Generator], Problem]] = {
    "five subnetworks": lambda rng: five_subnetworks(rng, LINEAR_COMBINER),
    "five of hyperbolic tangents": lambda rng: five_subnetworks(rng, HYPERBOLIC_TANGENT),
    "two adaptive layers": lambda rng: two_adaptive_and_a_context(rng, LINEAR_COMBINER),
}


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
@pytest.mark.parametrize("name", CASES)
def test_change_is_the_thesis_s(rng: np.random.Generator, rule: AbstractRule, name: str) -> None:
    """Link by link and pattern by pattern, also with a subnetwork frozen."""
    case = CASES[name](rng)
    if rule.check_network(case.network) is not None:
        assert name == "two adaptive layers"
        return
    masks = random_masks(rng, case)
    groups = len(case.network.groups)
    for learning in ((True,) * groups, (False,) + (True,) * (groups - 1)):
        changed = change(rule, case.network, case.k, case.training_set(masks), learning)
        expected = case.literally(LITERALLY[rule.name], learning, masks)
        assert_allclose(changed, expected, **ROUNDING)


def test_change_of_ideal_peral_is_the_thesis_s(rng: np.random.Generator) -> None:
    parts = [
        Subnetwork(name, (Layer(sparse(rng, 4, 3, weights)),))
        for name, weights in (("a", range(4)), ("b", range(2, 7)))
    ]
    case = problem(rng, parts, LINEAR_COMBINER, 7)
    masks, optimum = random_masks(rng, case), rng.normal(size=7)

    def literally(*arguments: Any) -> thesis.Moves:
        return thesis.peral(*arguments, optimum=optimum)

    changed = change(
        IdealPERAL(jnp.asarray(optimum)), case.network, case.k, case.training_set(masks)
    )
    assert_allclose(changed, case.literally(literally, counts=masks), **ROUNDING)


def test_change_of_the_perceptron_rule(rng: np.random.Generator) -> None:
    """Of one subnetwork, whose masks are those of all."""
    network = fully_connected([2, 2], "hard limiter")
    x, k = rng.normal(size=(9, 2)), jnp.asarray(rng.normal(size=network.size))
    t, mask = rng.random((2, 9, 2)) < 0.6
    one = examples(network, x, t.astype(float), mask)
    masked = examples(network, x, t.astype(float), mask[None])
    changed = change(PerceptronRule(), network, k, masked)
    assert_array_equal(changed, change(PerceptronRule(), network, k, one))
    assert np.any(changed)


def arm_literally(arm: AdaptiveNetwork, training_set: Examples, k: np.ndarray) -> Problem:
    """The two-joint arm and its patterns for the transcription."""
    signals = training_set.signals
    return Problem(
        arm,
        [transcribed(part) for part in arm.subnetworks],
        thesis.IDENTITY,
        [np.asarray(x).T for x in signals.inputs],
        [[np.asarray(c).T for c in contexts] for contexts in signals.contexts],
        np.asarray(training_set.targets).T,
        k,
    )


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_an_epoch_of_the_arm_is_the_thesis_s(
    arm: AdaptiveNetwork,
    recorded: jc.Patterns,
    masked: Examples,
    rng: np.random.Generator,
    rule: AbstractRule,
) -> None:
    k = rng.uniform(0.5, 1.5, arm.size)
    case = arm_literally(arm, masked, k)
    masks = subnetwork_masks(arm, recorded).astype(float)
    expected = k + 0.05 * case.literally(LITERALLY[rule.name], counts=masks).sum(axis=0)
    trained = train(arm, masked, k, Plan(rule, FixedRates(0.05)), epochs=1, throw=False)
    assert_allclose(trained.weights, expected, **ROUNDING)


def test_a_sequential_epoch_of_the_arm(
    arm: AdaptiveNetwork, recorded: jc.Patterns, masked: Examples, rng: np.random.Generator
) -> None:
    """One pattern after the other, in the order that the key draws."""
    start = rng.uniform(0.5, 1.5, arm.size)
    masks, case = subnetwork_masks(arm, recorded).astype(float), arm_literally(arm, masked, start)
    state_key = jax.random.key(3)
    sequence = jax.random.permutation(jax.random.fold_in(state_key, 0), SAMPLES)
    k = start
    for p in np.asarray(sequence):
        moves = thesis.backpropagation(
            case.parts,
            case.f,
            [x[p] for x in case.xs],
            [[c[p] for c in contexts] for contexts in case.contexts],
            case.t[p],
            k,
            masks[:, p],
        )
        move = thesis.average_over_links(case.parts, moves, arm.size, by_chain_rule=True)
        k = k + 0.01 * move.sum(axis=0)
    plan = Plan(Backpropagation(), FixedRates(0.01), order="sequential")
    trained = train(arm, masked, start, plan, epochs=1, key=state_key, throw=False)
    assert_allclose(trained.weights, k, **ROUNDING)


def zeroed_columns(
    cslc: jc.CSLC, patterns: jc.Patterns
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """X, Z and t of the pairs that count, by NumPy: Z has friction's columns zero at slow pairs."""
    x = np.array(cslc.regressor(patterns.q, patterns.qd, patterns.qdd))
    z = x.copy()
    friction = np.concatenate([cslc.layout.indices(kind) for kind in ("viscous", "dry")])
    z[..., friction] *= np.asarray(patterns.friction_mask)[..., None]
    kept = np.asarray(patterns.backlash_mask)
    return x[kept], z[kept], np.asarray(patterns.torque)[kept]


def test_normal_equations_are_of_both(
    cslc: jc.CSLC, arm: AdaptiveNetwork, recorded: jc.Patterns, masked: Examples
) -> None:
    """Costs of all pairs, changes of each subnetwork's; the sum of parts is not symmetric."""
    made = normal_equations(arm, masked)
    x, z, t = zeroed_columns(cslc, recorded)
    number = float(masked.patterns)
    assert_allclose(made.gram, x.T @ x / number, **ROUNDING)
    assert_allclose(made.moment, x.T @ t / number, **ROUNDING)
    parts = np.asarray(made.layered_gram.sum(axis=0))
    assert_allclose(parts, z.T @ x / number, **ROUNDING)
    assert_allclose(made.layered_moment.sum(axis=0), z.T @ t / number, **ROUNDING)
    assert np.max(np.abs(parts - parts.T)) > 1e-3
    k, learning = jnp.ones(arm.size), (True,) * len(arm.groups)
    expected = masked.change(arm, Backpropagation(), k, learning)
    assert_allclose(made.change(arm, k, learning), expected, **ROUNDING)
    (cost,) = masked.costs(arm, k, half_square)
    assert_allclose(made.cost(k), cost, **ROUNDING)


def test_training_ends_at_the_direct_solution(
    cslc: jc.CSLC, arm: AdaptiveNetwork, recorded: jc.Patterns, masked: Examples
) -> None:
    """Where the cost is above its lowest: patience for epochs without a new lowest is needed."""
    x, z, t = zeroed_columns(cslc, recorded)
    expected = np.linalg.solve(z.T @ x, z.T @ t)
    made = normal_equations(arm, masked)
    assert_allclose(made.solution(), expected, rtol=1e-9)
    least_squares = np.linalg.lstsq(x, t, rcond=None)[0]
    assert np.max(np.abs(expected - least_squares)) > 1e-3
    highest = np.max(np.abs(np.linalg.eigvals(made.layered_gram.sum(axis=0))))
    epochs = 30_000
    rates = FixedRates(2.0 / highest)  # shared weights move by less
    plan = Plan(Backpropagation(), rates, cost=half_square, patience=epochs)
    solvable = with_normal_equations(arm, masked)
    ended = train(arm, solvable, np.zeros(arm.size), plan, epochs=epochs, keep_weights=False)
    assert float(ended.cost) > float(np.min(ended.history.cost))
    assert_allclose(ended.weights, expected, rtol=1e-6)


def test_without_masks_the_solution_is_least_squares(
    cslc: jc.CSLC, arm: AdaptiveNetwork, recorded: jc.Patterns
) -> None:
    training_set = examples(arm, recorded, recorded.torque, recorded.mask)
    solved = jc.LeastSquares(joint_weights="equal", errors="independent").fit(cslc, recorded).k
    assert_allclose(normal_equations(arm, training_set).solution(), solved, rtol=1e-8)


def test_static_friction_at_slow_pairs_does_no_harm(
    cslc: jc.CSLC, arm: AdaptiveNetwork, recorded: jc.Patterns, rng: np.random.Generator
) -> None:
    """A disturbance of slow pairs that correlates with friction alone: the truth is found, and
    least squares over the same pairs misses it."""
    truth = rng.uniform(0.5, 1.5, cslc.size)
    torque = np.array(cslc.torque(truth, recorded.q, recorded.qd, recorded.qdd))
    slow = ~np.asarray(recorded.friction_mask) & np.asarray(recorded.backlash_mask)
    x = np.asarray(cslc.regressor(recorded.q, recorded.qd, recorded.qdd))[slow]
    friction = np.concatenate([cslc.layout.indices(kind) for kind in ("viscous", "dry")])
    others = np.delete(x, friction, axis=1)
    disturbance = np.sign(np.asarray(recorded.qd)[slow])
    disturbance -= others @ np.linalg.lstsq(others, disturbance, rcond=None)[0]
    torque[slow] += disturbance
    by_subnetwork, by_pair = (
        normal_equations(arm, examples(arm, recorded, torque, mask)).solution()
        for mask in (subnetwork_masks(arm, recorded), recorded.backlash_mask)
    )
    assert_allclose(by_subnetwork, truth, rtol=1e-9)
    assert np.max(np.abs(by_pair - truth)) > 0.01


def test_weights_that_patterns_leave_open() -> None:
    """Two inputs that are proportional: the smallest weights in proportion to them."""
    network = fully_connected([2, 1], "linear combiner", bias=False)
    x = np.array([[1.0, 2.0], [-2.0, -4.0], [3.0, 6.0]])
    training_set = examples(network, x, x[:, :1])
    assert_allclose(normal_equations(network, training_set).solution(), [0.5, 0.25], rtol=1e-9)


def test_recordings_side_by_side(
    arm: AdaptiveNetwork, recorded: jc.Patterns, rng: np.random.Generator
) -> None:
    """Patterns and masks with a leading axis, by `vmap` of everything."""
    masks = subnetwork_masks(arm, recorded)
    swapped = np.stack([masks, masks[:, ::-1]])
    torques = rng.normal(size=(2, SAMPLES, 2))
    motion = (recorded.q, recorded.qd, recorded.qdd)
    several = jax.vmap(lambda t, c: examples(arm, motion, t, c))(torques, swapped)
    assert several.trainings == 2
    plan = Plan(Backpropagation(), AdaptedRates(0.01))
    start = np.full(arm.size, 0.5)
    together = train(arm, several, start, plan, epochs=5)
    solutions = jax.vmap(lambda one: normal_equations(arm, one))(several).solution()
    for at, (t, c) in enumerate(zip(torques, swapped, strict=True)):
        one = examples(arm, motion, t, c)
        alone = train(arm, one, start, plan, epochs=5, throw=False)
        assert_allclose(together.weights[at], alone.weights, **ROUNDING)
        assert_allclose(solutions[at], normal_equations(arm, one).solution(), rtol=1e-8)


def test_starts_side_by_side(
    arm: AdaptiveNetwork, masked: Examples, rng: np.random.Generator
) -> None:
    starts = rng.uniform(0.5, 1.5, (3, arm.size))
    for rule in RULES:
        plan = Plan(rule, FixedRates(0.01))
        together = train(arm, masked, starts, plan, epochs=5)
        for start, weights in zip(starts, together.weights, strict=True):
            alone = train(arm, masked, start, plan, epochs=5, throw=False)
            assert_allclose(weights, alone.weights, **ROUNDING)


def test_refused(cslc: jc.CSLC, arm: AdaptiveNetwork, recorded: jc.Patterns) -> None:
    masks = subnetwork_masks(arm, recorded)
    wrong = masks[:3]
    plain: Any = getattr(examples, "__wrapped__", examples)  # past the check of axes' names
    with pytest.raises(ValueError) as failure:
        plain(arm, recorded, recorded.torque, wrong)
    assert str(failure.value) == (
        f"counts: expected shape ({SAMPLES}, 2), or (5, {SAMPLES}, 2) for masks by subnetwork, got"
        f" (3, {SAMPLES}, 2)"
    )
    # All that the first joint's friction could learn from is slow; the other subnetworks know it.
    masks[3:, :, 0] = False
    with pytest.raises(ValueError, match=r"^masks leave no data for kv1, kd1: of every pattern"):
        examples(arm, recorded, recorded.torque, masks)
    with pytest.raises(ValueError, match="expected a network from `inverse_dynamics`, got one"):
        subnetwork_masks(linear_combiner(cslc), recorded)


def test_ideal_peral_refuses_signs_by_subnetwork(rng: np.random.Generator) -> None:
    """Where the second subnetwork learns, its inputs have the same signs throughout."""
    both = [Layer(Links(2, 1, [0, 1], [0, 0], [at, at + 1])) for at in (0, 2)]
    parts = [Subnetwork(name, (layer,)) for name, layer in zip("ab", both, strict=True)]
    case = problem(rng, parts, LINEAR_COMBINER, 4)
    x = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    signals = Signals((jnp.asarray(x.T),) * 2, ((), ()))
    masks = np.ones((2, 1, 4))
    rule = IdealPERAL(jnp.ones(4))
    assert rule.check_patterns(case.network, signals, jnp.asarray(masks)) is None
    masks[1, 0, 1:3] = 0.0
    reason = rule.check_patterns(case.network, signals, jnp.asarray(masks))
    assert reason is not None and reason.startswith("ideal PERAL: input signs have rank 1")
