"""The study of generalisation: its networks, its figures of merit, and a tiny run."""

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
from scripts.studies.generalisation import networks, study
from scripts.studies.generalisation.patterns import in_range, stop_set
from scripts.studies.generalisation.pruning import LinkEnds


@pytest.fixture
def data(rng: np.random.Generator) -> Any:
    """Two seeds' patterns of a smooth function of 3 inputs with 2 outputs."""

    def part(samples: int) -> Any:
        x = rng.normal(size=(2, samples, 3))
        torque = np.stack([np.sin(x[..., 0]), x[..., 1] * x[..., 2]], axis=-1)
        mask = rng.random(torque.shape) < 0.8
        return networks.Part(
            jnp.asarray(x, "float32"), jnp.asarray(5 + 2 * torque, "float32"), jnp.asarray(mask)
        )

    ones = jnp.ones((2, 2), "float32")
    return networks.Data(part(200), part(60), part(60), part(60), 5 * ones, 2 * ones)


class Silent:
    """A progress bar that shows nothing."""

    def update(self, epochs: int) -> None:
        del epochs


def test_epsilon_is_that_of_compare(
    puma: jc.CSLC, puma_k: jax.Array, rng: np.random.Generator
) -> None:
    q, qd, qdd = rng.normal(size=(3, 20, 6))
    mask = rng.random((20, 6)) < 0.4
    patterns = jc.Patterns(
        np.arange(20.0), q, qd, qdd, rng.normal(size=(20, 6)), mask, np.ones((20, 6), bool)
    )
    expected = jc.compare(puma, patterns, {"k": puma_k}).epsilon[0]
    error = jc.report.torque_errors(puma, patterns, puma_k)
    assert_allclose(networks.epsilon(error, jnp.asarray(mask)), expected, rtol=1e-12)
    assert np.isnan(networks.epsilon(error, jnp.zeros((20, 6), bool)))


def test_order_of_the_worked_example() -> None:
    """Fig. 4.2-1: hidden nodes of order 2, 3, 3 and 2; outputs of order 6 and 9."""
    hidden = {3: (0, 1), 4: (0, 1, 2), 5: (0, 1, 2), 6: (1, 2)}
    outputs = {7: (3, 4), 8: (3, 5, 6)}

    def order(nodes: dict[int, tuple[int, ...]]) -> int:
        pairs = [(source, node) for node, feeding in nodes.items() for source in feeding]
        source, target = np.array(pairs).T
        return networks.order_of(LinkEnds(source, target), np.ones(len(pairs), bool))

    assert order(hidden | {7: outputs[7]}) == 6
    assert order(hidden | {8: outputs[8]}) == 9
    assert order(hidden | outputs) == 9


@pytest.mark.parametrize(("hidden", "order"), [((5,), 4 * 6), ((5, 7), 4 * 6 * 8)])
def test_order_counts_biases_and_only_links_that_are_left(
    hidden: tuple[int, ...], order: int
) -> None:
    network = networks.Sigmoidal((3, *hidden, 2), jax.random.key(0))
    ends = network.link_ends()
    kept = np.ones(ends.source.size, dtype=bool)
    assert networks.order_of(ends, kept) == order
    kept[ends.target == 4] = False  # a hidden node that only its weight to the outputs is left of
    assert networks.order_of(ends, kept) == order
    assert networks.order_of(ends, np.zeros_like(kept)) == 0


def test_link_ends_are_in_the_order_of_the_flat_weights() -> None:
    """A weight matters to its output alone, and not at all while its source gives nothing."""
    network = networks.Sigmoidal((3, 4, 2), jax.random.key(1))
    flat, unravel = ravel_pytree(network)
    ends = network.link_ends()
    slope = jax.jacobian(lambda w: unravel(w)(jnp.array([0.0, 1.0, 1.0], "float32")))(flat)
    assert slope.shape == (2, ends.source.size)
    # The constant is node 0, inputs are 1 to 3, hidden nodes 4 to 7, outputs 8 and 9.
    assert_array_equal(slope[0] == 0, (ends.target == 9) | (ends.source == 1))
    assert_array_equal(slope[1] == 0, (ends.target == 8) | (ends.source == 1))


def test_gaussians_by_differences(rng: np.random.Generator) -> None:
    parts = [rng.normal(size=shape) for shape in ((5, 3), (5,), (2, 5), (2,))]
    network = networks.Radial(*(jnp.asarray(part) for part in parts))
    x = rng.normal(size=3)
    centres, log_widths, output, bias = parts
    distance = np.linalg.norm(x - centres, axis=1)
    expected = output @ np.exp(-0.5 * (distance / np.exp(log_widths)) ** 2) + bias
    assert_allclose(network(jnp.asarray(x)), expected, rtol=1e-10)


def test_radial_networks_start_with_outputs_solved_for(data: Any) -> None:
    start = eqx.filter_jit(eqx.filter_vmap(lambda d, k: networks.start_radial(d, 20, k)))
    network = start(data, jax.random.split(jax.random.key(0), 2))
    one, first = networks.of_seed(network, 0), networks.of_seed(data, 0)
    part = first.training
    target = (part.torque - first.mean[None]) / first.scale[None]
    slope = eqx.filter_grad(networks.loss)(one, part.x, target, part.mask)
    none = eqx.tree_at(lambda n: n.output, one, jnp.zeros_like(one.output))
    unsolved = eqx.filter_grad(networks.loss)(none, part.x, target, part.mask)
    assert np.abs(slope.output).max() < 0.02 * np.abs(unsolved.output).max()
    assert np.abs(slope.bias).max() < 1e-4


