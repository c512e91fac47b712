"""CUDA kernel for the costs of many trainings, also after changes at several sets of rates.

Read with `_functions`, whose costs it computes, and `_examples`, which calls it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..codegen import Kernel, kernels_run, multiprocessors
from ._functions import LINEAR_COMBINER, Cost, ErrorSum, error_sum
from ._network import AdaptiveNetwork


# Warps of a block, each with a training; of 168 registers a thread, three blocks fit on a
# multiprocessor.
_WARPS, _RESIDENT = 4, 3
# Blocks for each that runs at a time: the last ones end together.
_WAVES = 4
_LANES = 32
# Bytes of shared memory that every block gets, and statements that compile in seconds.
_SHARED = 48_000
_MOST = 20_000


def cost_kernel(
    network: AdaptiveNetwork, cost: Cost, support: tuple[tuple[int, ...], ...], trials: int
) -> "CostKernel | None":
    """The kernel for a cost, where there is one, and it runs.

    - `support`: for each output, the weights that reach it.
    - `trials`: sets of rates; none for the cost of the weights as they are.
    """
    terms = error_sum(cost)
    if terms is None or not network.linear or network.activation != LINEAR_COMBINER:
        return None
    moved = tuple(
        tuple(sorted({int(weight) for weight in layer.links.weight}))
        for _, layer in network.adaptive_layers
    )
    kernel = CostKernel(support, moved, trials, terms)
    return kernel if kernel.fits and kernels_run() else None


@dataclass(frozen=True)
class CostKernel:
    """Costs of many trainings' weights, and after changes of them at several sets of rates.

    A warp takes a training, each of its threads a pattern: sums at the outputs, of the weights and
    of each layer's change, stay in registers for all sets of rates.

    **Attributes**

    - `support`: for each output, the weights that reach it.
    - `moved`: for each layer, the weights that its change moves.
    - `trials`: sets of rates; none for the cost of the weights as they are.
    - `cost`: what is computed of errors.
    """

    support: tuple[tuple[int, ...], ...]
    moved: tuple[tuple[int, ...], ...]
    trials: int
    cost: ErrorSum

    @property
    def costs(self) -> int:
        """Number of costs of each training."""
        return max(self.trials, 1)

    @property
    def together(self) -> int:
        """Trainings of a warp, as many as registers hold: a pattern's numbers are read for all."""
        return {0: 4, 1: 2}.get(self.trials, 1)

    def __call__(
        self,
        weights: Float[Array, "trainings weights"],
        change: Float[Array, "trainings groups weights"] | None,
        trials: Float[Array, "trainings trials groups"] | None,
        condensed: Sequence[Float[Array, "_ patterns"]],
        targets: Float[Array, "outputs patterns"],
        counts: Float[Array, "outputs patterns"],
    ) -> Float[Array, "trainings costs"]:
        """The costs of all trainings."""
        masked = (
            counts**2 if self.cost.square else counts
        )  # that errors would have been multiplied by
        rows = jnp.concatenate([*condensed, targets, self.cost.shares(counts) * masked])
        patterns, trainings = rows.shape[1], len(weights)
        tiles = -(-patterns // _LANES)
        rows = jnp.pad(rows, ((0, 0), (0, tiles * _LANES - patterns)))
        rows = rows.reshape(len(rows), tiles, _LANES).transpose(1, 0, 2)
        arrays = [weights]
        if change is not None and trials is not None:
            arrays += [change.reshape(trainings, -1), trials.reshape(trainings, -1)]
        numbers = jnp.concatenate(arrays, axis=1)[:, np.array(self._own(weights.shape[1]), int)]
        groups = -(-trainings // (_WARPS * self.together))
        pieces = min(max(_WAVES * _RESIDENT * multiprocessors() // groups, 1), tiles)
        sizes = jnp.array([trainings, tiles, pieces, groups])
        shape = jax.ShapeDtypeStruct((pieces, self.costs, trainings), jnp.float64)
        kernel = Kernel("costs", self.source, _WARPS * _LANES)
        (parts,) = kernel(pieces * groups, [shape], rows, numbers, sizes)
        return (jnp.sum(parts, axis=0) * self.cost.scale(counts)).T

    @property
    def fits(self) -> bool:
        """True if the kernel compiles in seconds and a block's numbers are in its memory."""
        outputs, groups = len(self.support), len(self.moved)
        entries = sum(map(len, self.support))
        statements = (entries + self.costs * outputs) * (2 + groups) * self.together
        return statements <= _MOST and 8 * _WARPS * self.together * self._numbers <= _SHARED

    @property
    def _numbers(self) -> int:
        """Number of a training's values that the kernel reads, an even number."""
        return len(self._own(max(self._weights, default=0) + 1))

    def _own(self, size: int) -> list[int]:
        """Return indices of a training's weights, changes and rates as the kernel reads them.

        Their number is even.

        - `size`: the number of weights.
        """
        groups = len(self.moved)
        order: list[int] = []
        for weight in self._weights:
            order.append(weight)
            order += [size * (1 + group) + weight for group in self._movers(weight)]
        rates = range(size * (1 + groups), size * (1 + groups) + self.trials * groups)
        order += rates
        return order + order[-1:] * (len(order) % 2)

    @property
    def _weights(self) -> list[int]:
        return sorted(set().union(*self.support))

    def _movers(self, weight: int) -> list[int]:
        """The layers whose change moves a weight."""
        return [group for group, moved in enumerate(self.moved) if self.trials and weight in moved]

    @property
    def source(self) -> str:
        """The kernel in CUDA C."""
        outputs = range(len(self.support))
        entries = [(o, weight) for o in outputs for weight in self.support[o]]
        row_of = {entry: i for i, entry in enumerate(entries)}
        targets, shares = len(entries), len(entries) + len(outputs)
        parts = sorted({(g, o) for o, weight in entries for g in self._movers(weight)})
        lines = [
            f"real e{u}_{o} = row[{_LANES * (targets + o)}];"
            for o in outputs
            for u in range(self.together)
        ]
        lines += [f"real p{u}_{g}_{o} = 0;" for g, o in parts for u in range(self.together)]
        offset = 0
        for weight in self._weights:
            movers = self._movers(weight)
            for u in range(self.together):
                lines.append(f"const real w{u}_{weight} = own{u}[{offset}];")
                lines += [
                    f"const real c{u}_{g}_{weight} = own{u}[{offset + 1 + i}];"
                    for i, g in enumerate(movers)
                ]
            offset += 1 + len(movers)
            for o in (o for o in outputs if (o, weight) in row_of):
                a = f"a{o}_{weight}"
                lines.append(f"const real {a} = row[{_LANES * row_of[o, weight]}];")
                for u in range(self.together):
                    lines.append(f"e{u}_{o} -= {a} * w{u}_{weight};")
                    lines += [f"p{u}_{g}_{o} += {a} * c{u}_{g}_{weight};" for g in movers]
        lines += [f"const real s{o} = row[{_LANES * (shares + o)}];" for o in outputs]
        groups = range(len(self.moved)) if self.trials else range(0)
        for cost in range(self.costs):
            for u in range(self.together):
                lines += ["{", "real sum = 0;"]
                lines += [f"const real r{g} = own{u}[{offset + g}];" for g in groups]
                for o in outputs:
                    steps = "".join(f" - r{g} * p{u}_{g}_{o}" for g in groups if (g, o) in parts)
                    lines.append(f"const real d{o} = e{u}_{o}{steps};")
                    size = f"d{o} * d{o}" if self.cost.square else f"fabs(d{o})"
                    lines.append(f"sum += s{o} * ({size});")
                lines += [f"total{u}_{cost} += {'root(sum)' if self.cost.root else 'sum'};", "}"]
            offset += len(groups)
        offset += offset % 2
        totals = [(u, cost) for u in range(self.together) for cost in range(self.costs)]
        return _KERNEL.format(
            warps=_WARPS,
            resident=_RESIDENT,
            together=self.together,
            own=offset,
            rows=len(entries) + 2 * len(outputs),
            zeros="\n".join(f"real total{u}_{i} = 0;" for u, i in totals),
            numbers="\n".join(
                f"const double* const own{u} = own + {u * offset};" for u in range(self.together)
            ),
            statements="\n".join(lines),
            costs=self.costs,
            sums="\n".join(f"total{u}_{i} = over_warp(total{u}_{i});" for u, i in totals),
            stores="\n".join(
                f"if (first + {u} < trainings) result[{i} * trainings + {u}] = total{u}_{i};"
                for u, i in totals
            ),
        )


_KERNEL = """typedef double real;

__device__ __forceinline__ real over_warp(real x)
{{
    for (int other = 16; other; other /= 2)
        x += __shfl_xor_sync(0xffffffffu, x, other);
    return x;
}}

/* Within a unit of the last digit, without the library's branch; what has no square root of its own
   kind, zero, infinity or no number, is its own. */
__device__ __forceinline__ real root(real x)
{{
    const unsigned exponent = __double2hiint(x) & 0x7ff00000;
    double y;
    asm("rsqrt.approx.ftz.f64 %0, %1;" : "=d"(y) : "d"(x));
    double g = x * y, h = 0.5 * y;
    const double error = fma(-g, h, 0.5);
    g = fma(g, error, g);
    h = fma(h, error, h);
    g = fma(fma(-g, g, x), h, g);
    return exponent - 0x00100000u < 0x7fe00000u ? g : x;
}}

extern "C" __global__ void __launch_bounds__(32 * {warps}, {resident}) costs(
    const double* __restrict__ rows, const double* __restrict__ all_own,
    const long long* __restrict__ sizes, double* __restrict__ results)
{{
    constexpr int TOGETHER = {together}, OWN = {own};
    __shared__ double2 numbers[{warps} * TOGETHER * OWN / 2];
    const int trainings = sizes[0], tiles = sizes[1], pieces = sizes[2], groups = sizes[3];
    const int group = (int)blockIdx.x % groups, piece = (int)blockIdx.x / groups;
    const int warp = (int)threadIdx.x / 32, lane = threadIdx.x % 32;
    const int first = (group * {warps} + warp) * TOGETHER;
    if (first >= trainings)
        return;
    double* const own = (double*)(numbers + warp * TOGETHER * OWN / 2);
    for (int i = lane; i < min(TOGETHER, trainings - first) * OWN; i += 32)
        own[i] = all_own[(long long)first * OWN + i];
    __syncwarp();
{numbers}
{zeros}
#pragma unroll 1
    for (int tile = piece; tile < tiles; tile += pieces) {{
        asm volatile("" ::: "memory"); /* numbers are read again: registers do not hold them */
        const double* __restrict__ row = rows + (long long)tile * {rows} * 32 + lane;
{statements}
    }}
{sums}
    if (lane)
        return;
    double* result = results + (long long)piece * {costs} * trainings + first;
{stores}
}}
"""
