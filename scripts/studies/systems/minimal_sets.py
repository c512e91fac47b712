"""Are the coefficients of random systems, and of the worked examples, as few as equations need?

For each system: the number of coefficients that exact separation finds; the numeric rank of their
regressor at random states; and how many coefficients the equations need, as a rank that knows
nothing of separation: what the equations say at random states, for many random sets of constants.
All three are to be the same. Finished rows stay in the output folder, and an interrupted run goes
on from there.

    .venv/bin/python -m scripts.studies.systems.minimal_sets
"""

import argparse
import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp
from sympy.physics.mechanics import dynamicsymbols

from jaxcslc._rank import numerical_rank
from jaxcslc.systems import Constant, System, Variable
from scripts.studies import command
from scripts.studies.rows import Rows, made_of
from scripts.studies.systems.example import Example
from scripts.studies.systems.examples.cart_pole import CART_POLE
from scripts.studies.systems.examples.lorenz import LORENZ
from scripts.studies.systems.examples.motor import DC_MOTOR, FREE_PERIOD, STRIBECK
from scripts.studies.systems.examples.quadrotor import QUADROTOR
from scripts.studies.systems.examples.tanks import COUPLED_TANKS, FREE_EXPONENT
from scripts.studies.systems.examples.vehicle import SATURATING_TYRES, VEHICLE


EXAMPLES = (
    *(CART_POLE, QUADROTOR, DC_MOTOR, FREE_PERIOD, STRIBECK, VEHICLE, SATURATING_TYRES),
    *(COUPLED_TANKS, FREE_EXPONENT, LORENZ),
)
_VARIABLES = dynamicsymbols("x y theta u")
_CONSTANTS = sp.symbols("a b c d e f")
# States and sets of constants that the ranks are taken over.
_DRAWS = 60


@dataclasses.dataclass(frozen=True)
class Ranks:
    """Ranks of one system.

    **Attributes**

    - `coefficients`: how many separation finds.
    - `regressor`: numeric rank of what multiplies them.
    - `needed`: numeric rank of the equations over states and constants.
    """

    coefficients: int
    regressor: int
    needed: int

    def __str__(self) -> str:
        return (
            f"{self.coefficients} coefficients; rank of their regressor {self.regressor}; needed"
            f" {self.needed}"
        )

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> "Ranks":
        """Return it from a finished row."""
        return cls(**{field.name: row[field.name] for field in dataclasses.fields(cls)})

    @property
    def agree(self) -> bool:
        """Return whether the set is minimal."""
        return self.coefficients == self.regressor == self.needed


def random_system(rng: np.random.Generator) -> System:
    """One to three equations: sums of products of constants times products of functions.

    Products recur, alone and in sums, with other multiples, and angles as sums and multiples.
    """
    x, y, theta, u = _VARIABLES
    rate = theta.diff()
    functions = [
        *(x, y, x.diff(), y.diff(), rate, rate.diff(), sp.Integer(1), u),
        *(sp.sin(theta), sp.cos(theta), sp.sin(2 * theta), sp.cos(theta + x), sp.sin(theta - x)),
        *(sp.sign(rate), sp.Abs(x), sp.sqrt(x**2 + 1), sp.exp(-y), sp.tanh(y), sp.Max(x, 0)),
    ]
    symbols = _CONSTANTS[: rng.integers(3, len(_CONSTANTS) + 1)]

    def product(factors: Sequence[Any], most: int) -> Any:
        indices = rng.choice(len(factors), rng.integers(1, most + 1))
        return sp.Mul(*(factors[i] for i in indices))

    def group() -> Any:
        """A sum of products of constants."""
        terms = (
            sp.Rational(int(rng.integers(-3, 4)), int(rng.integers(1, 4))) * product(symbols, 3)
            for _ in range(rng.integers(1, 4))
        )
        return sum(terms) + (int(rng.integers(1, 4)) if rng.random() < 0.2 else 0)

    groups = [group() for _ in range(rng.integers(2, 6))]
    inputs = [product(functions, 3) for _ in range(rng.integers(2, 7))]
    equations: dict[str, Any] = {}
    for number in range(1, rng.integers(1, 4) + 1):
        addends = [
            int(rng.integers(1, 4))
            * groups[rng.integers(len(groups))]
            * inputs[rng.integers(len(inputs))]
            for _ in range(rng.integers(2, 7))
        ]
        equations[str(number)] = sp.Eq(u, sum(addends) + group() * x, evaluate=False)
    everything = sp.Tuple(*equations.values())
    return System(
        "random",
        equations,
        tuple(Variable(v) for v in _VARIABLES if everything.has(v)),
        tuple(Constant(s) for s in _CONSTANTS if s in everything.free_symbols),
    )


