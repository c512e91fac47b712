"""Changes of many trainings by generated code: those of the rules themselves."""

import shutil
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.codegen import LONG, CArray, CFunction, Expressions, KernelText, assembly, traced
from jaxcslc.training import (
    PERAL,
    AbstractRule,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Examples,
    FixedRates,
    IdealPERAL,
    Plan,
    RuleStatements,
    _examples,
    _functions,
    _kernel as _change,
    _kernel_statements as _statements,
    batched_by,
    examples,
    fully_connected,
    half_rms,
    half_square,
    inverse_dynamics,
    mean_modulus,
    rule_statements,
    summed_change,
    train,
)
from jaxcslc.training._kernel_statements import Collected


PATTERNS = 30
#: Sums of patterns in another order, and products with reciprocals in place of quotients.
ROUNDING: Any = {"rtol": 1e-12, "atol": 1e-12}
RULES = (PERAL(), Backpropagation())
COSTS = (half_rms, half_square, mean_modulus)
needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="no C compiler (cc) on this machine"
)


def operations(statements: RuleStatements) -> int:
    """Return the number of sums, products and other functions of a pattern and a training."""
    graph, free = statements.graph, ("input", "constant", "fabs", "negate")
    rows = {value.index for value in statements.rows}
    computed = KernelText(graph, lambda _: None).needed(statements.sums, rows)
    return sum(graph.operations[i].name not in free for i in computed) + len(statements.sums)


@pytest.fixture(scope="module")
def arm() -> AdaptiveNetwork:
    """Two joints with friction: mass and velocity with contexts, and weights that links share."""
    robot = jc.Manipulator.from_modified_dh(
        [(0, 0, 0, 0), (np.pi / 2, 0.3, 0, 0)], gravity=(0, 0, -9.81)
    )
    return inverse_dynamics(jc.derive(robot.with_friction("viscous", "dry"), lengths="numeric"))


@pytest.fixture
def patterns(arm: AdaptiveNetwork, rng: np.random.Generator) -> Examples:
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, PATTERNS, 2))
    counts = rng.random((PATTERNS, 2)) < 0.8
    return examples(arm, (q, qd, qdd), rng.normal(size=(PATTERNS, 2)), counts)


@pytest.fixture
def masked(arm: AdaptiveNetwork, patterns: Examples, rng: np.random.Generator) -> Examples:
    """The same, and some pairs that only some subnetworks learn from."""
    shape = (len(arm.subnetworks), *patterns.counts.shape)
    masks = patterns.counts[None] * (rng.random(shape) < 0.7)
    return eqx.tree_at(lambda e: e.subnetwork_counts, patterns, masks, is_leaf=lambda x: x is None)


def statements_of(
    network: AdaptiveNetwork,
    rule: AbstractRule,
    learning: tuple[bool, ...],
    *,
    by_subnetwork: bool = False,
) -> RuleStatements:
    statements = rule_statements(network, rule, learning, by_subnetwork=by_subnetwork)
    assert statements is not None
    return statements


def changed_by_c(statements: RuleStatements, weights: np.ndarray, patterns: Examples) -> np.ndarray:
    stages = [
        "\n".join(["{", *statements.text("row[{0}]", "weights[{0}]", "sums[{0}]", stage), "}"])
        for stage in statements.stages
    ]
    factors = statements.factor_text("weights[{0}]", "sums[{0}] = {1} * sums[{0}];")
    rows = statements.row_text("inputs[{0} * patterns + i]", "row[{0}] = {1};")
    counts = patterns.learning_counts.reshape(-1, PATTERNS)
    inputs = np.concatenate(jax.tree.leaves((patterns.signals, patterns.targets, counts))).copy()
    source = (
        "#include <math.h>\ntypedef double real;\n"
        "void change(const double* inputs, const double* weights, double* sums, long patterns)\n"
        f"{{ double handed[{len(statements.stages[-1].handed_in) + 1}];\n"
        f"double row[{len(statements.rows)}];\n"
        "for (long i = 0; i < patterns; ++i) {\n"
    ) + "\n".join(["{", *rows, "}", *stages, "}", *factors, "}"])
    kinds = CArray("inputs patterns"), CArray("weights"), CArray("sums", written=True), LONG
    sums = np.zeros(len(statements.sums))
    CFunction(source, "change", kinds)(inputs, weights, sums, PATTERNS)
    change = np.zeros(statements.shape)
    change.flat[list(statements.entries)] = sums
    return change


