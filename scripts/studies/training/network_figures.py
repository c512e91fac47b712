"""Three small problems that show what networks can learn, and what they should not.

- **Exclusive or** (Figs. 3.3-3 and 3.3-4): one hard limiter, trained by the perceptron rule in
  sequential order from many random starts, with its inputs preprocessed (x1, x2, x1², x1 x2, x2²)
  and without. Drawn is the first that ended with an ellipse, as the thesis's did; most end with a
  hyperbola. Without preprocessing, drawn is the best of all epochs of that start.
- **Overtraining** (Fig. 3.6-1): a two-layer hyperbolic-tangent network learns ten noisy samples of
  one period of a sine by backpropagation, and a stop set of a hundred others determines when to
  stop.
- **Quintics** (Fig. 4.3-1): a linear combiner on x, ..., x⁵ is fitted to two sets of six noisy
  points of one cubic, by the direct solve that training tends to (Eqn. 4.1-4). Inside is from the
  lowest to the highest x of the points; outside is half as far again to either side.

The first draw of each problem makes its picture; `network_figures.json` has all of them.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import jaxcslc as jc
from jaxcslc.report import all_or_nothing, write_json
from jaxcslc.training import (
    AdaptiveNetwork,
    Backpropagation,
    FixedRates,
    PerceptronRule,
    Plan,
    PolynomialTerms,
    Training,
    examples,
    fully_connected,
    half_square,
    mean_modulus,
    train,
)
from scripts.studies import command
from scripts.studies.figures import save_picture
from scripts.studies.rows import made_of
from scripts.studies.training.network_pictures import (
    decision_picture,
    fitted_curves_picture,
    overtraining_picture,
)


jc.enable_x64()

CORNERS = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
EXCLUSIVE_OR = np.array([0.0, 1.0, 1.0, 0.0])

SAMPLES, STOP_SET, HIDDEN = 10, 100, 12
SINE_NOISE = 0.3
RATE = 0.05
# Steep hidden nodes, so that the network can bend between samples, and small outputs.
HIDDEN_SPREAD, OUTPUT_SPREAD = 3.0, 0.3

POINTS = 6
REACH = 1.5  # points lie within ± this
CUBIC_NOISE = 0.15


def learn_exclusive_or(
    network: AdaptiveNetwork, starts: int, epochs: int, seed: int
) -> tuple[Training, np.ndarray]:
    """Trainings from normally distributed weights, and the lowest share of errors of each."""
    corners = examples(network, CORNERS, EXCLUSIVE_OR[:, None])
    plan = Plan(
        PerceptronRule(), FixedRates(0.5), cost=mean_modulus, order="sequential", patience=epochs
    )
    start, order = jax.random.split(jax.random.key(seed))
    weights = jax.random.normal(start, (starts, network.size))
    training = train(network, corners, weights, plan, epochs=epochs, key=order)
    return training, np.asarray(training.history.cost).min(axis=1)


def conic(weights: np.ndarray) -> str:
    """The kind of the curve of zero sum, by the discriminant of its quadratic part."""
    _, _, a, b, c, _ = weights
    discriminant = b * b - 4 * a * c
    return "ellipse" if discriminant < 0 else "hyperbola" if discriminant > 0 else "parabola"


def exclusive_or(starts: int, epochs: int, seed: int) -> tuple[Figure, dict[str, Any]]:
    """Figs. 3.3-3 and 3.3-4, with and without preprocessed inputs."""
    processed = fully_connected([2, 1], "hard limiter", preprocess=PolynomialTerms(2))
    plain = fully_connected([2, 1], "hard limiter")
    training, wrong = learn_exclusive_or(processed, starts, epochs, seed)
    failing, least_wrong = learn_exclusive_or(plain, starts, epochs, seed)
    curves = [conic(weights) for weights in np.asarray(training.weights)]
    drawn = curves.index("ellipse") if "ellipse" in curves else 0
    history = failing.history
    assert history.weights is not None
    best = jnp.asarray(history.weights[drawn, int(np.argmin(history.cost[drawn]))])

    grid = np.linspace(-1.25, 2.25, 401)
    plane = np.stack(np.meshgrid(grid, grid), axis=-1)

    def decision(network: AdaptiveNetwork, weights: jax.Array) -> tuple[np.ndarray, np.ndarray]:
        signals = network.signals(plane.reshape(-1, 2))
        sums = np.asarray(network.forward(weights, signals).total)[0].reshape(plane.shape[:2])
        return sums, np.asarray(network.outputs(weights, CORNERS))[:, 0]

    names = ("with preprocessed inputs", "without: the best of all epochs")
    decisions = {
        names[0]: decision(processed, training.weights[drawn]),
        names[1]: decision(plain, best),
    }
    moved = np.asarray(training.epochs)
    document = {
        "starts": starts,
        "epochs at most": epochs,
        "with preprocessing": {
            "ended without an error": int(np.sum(wrong == 0)),
            "epochs until then, median": float(np.median(moved)),
            "epochs until then, most": int(moved.max()),
            "curves of zero sum": {kind: curves.count(kind) for kind in sorted(set(curves))},
            "drawn": {
                "start": drawn,
                "curve": curves[drawn],
                "weights": training.weights[drawn],
                "answers": decisions[names[0]][1],
            },
        },
        "without preprocessing": {
            "ended without an error": int(np.sum(least_wrong == 0)),
            "least wrong answers of 4": round(4 * float(least_wrong.min())),
            "drawn": {"weights": best, "answers": decisions[names[1]][1]},
        },
    }
    title = "Exclusive or by a single hard limiter"
    return decision_picture(grid, grid, decisions, CORNERS, EXCLUSIVE_OR, title=title), document


def overtraining(
    draws: int, epochs: int, seed: int, checkpoint: Path | None = None
) -> tuple[Figure, dict[str, Any]]:
    """Fig. 3.6-1."""
    network = fully_connected([1, HIDDEN, 1], ["hyperbolic tangent", "linear combiner"])
    spread = np.full(network.size, HIDDEN_SPREAD)
    spread[2 * HIDDEN :] = OUTPUT_SPREAD
    generators = [np.random.default_rng((seed, draw)) for draw in range(draws)]

    def sampled(rng: np.random.Generator, number: int) -> np.ndarray:
        x = rng.uniform(-1.0, 1.0, number)
        return np.stack([x, np.sin(np.pi * x) + SINE_NOISE * rng.standard_normal(number)])

    def many(samples: np.ndarray) -> Any:
        x, y = samples[:, 0, :, None], samples[:, 1, :, None]
        return jax.vmap(lambda x, y: examples(network, x, y))(x, y)

    training_sets = np.stack([sampled(rng, SAMPLES) for rng in generators])
    stop_sets = np.stack([sampled(rng, STOP_SET) for rng in generators])
    starts = np.stack([spread * rng.standard_normal(network.size) for rng in generators])
    # The training goes on behind the optimal point, to show the rise of the stop-set error.
    plan = Plan(
        Backpropagation(),
        FixedRates(RATE),
        cost=half_square,
        patience=epochs,
        stop_patience=epochs,
    )
    training = train(
        network,
        many(training_sets),
        starts,
        plan,
        epochs=epochs,
        stop_set=many(stop_sets),
        keep_weights=False,
        chunk=max(1, epochs // 20),
        checkpoint=checkpoint,
        progress=True,
    )
    errors = np.sqrt(2.0 * np.asarray(training.history.cost))
    stop = np.sqrt(2.0 * np.asarray(training.history.stop_cost))
    best = np.argmin(stop, axis=1)
    rise = stop[:, -1] / stop.min(axis=1)
    document = {
        "samples": SAMPLES,
        "stop set": STOP_SET,
        "weights": network.size,
        "noise": SINE_NOISE,
        "epochs": epochs,
        "drawn": {
            "epoch to stop at": int(best[0]) + 1,
            "training error there": errors[0, best[0]],
            "training error at the end": errors[0, -1],
            "stop-set error there": stop[0, best[0]],
            "stop-set error at the end": stop[0, -1],
        },
        "all draws": {
            "draws": draws,
            "epochs to stop at": best + 1,
            "stop-set error at the end over the least": rise,
            "of these, median": float(np.median(rise)),
        },
    }
    title = f"{SAMPLES} noisy samples of a sine, {network.size} weights"
    return overtraining_picture(errors[0], stop[0], title=title), document


def cubic(x: np.ndarray) -> np.ndarray:
    """The system that the quintics approximate."""
    return x**3 - 2.0 * x


def quintics(draws: int, seed: int) -> tuple[Figure, dict[str, Any]]:
    """Fig. 4.3-1."""
    network = fully_connected([1, 1], "linear combiner", bias=False, preprocess=PolynomialTerms(5))
    rng = np.random.default_rng(seed)
    # One random point in each sixth of the region.
    edges = np.linspace(-REACH, REACH, POINTS + 1)
    x = edges[:-1] + np.diff(edges) * rng.uniform(size=(draws, 2, POINTS))
    y = cubic(x) + CUBIC_NOISE * rng.standard_normal(x.shape)
    powers = np.asarray(network.signals(x[..., None]).inputs[0])  # (5, draws, 2, points)
    weights = np.stack(
        [
            [np.linalg.lstsq(powers[:, i, j].T, y[i, j], rcond=None)[0] for j in range(2)]
            for i in range(draws)
        ]
    )

    def curves(weights: np.ndarray, x: np.ndarray) -> np.ndarray:
        return np.asarray(network.outputs(jnp.asarray(weights), x[:, None]))[:, 0]

    departures: list[list[list[float]]] = []
    for i in range(draws):
        low, high = x[i].min(), x[i].max()
        inside = np.linspace(low, high, 200)
        beyond = np.linspace(0.0, (high - low) / 2, 101)[1:]
        outside = np.concatenate([low - beyond, high + beyond])
        departures.append(
            [
                [
                    float(np.sqrt(np.mean((curves(w, region) - cubic(region)) ** 2)))
                    for w in weights[i]
                ]
                for region in (inside, outside)
            ]
        )
    rms = np.array(departures)  # (draws, inside or outside, quintic)
    document = {
        "cubic": "y = x³ - 2 x",
        "noise": CUBIC_NOISE,
        "points": POINTS,
        "drawn": {
            "x": x[0],
            "y": y[0],
            "weights of x, ..., x⁵": weights[0],
            "RMS departure from the cubic inside": rms[0, 0],
            "RMS departure from the cubic outside": rms[0, 1],
        },
        "all draws": {
            "draws": draws,
            "RMS departure inside, median": float(np.median(rms[:, 0])),
            "RMS departure outside, median": float(np.median(rms[:, 1])),
            "outside over inside, median": float(np.median(rms[:, 1] / rms[:, 0])),
        },
    }
    x_drawn = np.linspace(-2 * REACH, 2 * REACH, 400)
    names = ("quintic fitted to circles", "quintic fitted to crosses")
    fits = {
        name: (np.stack([x[0, j], y[0, j]], axis=1), curves(weights[0, j], x_drawn))
        for j, name in enumerate(names)
    }
    title = "Two quintics, each of six noisy points of one cubic"
    return fitted_curves_picture(x_drawn, cubic(x_drawn), fits, title=title), document


def checkpoint_of(options: argparse.Namespace) -> Path:
    """Return where the overtrained networks are kept, which take nearly all of the time."""
    numbers = {name: getattr(options, name) for name in ("seed", "draws", "epochs")}
    digest = made_of(numbers, [Path(__file__)])
    return options.output / f"overtraining-{digest[:12]}.npz"


def study(options: argparse.Namespace) -> int:
    """Trains the networks and writes pictures and numbers."""
    results = {
        "exclusive_or": exclusive_or(options.draws, 1000, options.seed),
        "overtraining": overtraining(
            options.draws, options.epochs, options.seed, checkpoint_of(options)
        ),
        "quintics": quintics(options.draws, options.seed),
    }
    with all_or_nothing(options.output) as folder:
        for name, (figure, _) in results.items():
            save_picture(figure, folder / f"{name}.png")
        numbers = {name: document for name, (_, document) in results.items()}
        write_json(folder / "network_figures.json", {"seed": options.seed} | numbers)
    print(
        f"wrote {', '.join(f'{name}.png' for name in results)} and network_figures.json into"
        f" {options.output}"
    )
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = command.new_parser(__doc__, "network_figures")
    parser.add_argument("--seed", type=int, default=0, help="of every random number")
    parser.add_argument(
        "--draws", type=int, default=40, help="how often to repeat each problem; one is drawn"
    )
    parser.add_argument("--epochs", type=int, default=20_000, help="of the overtrained networks")
    options = command.parse(parser, argv, draws=5, epochs=2000)
    command.require_least(parser, options, seed=0, draws=1, epochs=2)
    return command.run(
        parser,
        lambda: study(options),
        checkpoint_of(options),
        seconds=20.0 + 2e-5 * options.draws * options.epochs,
    )


if __name__ == "__main__":
    raise SystemExit(main())
