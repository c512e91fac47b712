"""Expressions of functions of JAX's arrays."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from ._expressions import Expressions, Value


# Operations that move numbers and compute nothing, and the same of NumPy's arrays.
_MOVES: dict[str, Callable[..., Any]] = {
    "broadcast_in_dim": lambda arrays, p: _broadcast(arrays[0], p),
    "concatenate": lambda arrays, p: np.concatenate(arrays, axis=p["dimension"]),
    "reshape": lambda arrays, p: arrays[0].reshape(p["new_sizes"]),
    "slice": lambda arrays, p: arrays[0][_slices(p)],
    "squeeze": lambda arrays, p: np.squeeze(arrays[0], axis=tuple(p["dimensions"])),
    "stack": lambda arrays, p: np.stack(arrays, axis=p["axis"]),
    "transpose": lambda arrays, p: np.transpose(arrays[0], p["permutation"]),
}
# Functions inside of functions, by the parameter that they are in.
_CALLS = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
}


def traced(
    graph: Expressions,
    function: Callable[..., Any],
    arguments: Sequence[np.ndarray],
) -> list[np.ndarray] | None:
    """Return the expressions of a function of JAX's arrays: the arithmetic of its results, one by
    one.

    Sums of products with matrices that are mostly zero, which JAX computes as such, lose
    everything that is multiplied by zero.

    **Arguments**

    - `function`: of arrays, traced for their shapes.
    - `arguments`: arrays of values of the graph.

    **Returns** an array of values for each leaf of the result; None if the function has operations
    that expressions have no counterpart of, or needs numbers that are not known.

    >>> import jax.numpy as jnp, numpy as np
    >>> from jaxcslc.codegen import Expressions, traced
    >>> graph = Expressions()
    >>> x = np.array([graph.input("x"), graph.input("y")])
    >>> [total] = traced(graph, lambda x: jnp.array([[2.0, 0.0]]) @ x, [x])
    >>> graph.cost(total)
    1
    """
    shapes = [jax.ShapeDtypeStruct(x.shape, float) for x in arguments]
    closed: Any = jax.make_jaxpr(function)(*shapes)
    if any(isinstance(x, Tracer) for x in closed.consts):
        return None
    try:
        with jax.ensure_compile_time_eval():
            return _evaluated(graph, closed.jaxpr, closed.consts, arguments)
    except _UnknownError:
        return None


class _UnknownError(Exception):
    """An operation that expressions have no counterpart of."""


def _evaluated(graph: Expressions, jaxpr: Any, constants: Any, inputs: Any) -> list[Any]:
    """Numbers are computed as JAX would, what inputs are needed for as expressions."""
    values: dict[Any, Any] = dict(zip(jaxpr.constvars, map(np.asarray, constants), strict=True))
    values.update(zip(jaxpr.invars, inputs, strict=True))

    def read(atom: Any) -> np.ndarray:
        return np.asarray(atom.val) if hasattr(atom, "val") else values[atom]

    for equation in jaxpr.eqns:
        arguments = [read(atom) for atom in equation.invars]
        name, parameters = equation.primitive.name, equation.params
        known = all(x.dtype != object for x in arguments)
        if name in _CALLS:
            inner = parameters[_CALLS[name]]
            results = _evaluated(graph, inner.jaxpr, inner.consts, arguments)
        elif known and name in _MOVES:
            results = [np.asarray(_MOVES[name](arguments, parameters))]
        elif known:
            bound = equation.primitive.bind(*map(jnp.asarray, arguments), **parameters)
            results = bound if equation.primitive.multiple_results else [bound]
            results = [np.asarray(x) for x in results]
        else:
            results = [_applied(graph, equation, arguments)]
        values.update(zip(equation.outvars, results, strict=True))
    return [_lifted(graph, read(atom)) for atom in jaxpr.outvars]


def _applied(graph: Expressions, equation: Any, arguments: list[np.ndarray]) -> np.ndarray:
    name, parameters = equation.primitive.name, equation.params
    if name in _MOVES:
        return np.asarray(_MOVES[name]([_lifted(graph, x) for x in arguments], parameters), object)
    if name == "gather":
        return _gathered(graph, equation, arguments)
    if name == "convert_element_type" and parameters["new_dtype"] == np.float64:
        return arguments[0]
    if name == "scatter-add":
        return _scattered(graph, equation, arguments)
    lifted = [_lifted(graph, x) for x in arguments]
    if name == "dot_general":
        (left, right), batch = parameters["dimension_numbers"]
        if batch == ((), ()):
            return np.asarray(np.tensordot(*lifted, axes=(left, right)), object)
    if name == "integer_pow" and parameters["y"] >= 0:
        return np.asarray(lifted[0] ** parameters["y"], object)
    if name == "reduce_sum":
        return np.asarray(np.sum(lifted[0], axis=parameters["axes"]), object)
    if name in _ELEMENTWISE:
        function = np.frompyfunc(functools.partial(_ELEMENTWISE[name], graph), len(lifted), 1)
        return np.asarray(function(*lifted), object)
    raise _UnknownError(name)


def _lifted(graph: Expressions, x: np.ndarray) -> np.ndarray:
    if x.dtype == object:
        return x
    if x.dtype == bool:
        raise _UnknownError("bool")
    return np.asarray(np.frompyfunc(graph.lift, 1, 1)(x.astype(float)), object)


def _broadcast(x: np.ndarray, parameters: Any) -> np.ndarray:
    shape, where = parameters["shape"], parameters["broadcast_dimensions"]
    wide = [1] * len(shape)
    for axis, size in zip(where, x.shape, strict=True):
        wide[axis] = size
    return np.broadcast_to(x.reshape(wide), shape)


def _slices(parameters: Any) -> tuple[slice, ...]:
    starts, ends = parameters["start_indices"], parameters["limit_indices"]
    strides = parameters["strides"] or [1] * len(starts)
    return tuple(map(slice, starts, ends, strides))


def _gathered(graph: Expressions, equation: Any, arguments: list[np.ndarray]) -> np.ndarray:
    """Single values, by an index along every axis."""
    operand, indices = arguments
    numbers = equation.params["dimension_numbers"]
    single = not numbers.offset_dims and set(equation.params["slice_sizes"]) == {1}
    where = _places(operand, indices, numbers.start_index_map, single=single)
    return _lifted(graph, operand)[where]


def _scattered(graph: Expressions, equation: Any, arguments: list[np.ndarray]) -> np.ndarray:
    """Single values are added, each where an index along every axis says."""
    operand, indices, updates = arguments
    numbers = equation.params["dimension_numbers"]
    single = not numbers.update_window_dims
    where = _places(operand, indices, numbers.scatter_dims_to_operand_dims, single=single)
    result = _lifted(graph, operand).copy()
    for *at, update in zip(*where, _lifted(graph, updates), strict=True):
        result[tuple(at)] = result[tuple(at)] + update
    return result


def _places(
    operand: np.ndarray, indices: np.ndarray, axes: tuple[int, ...], *, single: bool
) -> tuple[np.ndarray, ...]:
    """Indices along every axis, the last axis of an array of them."""
    known = indices.dtype != object and axes == tuple(range(operand.ndim))
    if not single or not known or np.any(indices < 0) or np.any(indices >= operand.shape):
        raise _UnknownError("indices")
    return tuple(np.moveaxis(indices, -1, 0))


def _divided(graph: Expressions, x: Value, y: Value) -> Value:
    if x.is_zero:
        return x
    return x / y.number if y.number else x * graph.apply("reciprocal", y)


def _choice(graph: Expressions, condition: Value, otherwise: Value, then: Value) -> Value:
    if condition.number is not None:
        return then if condition.number else otherwise
    return graph.choice(condition, otherwise, then)


def _modulus(graph: Expressions, x: Value) -> Value:
    return x if x.number is not None else graph.apply("fabs", x.signed()[1])


def _sign(graph: Expressions, x: Value) -> Value:
    minus, size = x.signed()
    positive = graph.lift(float(np.sign(size.number))) if size.number is not None else None
    result = graph.apply("sign", size) if positive is None else positive
    return -result if minus else result


def _equal(graph: Expressions, x: Value, y: Value) -> Value:
    if x.number is not None and y.number is not None:
        return graph.lift(float(x.number == y.number))
    return graph.equal(x, y)


_ELEMENTWISE: dict[str, Callable[..., Value]] = {
    "add": lambda graph, x, y: x + y,
    "sub": lambda graph, x, y: x - y,
    "mul": lambda graph, x, y: x * y,
    "neg": lambda graph, x: -x,
    "div": _divided,
    "abs": _modulus,
    "sign": _sign,
    "eq": _equal,
    "select_n": _choice,
    "square": lambda graph, x: x * x,
}
