"""Values of a graph for arrays of NumPy or JAX, and how JAX compiles: by platform, in blocks."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer
from jaxtyping import Array

from .._environment import array_namespace, platform_of
from ._expressions import Expressions, Operation, StraightLine, Value


X = TypeVar("X")
# Intermediate values of so many samples fit in a processor's second cache: a Panda's regressor
# takes 4 microseconds a sample in blocks of 500 to 1,000 and 30 in one piece of 20,000.
_BLOCK = 512


def by_platform(*arrays: Any, on_cpu: Callable[..., Any], elsewhere: Callable[..., Any]) -> Any:
    """Compute by one of two functions: on a processor, or on an accelerator.

    By the device of the arrays or, where JAX traces them, by what it compiles for. Where there is
    nothing but a processor the other way is not traced.
    """
    if jax.default_backend() == "cpu":
        return on_cpu(*arrays)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(arrays)):
        return lax.platform_dependent(*arrays, cpu=on_cpu, default=elsewhere)
    here = platform_of(*jax.tree.leaves(arrays))
    return on_cpu(*arrays) if here == "cpu" else elsewhere(*arrays)


def in_blocks(
    function: Callable[..., Array], arrays: tuple[Array, ...], *, samples_first: bool = False
) -> Array:
    """`function` of arrays (rows, samples), computed block by block of samples, results joined.

    The result of `function` has its samples last, or first with `samples_first`. A GPU computes
    all samples at once.
    """
    samples = arrays[0].shape[-1]
    if samples <= _BLOCK:
        return function(*arrays)
    cut_up = partial(_cut_up, function, samples_first=samples_first)
    return by_platform(*arrays, on_cpu=cut_up, elsewhere=function)


def _cut_up(function: Callable[..., Array], *arrays: Array, samples_first: bool) -> Array:
    samples = arrays[0].shape[-1]
    blocks = -(-samples // _BLOCK)
    missing = blocks * _BLOCK - samples

    def cut(x: Array) -> Array:
        filled = jnp.pad(x, ((0, 0), (0, missing)))
        return jnp.swapaxes(filled.reshape(x.shape[0], blocks, _BLOCK), 0, 1)

    def of_block(block: tuple[Any, ...]) -> Array:
        return function(*block)

    results = lax.map(of_block, tuple(cut(x) for x in arrays))
    if samples_first:
        return results.reshape(blocks * _BLOCK, *results.shape[2:])[:samples]
    joined = jnp.moveaxis(results, 0, -2)
    return joined.reshape(*joined.shape[:-2], blocks * _BLOCK)[..., :samples]


def in_stage(function: Callable[[X], list[Any]], x: X) -> list[Any]:
    """`function(x)`, compiled apart from what follows, its results held in memory.

    XLA fuses cheap producers into every consumer, which here means recomputing a product of
    sines and cosines in each place where it is used. On the CPU `lax.optimization_barrier` is
    removed before fusion and changes nothing. A conditional is not fused across, so this is one
    whose condition always holds, in a form that the compiler does not see through. Measured on
    the PUMA 560's regressor, 2,048 patterns a block: 0.4 million patterns/s without, 1.1 with,
    on one core of a busy machine.

    Outside of `jit` nothing is fused, and a conditional would be compiled anew at every call.
    """
    first = jax.tree.leaves(x)[0]
    if first.size == 0 or not isinstance(first, Tracer):
        return function(x)
    shapes = jax.eval_shape(function, x)
    number = jnp.ravel(first)[0]
    return jax.lax.cond(
        ~((number > 0) & (number < 0)),
        function,
        lambda _: [jnp.zeros(shape.shape, shape.dtype) for shape in shapes],
        x,
    )


# Operations that a processor's compiler gets at once. More of them, and it computes what several
# need in each of them again, up to 15 times: a Panda's torque takes five times as long in stages of
# 600 operations as in stages of 40.
_STAGE = 40


def motion_outputs(
    code: StraightLine, k: Any, *motion: Sequence[Any], stage: int | None = _STAGE
) -> list[Any]:
    """Values of a motion, each an array of the motion's shape.

    - `k`: its coefficients, if it has some.
    - `motion`: of q, qd and qdd as many as the values need, an array per joint each.
    - `stage`: as of `array_outputs`.
    """
    inputs = {} if k is None else named("k", [k[i] for i in range(len(k))])
    for name, joints in zip(("q", "qd", "qdd"), motion, strict=False):
        inputs |= named(name, joints)
    like = motion[0][0]
    outputs = array_outputs(code.graph, code.outputs, inputs, stage=stage)
    return [jnp.broadcast_to(x, like.shape).astype(like.dtype) for x in outputs]


def named(name: str, values: Iterable[Any]) -> dict[str, Any]:
    """Inputs of a graph: `name[0]`, `name[1]` and so on."""
    return {f"{name}[{i}]": value for i, value in enumerate(values)}


def array_outputs(
    graph: Expressions,
    outputs: Sequence[Value],
    inputs: Mapping[str, Any],
    *,
    stage: int | None = _STAGE,
) -> list[Any]:
    """Values of a graph, of arrays of NumPy's or JAX's that are broadcast against each other.

    - `inputs`: by the names that they have in the graph.
    - `stage`: how many operations a processor's compiler gets at once, behind sines and cosines;
      other platforms' get all. None for sines and cosines, then all others, on every platform.

    An output that is constant is a number.

    >>> import numpy as np
    >>> graph = Expressions()
    >>> x = graph.input("x")
    >>> [total] = array_outputs(graph, [x * x + 1.0], {"x": np.array([1.0, 2.0])})
    >>> total.tolist()
    [2.0, 5.0]
    """
    order = graph.needed(outputs)
    values: dict[int, Any] = {}
    operations: list[int] = []
    for index in order:
        operation = graph.operations[index]
        if operation.name == "input":
            values[index] = inputs[operation.text]
        elif operation.name == "constant":
            values[index] = operation.number
        else:
            operations.append(index)
    xp = array_namespace(*values.values())
    kept = {output.index for output in outputs}
    results = sorted(kept & set(operations))

    def at_once(before: dict[int, Any]) -> list[Any]:
        of_graph = dict(before)
        _compute(xp, graph, operations, of_graph, kept)
        return [of_graph[index] for index in results]

    def in_stages(before: dict[int, Any]) -> list[Any]:
        of_graph = numbers | before
        for part, later in _stages(graph, operations, stage):
            if stage is None and not later:  # fused with what follows
                _compute(xp, graph, part, of_graph, kept)
            else:
                _compute_stage(xp, graph, part, of_graph, kept | later)
        return [of_graph[index] for index in results]

    numbers = {index: x for index, x in values.items() if isinstance(x, float)}
    if xp is np:
        made = at_once(values)
    else:
        arrays = {index: x for index, x in values.items() if index not in numbers}
        whole = lambda before: at_once(numbers | before)
        elsewhere = in_stages if stage is None else whole
        made = by_platform(arrays, on_cpu=in_stages, elsewhere=elsewhere)
    values.update(zip(results, made, strict=True))
    return [values[output.index] for output in outputs]


def _compute(
    xp: Any, graph: Expressions, operations: Sequence[int], values: dict[int, Any], kept: set[int]
) -> None:
    """Adds the operations' values; those that nothing needs any more are let go of."""
    uses: dict[int, int] = {}
    for index in operations:
        for argument in graph.operations[index].arguments:
            uses[argument] = uses.get(argument, 0) + 1
    for index in operations:
        operation = graph.operations[index]
        values[index] = _value(xp, operation, [values[i] for i in operation.arguments])
        for argument in operation.arguments:
            uses[argument] -= 1
            if not uses[argument] and argument not in kept:
                del values[argument]