@needs_compiler
@pytest.mark.parametrize("zero", [False, True], ids=["all weights", "some weights zero"])
@pytest.mark.parametrize("learning", [(True,) * 5, (True, False, True, True, False)])
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_statements_are_the_rules_own(
    arm: AdaptiveNetwork,
    patterns: Examples,
    rng: np.random.Generator,
    rule: AbstractRule,
    learning: tuple[bool, ...],
    *,
    zero: bool,
) -> None:
    """Compiled as C, with links that pass nothing, outputs that do not count, frozen layers."""
    learning = learning[: len(arm.groups)]
    weights = rng.normal(size=arm.size)
    if zero:
        weights[::2] = 0.0
    arrays = patterns.signals, patterns.targets, patterns.counts
    expected = rule.change(arm, jnp.asarray(weights), *arrays, learning)
    statements = statements_of(arm, rule, learning)
    assert_allclose(changed_by_c(statements, weights, patterns), expected, **ROUNDING)
    assert 0 < operations(statements) < 20 * sum(x.links.count for _, x in arm.adaptive_layers)


@needs_compiler
@pytest.mark.parametrize("learning", [(True,) * 5, (True, False, True, True, False)])
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_statements_with_masks_by_subnetwork(
    arm: AdaptiveNetwork,
    masked: Examples,
    rng: np.random.Generator,
    rule: AbstractRule,
    learning: tuple[bool, ...],
) -> None:
    weights = rng.normal(size=arm.size)
    arrays = masked.signals, masked.targets, masked.learning_counts
    expected = rule.change(arm, jnp.asarray(weights), *arrays, learning)
    plain = rule.change(arm, jnp.asarray(weights), *arrays[:2], masked.counts, learning)
    assert np.max(np.abs(expected - plain)) > 0.1
    statements = statements_of(arm, rule, learning, by_subnetwork=True)
    assert_allclose(changed_by_c(statements, weights, masked), expected, **ROUNDING)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_masks_by_subnetwork_cost_others_nothing(arm: AdaptiveNetwork, rule: AbstractRule) -> None:
    """Masks are inputs of a pattern, one an output without masks by subnetwork; the number of
    operations on the weights stays."""
    learning, outputs = (True,) * len(arm.groups), arm.outputs_count
    plain = statements_of(arm, rule, learning)
    masked = statements_of(arm, rule, learning, by_subnetwork=True)
    more = (len(arm.subnetworks) - 1) * outputs
    assert len(masked.inputs) == len(plain.inputs) + more
    assert len(plain.rows) <= len(masked.rows) <= len(plain.rows) + more
    assert operations(plain) <= operations(masked)


@needs_compiler
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
def test_stages_add_up_to_the_whole(
    arm: AdaptiveNetwork,
    patterns: Examples,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    rule: AbstractRule,
) -> None:
    """As few weights and sums in a stage as there can be: one for each output, one for several."""
    monkeypatch.setattr(_statements, "_MOST_KEPT", 0)
    monkeypatch.setattr(_statements, "_LEAST_SAVING", 2)
    learning = (True,) * len(arm.groups)
    weights = rng.normal(size=arm.size)
    _statements._rule_statements.cache_clear()
    statements = statements_of(arm, rule, learning)
    _statements._rule_statements.cache_clear()
    assert len(statements.stages) == 3
    assert statements.stages[-1].handed_in
    arrays = patterns.signals, patterns.targets, patterns.counts
    expected = rule.change(arm, jnp.asarray(weights), *arrays, learning)
    assert_allclose(changed_by_c(statements, weights, patterns), expected, **ROUNDING)


def test_what_patterns_decide_is_collected() -> None:
    """Of links that share a weight one product is left, and a single weight's share has none."""
    graph = Expressions()
    x, y, w, v = (graph.input(name) for name in ("x", "y", "weight 0", "weight 1"))
    collected = Collected(graph)
    (product,) = collected.expanded(x * w + y * w - 2.0 * w)
    assert collected.product_value(product).operation.text == "weight 0"

    def share(amount: Any, among: Any) -> Any:
        zero = graph.equal(among, graph.lift(0.0))
        some = graph.choice(zero, among, graph.lift(1.0))
        quotient = amount * graph.apply("reciprocal", some)
        return graph.choice(zero, quotient, graph.lift(0.0))

    modulus = graph.apply("fabs", x * w)
    names = [
        [collected.graph.operations[i].name for i in product]
        for product in collected.expanded(share(modulus, modulus))
    ]
    assert names == [["nonzero"]]
    form, factor = collected.factors(graph.apply("fabs", w) * share(modulus, modulus))
    assert list(form) == [()] and collected.product_value(factor).operation.name == "fabs"
    (two,) = collected.expanded(share(y, w * x + v))
    assert [collected.graph.operations[i].name for i in two] == ["inverse"]


