from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..codegen import Motion, Value
from ..network import CSLC
from ..network.terms import term_entries


def input_entries(
    network: CSLC, motion: Motion, contacts: Mapping[int, Value]
) -> list[tuple[int, int, Value]]:
    """The regressor's entries beside the rigid body's: friction, offsets, springs, coupled joints.

    - `contacts`: by joint, the state that its dry friction has in place of a sign.

    **Returns**

    - Joint, coefficient and value of each.
    """
    entries: list[tuple[int, int, Value]] = []
    for term in network.input_terms:
        indices = network.layout.indices(term.kind).tolist()
        states = contacts if term.kind == "dry" else {}
        entries += [
            (joint, indices[i], states.get(joint, value))
            for joint, i, value in term_entries(term, motion)
        ]
    return entries


def input_inertias(
    network: CSLC, k: Float[np.ndarray, " coefficients"]
) -> list[tuple[int, int, float]]:
    """What terms beside the rigid body add to the mass matrix above its diagonal.

    **Returns**

    - Row, column and value of each.
    """
    entries: list[tuple[int, int, float]] = []
    for term in network.input_terms:
        total = np.tensordot(k[network.layout.of(term)], term.inertia_matrices, 1)
        entries += [
            (int(i), int(j), float(total[i, j]))
            for i, j in zip(*np.triu_indices(len(total)), strict=True)
            if total[i, j]
        ]
    return entries
