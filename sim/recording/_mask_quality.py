"""Quality of a mask: how many of the samples that a simulator disturbed it leaves out."""

import dataclasses

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxcslc._text_table import text_table


@dataclasses.dataclass(frozen=True)
class MaskQuality:
    """Quality of a mask: which disturbed samples it leaves out, joint by joint.

    `print` shows a table; `rows()` returns it as data. A share of no samples is NaN.

    **Attributes**

    - `samples`: of the recording.
    - `disturbed`: (n,) how many of a joint's samples were disturbed.
    - `left_out`: (n,) how many the mask leaves out.
    - `caught`: (n,) how many of the disturbed ones the mask leaves out.
    """

    samples: int
    disturbed: Int[np.ndarray, " joints"]
    left_out: Int[np.ndarray, " joints"]
    caught: Int[np.ndarray, " joints"]

    @property
    def caught_share(self) -> Float[np.ndarray, " joints"]:
        """(n,) of the disturbed samples, the share that the mask leaves out (recall)."""
        return _share(self.caught, self.disturbed)

    @property
    def lost_share(self) -> Float[np.ndarray, " joints"]:
        """(n,) of the good samples, the share that the mask leaves out too."""
        return _share(self.left_out - self.caught, self.samples - self.disturbed)

    @property
    def precision(self) -> Float[np.ndarray, " joints"]:
        """(n,) of the samples that the mask leaves out, the share that was disturbed."""
        return _share(self.caught, self.left_out)

    @property
    def together(self) -> "MaskQuality":
        """Join all joints' pairs as if they were one joint's."""
        total = (np.sum(x, keepdims=True) for x in (self.disturbed, self.left_out, self.caught))
        return MaskQuality(self.samples * self.disturbed.size, *total)

    def rows(self) -> list[dict[str, str | int | float]]:
        """One row a joint, and one for all together."""
        names = [*(str(joint + 1) for joint in range(self.disturbed.size)), "all"]
        parts = (self, self.together)
        columns: dict[str, np.ndarray] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in (
                "disturbed",
                "left_out",
                "caught",
                "caught_share",
                "lost_share",
                "precision",
            )
        }
        return [
            {"joint": name, **{column: values[i].item() for column, values in columns.items()}}
            for i, name in enumerate(names)
        ]

    def __str__(self) -> str:
        rows = self.rows()
        cells = [
            [f"{cell:.1%}" if isinstance(cell, float) else str(cell) for cell in row.values()]
            for row in rows
        ]
        return text_table([name.replace("_", " ") for name in rows[0]], cells)


def mask_quality(
    kept: Bool[Array | np.ndarray, "_ _"],
    disturbed: Bool[Array | np.ndarray, "_ _"],
) -> MaskQuality:
    """Compare a mask with a record of the samples that it should leave out.

    For the backlash mask of Eqn. 2.5-7: `patterns.backlash_mask` against a simulator's record of
    when the gears were apart. The mask should leave out every such sample, and loses good ones too.

    **Arguments**

    - `kept`: (samples, n), True where the mask keeps a pair.
    - `disturbed`: (samples, n) of the same samples, True where a pair should be left out.

    **Returns** a `MaskQuality`.

    **Raises** `ValueError`: if the shapes differ.

    >>> import numpy as np
    >>> import sim
    >>> kept = np.array([[True], [False], [False], [True], [False]])
    >>> apart = np.array([[False], [True], [True], [True], [False]])
    >>> print(sim.mask_quality(kept, apart))
    joint  disturbed  left out  caught  caught share  lost share  precision
    1              3         3       2         66.7%       50.0%      66.7%
    all            3         3       2         66.7%       50.0%      66.7%
    """
    kept, disturbed = np.asarray(kept), np.asarray(disturbed)
    if kept.shape != disturbed.shape:
        raise ValueError(
            f"kept has shape {kept.shape}, disturbed {disturbed.shape}; expected the same samples"
            " and joints"
        )
    return MaskQuality(
        samples=kept.shape[0],
        disturbed=np.sum(disturbed, axis=0),
        left_out=np.sum(~kept, axis=0),
        caught=np.sum(~kept & disturbed, axis=0),
    )


def _share(
    part: Int[np.ndarray, " joints"], whole: Int[np.ndarray, " joints"]
) -> Float[np.ndarray, " joints"]:
    return np.where(whole > 0, part / np.maximum(whole, 1), np.nan)