def test_layouts_fit_a_multiprocessor(arm: AdaptiveNetwork) -> None:
    statements = statements_of(arm, PERAL(), (True,) * len(arm.groups))
    for trainings in (1, 5, 33, 70, 200, 4096):
        launch = _change.launch_layout(statements, trainings)
        assert launch is not None
        assert launch.threads >= min(trainings, 256)
        assert launch.resident * (launch.shared_bytes + 1024) <= 227 * 1024
        text = _change.source(statements, launch)
        assert text.count("{") == text.count("}") and "row[" not in text
    assert len(_change.rows_source(statements).splitlines()) > len(statements.rows)


def test_no_layout_where_rows_are_too_long(
    arm: AdaptiveNetwork, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_change, "SHARED_MEMORY", 1500)
    assert _change.launch_layout(statements_of(arm, PERAL(), (True,) * len(arm.groups)), 64) is None


@pytest.mark.parametrize("cost", COSTS)
def test_costs_are_sums_over_patterns(cost: Any, patterns: Examples) -> None:
    terms = _functions.error_sum(cost)
    assert terms is not None
    errors, counts = patterns.targets * patterns.counts, patterns.counts
    size = errors**2 if terms.square else jnp.abs(errors)
    sums = jnp.sum(size * terms.shares(counts), axis=0)
    total = jnp.sum(jnp.sqrt(sums) if terms.root else sums) * terms.scale(counts)
    assert_allclose(total, cost(errors, counts), **ROUNDING)
    assert _functions.error_sum(lambda errors, counts: jnp.sum(errors)) is None


def test_own_arguments_are_given_the_axis(rng: np.random.Generator) -> None:
    """Those that are mapped over and those that are not, in one map and in two."""
    sizes: list[int] = []

    def one(x: Array, y: Array, shared: Array) -> Array:
        return jnp.sum(x * y) + shared

    def many(x: Array, y: Array, shared: Array) -> Array:
        sizes.append(len(x))
        return jax.vmap(one, (0, 0, None))(x, y, shared)

    function = batched_by(one, many, 2)
    x, y, shared = (jnp.asarray(rng.normal(size=n)) for n in ((4, 3, 2), (3, 2), (4,)))
    inner, outer = (0, 0, None), (0, None, None)
    for axes in (outer, (0, None, 0)):
        value = shared if axes[2] == 0 else shared[0]
        expected = jax.vmap(jax.vmap(one, inner), axes)(x, y, value)
        assert_allclose(jax.vmap(jax.vmap(function, inner), axes)(x, y, value), expected)
    assert_allclose(jax.vmap(function, (None, 0, None))(x[0, 0], y, 1.0), y @ x[0, 0] + 1.0)
    assert set(sizes) == {3, 12}


def test_what_has_no_statements(arm: AdaptiveNetwork) -> None:
    """Rules with numbers of their own, hidden layers, and functions that expressions lack."""
    layers = (True,) * len(arm.groups)
    assert rule_statements(arm, IdealPERAL(jnp.ones(arm.size)), layers) is None
    hidden = fully_connected([2, 3, 1], ["hyperbolic tangent", "linear combiner"])
    assert rule_statements(hidden, Backpropagation(), (True, True)) is None
    assert rule_statements(fully_connected([2, 1], "logistic"), PERAL(), (True,)) is None

    class Preprocessing(PERAL):
        def change(self, network: AdaptiveNetwork, *args: Any, **kwargs: Any) -> Array:
            network.preprocess(jnp.zeros((1, 3, 2)))
            return super().change(network, *args, **kwargs)

    assert rule_statements(arm, Preprocessing(), layers) is None


def test_what_is_traced_and_what_is_not() -> None:
    graph = Expressions()
    x = np.array([graph.input("x"), graph.input("y")], object)

    def quarters(x: Array) -> Array:
        return jnp.where(x == 0.0, 1.0, jnp.abs(-x) ** 2 / 4.0).sum()

    values = traced(graph, quarters, [x])
    assert values is not None and values[0].shape == ()
    assert traced(graph, jnp.sort, [x]) is None
    one: Any = jax.jit(lambda y: jnp.zeros(()) if traced(graph, lambda x: x * y, [x]) else y)
    assert float(one(3.0)) == 3.0  # numbers that are not known