def _stages(
    graph: Expressions, operations: Sequence[int], most: int | None
) -> Iterator[tuple[list[int], set[int]]]:
    """Sines and cosines, then operations in their order, with what the later stages need."""
    functions = [i for i in operations if graph.operations[i].name in ("sin", "cos")]
    angles = _below(graph, functions, set(operations))
    first = [i for i in operations if i in angles]
    remaining = [i for i in operations if i not in angles]
    stages, iterator = ([first] if first else []), iter(remaining)
    while stage := list(islice(iterator, most)):
        stages.append(stage)
    later = [set[int]()]
    for stage in reversed(stages):
        later.append(later[-1].union(*(graph.operations[i].arguments for i in stage)))
    return zip(stages, reversed(later[:-1]), strict=True)


def _below(graph: Expressions, values: Sequence[int], among: set[int]) -> set[int]:
    """Values and what they are computed from."""
    below: set[int] = set()
    todo = list(values)
    while todo:
        index = todo.pop()
        if index in among and index not in below:
            below.add(index)
            todo += graph.operations[index].arguments
    return below


def _compute_stage(
    xp: Any, graph: Expressions, stage: Sequence[int], values: dict[int, Any], kept: set[int]
) -> None:
    """Adds those of a stage's values that are kept, which are then in memory."""
    inside = set(stage)
    arguments = {i for index in stage for i in graph.operations[index].arguments} - inside
    numbers = {i: values[i] for i in arguments if isinstance(values[i], float)}
    arrays = sorted(arguments - numbers.keys())
    results = [index for index in stage if index in kept]

    def computed(before: list[Any]) -> list[Any]:
        of_stage = numbers | dict(zip(arrays, before, strict=True))
        _compute(xp, graph, stage, of_stage, set(results))
        return [of_stage[index] for index in results]

    made = in_stage(computed, [values[index] for index in arrays])
    values.update(zip(results, made, strict=True))


def _value(xp: Any, operation: Operation, arguments: Sequence[Any]) -> Any:
    match operation.name:
        case "negate":
            return -arguments[0]
        case "positive":
            return xp.maximum(arguments[0], 0.0)
        case "negative":
            return xp.minimum(arguments[0], 0.0)
        case name:
            return getattr(xp, name)(*arguments)