def test_the_stop_set_chooses_the_epoch(data: Any) -> None:
    options = argparse.Namespace(epochs=30, batch=20)
    start = eqx.filter_vmap(lambda key: networks.Sigmoidal((3, 8, 2), key))
    network = start(jax.random.split(jax.random.key(0), 2))
    ones = jax.tree.map(jnp.ones_like, network)
    best, last = networks.trained(network, data, ones, options, 0.1, Silent())
    before, at_best, at_last = (networks.errors(n, data) for n in (network, best, last))
    assert np.all(at_best["stop"] <= jnp.minimum(before["stop"], at_last["stop"]))
    assert np.all(at_last["training"] < 0.5 * before["training"])


def test_what_is_pruned_stays_pruned(data: Any) -> None:
    options = argparse.Namespace(epochs=30, batch=20)
    start = eqx.filter_vmap(lambda key: networks.Sigmoidal((3, 8, 2), key))
    network = start(jax.random.split(jax.random.key(0), 2))
    ones = jax.tree.map(jnp.ones_like, network)
    network, _ = networks.trained(network, data, ones, options, 0.1, Silent())
    left, kept = networks.pruned(network, data, (3, 8, 2), 0.1)
    _, last = networks.trained(left, data, kept, options, 0.1, Silent())
    for seed in range(2):
        mask = networks.flat(kept, seed) > 0
        assert 0 < np.sum(~mask) < mask.size
        assert np.all(networks.flat(last, seed)[~mask] == 0)
        assert np.all(networks.flat(last, seed)[mask] != networks.flat(left, seed)[mask])
    again, still = networks.pruned(left, data, (3, 8, 2), 0.0)
    assert np.all(networks.flat(still, 0) <= networks.flat(kept, 0))
    assert np.all(networks.flat(again, 0)[networks.flat(kept, 0) == 0] == 0)


def test_stop_sets_are_stretches_from_all_over() -> None:
    sets = [stop_set(1003, seed) for seed in range(6)]
    assert {int(one.sum()) for one in sets} == {200}
    groups = np.stack(sets)[:, :1000].reshape(6, 4, 250)
    assert np.all(groups.sum(axis=2) == 50)
    assert len({one.tobytes() for one in sets}) > 1


def test_in_range_is_every_input_for_itself() -> None:
    def patterns(q: list[float], qd: list[float]) -> jc.Patterns:
        still, every = np.zeros((len(q), 1)), np.ones((len(q), 1), bool)
        motion = (np.array(q)[:, None], np.array(qd)[:, None])
        return jc.Patterns(
            np.arange(float(len(q))), motion[0], motion[1], still, still, every, every
        )

    training = patterns([0.0, 1.0, 9.0], [5.0, 0.0, 9.0])
    judged = patterns([0.5, 1.0, 1.1, 0.5], [0.0, 5.0, 1.0, -0.1])
    inside = in_range(judged, training, np.array([True, True, False]))
    assert_array_equal(inside, [True, True, False, False])


def test_a_tiny_run_and_its_repetition(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recordings: list[jc.Recording] = []
    record = study.recorded

    def recorded_once(options: argparse.Namespace) -> list[jc.Recording]:
        recordings[:] = recordings or record(options)
        return recordings

    monkeypatch.setattr(study, "recorded", recorded_once)
    folder = tmp_path / "study"
    arguments = ["--quick", "-o", str(folder), "--tolerance", "0.1"]
    assert study.main(arguments) == 0
    printed = capsys.readouterr().out
    assert f"wrote generalisation.csv and generalisation.png into {folder}" in printed
    written = (folder / "generalisation.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(written.splitlines()))
    names = ["CSLC", "mean torque", "tanh 4", "tanh pruned 4", "radial basis sin cos 8"]
    assert [row["network"] for row in rows] == names
    assert float(rows[0]["comparison ε over the CSLC's"]) == 1.0
    assert 0.0 < float(rows[0]["comparison ε [N m]"]) < 0.3
    assert float(rows[2]["weights"]) == 18 * 4 + 4 + 4 * 6 + 6
    assert float(rows[2]["order"]) == 19 * 5
    assert float(rows[3]["weights"]) < float(rows[2]["weights"])
    assert rows[4]["order"] == ""
    assert (folder / "generalisation.png").stat().st_size > 10_000

    # What was cut off is made again; what is finished is not.
    lines = (folder / "rows.jsonl").read_text(encoding="utf-8").splitlines()
    (folder / "rows.jsonl").write_text("\n".join([*lines[:2], lines[2][:50]]))
    made: list[str] = []

    def remember(kind: Any, *_: Any) -> dict[str, Any]:
        made.append(kind.name)
        row = json.loads(lines[2])
        del row["made_of"]
        return row

    monkeypatch.setattr(study, "train", remember)
    assert study.main(arguments) == 0
    assert made == [names[4]]
    assert (folder / "generalisation.csv").read_text(encoding="utf-8") == written

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study, "make_rows", interrupt)
    assert study.main(arguments) == 130
    assert "interrupted; the same command goes on from" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "--seeds is 0; expected 1 or more"),
        (["--samples", "100"], "--samples is 100; expected 600 or more"),
        (["--tolerance", "-1"], "--tolerance is -1.0; expected a finite number, 0 or more"),
        (["--networks", "tanh 5"], "invalid choice: 'tanh 5'"),
    ],
)
def test_wrong_options(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        study.main(arguments)
    assert message in capsys.readouterr().err