def test_batches_of_all_kinds(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights mapped once or twice go to the kernel, at once; patterns of their own do not."""
    network = fully_connected([3, 2], "linear combiner")
    patterns = examples(network, rng.normal(size=(10, 3)), rng.normal(size=(10, 2)))
    rule, learning, calls = Backpropagation(), (True,), list[int]()

    def change(weights: Array, signals: Any, targets: Array, counts: Array) -> Array:
        return rule.change(network, weights, signals, targets, counts, learning)

    def of_many(statements: RuleStatements, weights: Array, *arrays: Any) -> Array:
        calls.append(len(weights))
        return jax.vmap(lambda w: change(w, *arrays))(weights)

    monkeypatch.setattr(_change, "rule_kernel", rule_statements)
    monkeypatch.setattr(_change, "batched_changes", of_many)
    arrays = patterns.signals, patterns.targets, patterns.counts

    def fused(weights: Array, signals: Any, targets: Array, counts: Array) -> Array:
        return summed_change(network, rule, weights, signals, targets, counts, learning)

    def check(map_it: Callable[..., Any], *arguments: Any) -> None:
        expected = map_it(change)(*arguments)
        assert_allclose(map_it(fused)(*arguments), expected, **ROUNDING)

    weights = jnp.asarray(rng.normal(size=(2, 3, network.size)))
    shared = (None, None, None)
    check(lambda f: f, weights[0, 0], *arrays)
    assert not calls
    check(lambda f: jax.vmap(f, (0, *shared)), weights[0], *arrays)
    assert calls == [3]
    check(lambda f: jax.vmap(jax.vmap(f, (0, *shared)), (0, *shared)), weights, *arrays)
    assert calls[1:] == [3, 6]
    several = jax.tree.map(lambda x: jnp.stack([x, 0.5 * x, 2.0 * x]), arrays)
    check(jax.vmap, weights[0], *several)
    check(lambda f: jax.vmap(jax.vmap(f, (0, *shared)), (None, 0, 0, 0)), weights[0], *several)


@pytest.mark.gpu
@pytest.mark.parametrize("by_subnetwork", [False, True])
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.name)
@pytest.mark.parametrize("trainings", [1, 70])
def test_the_kernel_is_the_rule(
    arm: AdaptiveNetwork,
    patterns: Examples,
    masked: Examples,
    rng: np.random.Generator,
    rule: AbstractRule,
    trainings: int,
    *,
    by_subnetwork: bool,
) -> None:
    training_set = masked if by_subnetwork else patterns
    learning = (True,) * len(arm.groups)
    weights = jnp.asarray(rng.normal(size=(trainings, arm.size)))
    weights = weights.at[:, 0].set(1e-320)  # whose reciprocals are infinite
    arrays = training_set.signals, training_set.targets, training_set.learning_counts
    statements = statements_of(arm, rule, learning, by_subnetwork=by_subnetwork)
    changes = _change.batched_changes(statements, weights, *arrays)
    expected = jax.vmap(lambda w: rule.change(arm, w, *arrays, learning))(weights)
    assert_allclose(changes, expected, **ROUNDING)


@pytest.mark.gpu
@pytest.mark.parametrize("rates", [FixedRates(0.05), AdaptedRates(0.05)])
def test_trainings_by_the_kernel_are_those_without(
    arm: AdaptiveNetwork, patterns: Examples, masked: Examples, rng: np.random.Generator, rates: Any
) -> None:
    starts = rng.normal(size=(5, arm.size))
    for training_set in (patterns, masked):
        together = train(arm, training_set, starts, Plan(PERAL(), rates), epochs=20)
        for start, weights in zip(starts, np.asarray(together.weights), strict=True):
            alone = train(arm, training_set, start, Plan(PERAL(), rates), epochs=20, throw=False)
            assert_allclose(weights, alone.weights, rtol=1e-9, atol=1e-9)


@pytest.mark.gpu
@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("trials", [1, 3, 17])
def test_costs_by_the_kernel(
    arm: AdaptiveNetwork,
    patterns: Examples,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    cost: Any,
    trials: int,
) -> None:
    weights = jnp.asarray(rng.normal(size=(70, arm.size)))
    moved = np.zeros((len(arm.groups), arm.size))
    for row, (_, layer) in zip(moved, arm.adaptive_layers, strict=True):
        row[layer.links.weight] = 1.0
    change = jnp.asarray(moved * rng.normal(size=(70, *moved.shape)))
    rates = jnp.asarray(rng.random((70, trials, len(moved))))

    def costs() -> tuple[Array, Array]:
        present = jax.vmap(lambda w: patterns.costs(arm, w, cost)[0])(weights)
        after = jax.vmap(lambda w, c, r: patterns.trial_costs(arm, w, c, r, cost))
        return present, after(weights, change, rates)

    assert patterns.has_cost_kernel(arm, cost)
    by_kernel = costs()
    monkeypatch.setattr(_examples, "cost_kernel", lambda *_: None)
    for value, expected in zip(by_kernel, costs(), strict=True):
        assert_allclose(value, expected, **ROUNDING)


@pytest.mark.gpu
def test_assembly_of_the_kernel(arm: AdaptiveNetwork) -> None:
    statements = statements_of(arm, PERAL(), (True,) * len(arm.groups))
    launch = _change.launch_layout(statements, 4096)
    assert launch is not None
    assert ".entry changes" in assembly(_change.source(statements, launch))
    assert ".entry rows" in assembly(_change.rows_source(statements))