def ranks_of(
    system: System, rng: np.random.Generator, sizes: Mapping[str, float] | None = None
) -> Ranks:
    """The three numbers that are to be the same.

    States where a function is not real are left out.

    - `sizes`: of constants by name, that random ones are about: their share of the equations is
      then not lost beside that of known constants; 1 if omitted.
    """
    motion = list(system.symbols.motion.values())
    states = rng.uniform(-2.0, 2.0, (len(motion), _DRAWS))
    separation = system.separation
    columns = _evaluated(motion, [x for row in separation.regressor for x in row], states)
    regressor = columns.reshape(len(system.outputs), -1, _DRAWS).transpose(0, 2, 1)
    regressor = regressor.reshape(-1, regressor.shape[-1])
    constants = [system.symbols.constants[constant.name] for constant in system.unknown]
    residuals = [left - right for left, right in system.numeric.values()]
    function = sp.lambdify([*motion, *constants], residuals, modules="numpy")
    about = np.array([(sizes or {}).get(constant.name, 1.0) for constant in system.unknown])
    values = about[:, None, None] * rng.uniform(0.5, 1.5, (len(constants), 1, _DRAWS))
    with np.errstate(invalid="ignore"):
        rows = function(*states[:, :, None], *values)
    said = np.concatenate([np.broadcast_to(row, (_DRAWS, _DRAWS)) for row in rows])
    return Ranks(
        len(separation.coefficients),
        numerical_rank(regressor[np.isfinite(regressor).all(axis=1)]),
        numerical_rank((said - said[:, :1])[np.isfinite(said).all(axis=1)]),
    )


def _evaluated(motion: Sequence[Any], expressions: Sequence[Any], states: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        values = sp.lambdify(motion, list(expressions), modules="numpy")(*states)
    return np.stack([np.broadcast_to(np.asarray(x, float), _DRAWS) for x in values])


def example_system(example: Example) -> System:
    """The system of a worked example, searched constants at their true values."""
    searched = [constant.name for constant in example.system.nonlinear]
    return example.system.with_values({name: example.truth[name] for name in searched})


def study(options: argparse.Namespace) -> int:
    """Prints a line for each system whose numbers differ, and how many agree."""
    code = [Path(__file__), *sorted((Path(__file__).parent / "examples").glob("*.*"))]
    rows = Rows(options.output / "rows.jsonl", ("system",), made_of({"seed": options.seed}, code))
    numbers = range(1, options.systems + 1)
    everything = {example.name: example for example in EXAMPLES} | {
        f"random {number}": number for number in numbers
    }
    for name, source in command.progress(everything.items(), desc="systems", unit="system"):
        if (name,) not in rows:
            ranks = ranks_of(*_drawn(source, options.seed))
            rows.add({"system": name, **dataclasses.asdict(ranks)})
    differing = 0
    for example in EXAMPLES:
        ranks = Ranks.of_row(rows[example.name,])
        differing += not ranks.agree
        print(f"{example.name}: {ranks}")
    drawn = {number: Ranks.of_row(rows[f"random {number}",]) for number in numbers}
    for number, ranks in drawn.items():
        if not ranks.agree:
            print(f"system {number}: {ranks}\n{_drawn(number, options.seed)[0]}")
    agreeing = sum(ranks.agree for ranks in drawn.values())
    coefficients = [ranks.coefficients for ranks in drawn.values()]
    print(
        f"{agreeing} of {options.systems} systems: as many coefficients as the equations need;"
        f" {min(coefficients)} to {max(coefficients)} of them"
    )
    return 0 if agreeing == options.systems and not differing else 1


def _drawn(
    source: Example | int, seed: int
) -> tuple[System, np.random.Generator, Mapping[str, float] | None]:
    """A worked example, or the random system of a number, and what its ranks are taken with.

    Each has random numbers of its own, so that a run that goes on draws what one run would.
    """
    if isinstance(source, int):
        rng = np.random.default_rng([seed, source])
        return random_system(rng), rng, None
    return example_system(source), np.random.default_rng(seed), source.truth


def main(arguments: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "minimal_sets")
    parser.add_argument("--systems", type=int, default=100, help="how many are drawn")
    parser.add_argument("--seed", type=int, default=0)
    options = command.parse(parser, arguments, systems=20)
    command.require_least(parser, options, systems=1, seed=0)
    return command.run(
        parser,
        lambda: study(options),
        options.output / "rows.jsonl",
        seconds=12 + 0.2 * options.systems,
    )


if __name__ == "__main__":
    sys.exit(main())
