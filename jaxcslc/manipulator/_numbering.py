from dataclasses import dataclass


@dataclass(frozen=True)
class Subnumbering:
    """The published order of the inputs and coefficients of a subnetwork.

    **Attributes**

    - `inputs`: products of sines and cosines as printed (`"c23*s4*c5"`).
    - `coefficients`: one link of the publication for every coefficient: `(input, column, multiple)`
      means that the weight from that input to that element (`(1, 2)` for M12, `(2,)` for G2) is
      `multiple` times the coefficient.
    """

    inputs: tuple[str, ...]
    coefficients: tuple[tuple[str, tuple[int, ...], float], ...] = ()


@dataclass(frozen=True)
class Numbering:
    """A published numbering of a robot's inputs and coefficients, such as Appendix B.

    The derivation does not need one: it only permutes and scales the algebra's inputs and
    coefficients, and raises an error for a numbering that does not match them one to one.
    """

    source: str
    mass: Subnumbering
    velocity: Subnumbering
    gravity: Subnumbering
