"""A fit of patterns that are spread over devices, as a program: `sharded_fit.py OUT [PORT RANK]`.

With a port, two processes share the patterns. There are four devices (`XLA_FLAGS`). Writes
coefficients, standard errors and numbers of equations of the sharded fit and of the fit in one
piece.
"""

import sys

import jax
import numpy as np

import jaxcslc as jc


jax.config.update("jax_enable_x64", True)


def main(out: str, port: str = "", rank: str = "0") -> None:
    if port:
        jax.distributed.initialize(f"localhost:{port}", num_processes=2, process_id=int(rank))
    arm = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, -9.81, 0))
    network = jc.derive(arm, lengths="numeric")
    rng = np.random.default_rng(0)
    q, qd, qdd = rng.uniform(-2.0, 2.0, (3, 3002, 2))
    q[:800], qd[:800], qdd[:800] = 0.0, 0.0, 0.0  # the first device's patterns say little
    regressor = np.asarray(network.regressor(q, qd, qdd))
    torque = regressor @ np.linspace(0.5, 2.0, network.size) + 0.1 * rng.normal(size=q.shape)
    mask = rng.random(q.shape) < 0.9
    patterns = jc.Patterns(0.01 * np.arange(3002), q, qd, qdd, torque, mask, mask)
    solver = jc.LeastSquares(errors="independent")
    half = slice(1501 * int(rank), 1501 * (int(rank) + 1)) if port else slice(None)
    sharded = jc.least_squares.shard_patterns(jax.tree.map(lambda x: x[half], patterns))
    assert isinstance(sharded.q, jax.Array)
    assert len(sharded.q.sharding.device_set) == 4
    fits = solver.fit(network, sharded), solver.fit(network, patterns)
    rows = [[*fit.k, *fit.standard_error, *fit.equations] for fit in fits]
    if rank == "0":
        np.save(out, np.array(rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
