"""Checkpoints: interrupted and resumed to the same bits, and files that are of something else."""

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from jaxcslc.training import (
    LINEAR_COMBINER,
    PERAL,
    AdaptedRates,
    AdaptiveNetwork,
    Backpropagation,
    Layer,
    Links,
    Plan,
    Schedule,
    Signals,
    Subnetwork,
    Training,
    _train as module,
    examples,
    fully_connected,
    half_square,
    mean_modulus,
    train,
)
from jaxcslc.training._train import Checkpoint


NETWORK = fully_connected([3, 1], "linear combiner")
PLAN = Plan(Schedule((Backpropagation(), PERAL()), 0.5, 4), AdaptedRates(0.05), order="sequential")
X = np.random.default_rng(1).normal(size=(12, 3))
T = X @ np.array([[1.0], [-2.0], [0.5]]) + np.sin(9 * X[:, :1])
START = np.array([0.1, -0.1, 0.2, 0.1])


def run(path: Path | None = None, **changed: Any) -> Training:
    arguments: dict[str, Any] = {
        "network": NETWORK,
        "chosen": examples(NETWORK, X, T),
        "weights": START,
        "plan": PLAN,
        "stop_set": examples(NETWORK, X[:5] + 0.1, T[:5]),
        "key": jax.random.key(5),
        "epochs": 15,
        "chunk": 5,
        "checkpoint": path,
        **changed,
    }
    named = [arguments.pop(name) for name in ("network", "chosen", "weights", "plan")]
    return train(*named, **arguments)


def assert_identical(one: Training, other: Training) -> None:
    """Bit for bit, history and all."""
    leaves, structure = jax.tree.flatten(one)
    others, same = jax.tree.flatten(other)
    assert structure == same
    for leaf, twin in zip(leaves, others, strict=True):
        assert np.asarray(leaf).dtype == np.asarray(twin).dtype
        assert_array_equal(leaf, twin)


def interrupted(path: Path, monkeypatch: pytest.MonkeyPatch, chunks: int, **changed: Any) -> None:
    """As by Ctrl-C while the next chunk is computed."""
    steps: Callable[..., Any] = module._many_steps  # pyright: ignore[reportPrivateUsage]
    left = [chunks]

    def until(*arguments: Any) -> Any:
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        return steps(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(module, "_many_steps", until)
        with pytest.raises(KeyboardInterrupt):
            run(path, **changed)


STARTS = np.stack([START, 3 * START, -START])


@pytest.mark.parametrize(
    "changed",
    [{}, {"weights": STARTS}, {"weights": STARTS, "keep_weights": False, "stop_set": None}],
    ids=["one", "three", "three, no weights kept"],
)
def test_resumed_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any]
) -> None:
    whole = run(**changed)
    assert whole.history.cost.shape[-1] == 15
    path = tmp_path / "new folder" / "training.npz"
    for chunks in (0, 1, 1):  # before anything was saved; after a chunk; after another
        interrupted(path, monkeypatch, chunks, **changed)
        assert path.exists() == bool(chunks)
    assert_identical(run(path, **changed), whole)
    saved = path.read_bytes()
    assert_identical(run(path, **changed), whole)  # nothing left to do
    assert path.read_bytes() == saved
    assert [entry.name for entry in path.parent.iterdir()] == ["training.npz"]


def test_fewer_epochs_then_more(tmp_path: Path) -> None:
    path = tmp_path / "training.npz"
    first = run(path, epochs=5)
    assert int(first.epochs) == 5
    assert_identical(run(path), run())


@pytest.mark.parametrize("implementation", ["threefry2x32", "rbg"])
def test_keys_survive(tmp_path: Path, implementation: Any) -> None:
    """Typed keys, of whatever kind."""
    key = jax.random.key(11, impl=implementation)
    path = tmp_path / "training.npz"
    run(path, key=key, epochs=5)
    assert_identical(run(path, key=key), run(key=key))


def test_interrupted_while_saving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The last whole file is left, and nothing beside it."""
    path = tmp_path / "training.npz"
    run(path, epochs=5)
    saved = path.read_bytes()

    def half(file: Any, **content: Any) -> None:
        del content
        file.write(b"half of it")
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(np, "savez", half)
        with pytest.raises(KeyboardInterrupt):
            run(path)
    assert path.read_bytes() == saved
    assert list(tmp_path.iterdir()) == [path]


# Another training's.


def twisted() -> AdaptiveNetwork:
    """As many links and weights as `NETWORK`, of the same names, but they cross."""

    def signals(patterns: Any) -> Signals:
        return Signals((jnp.asarray(patterns).T,), ((),))

    links = Links(4, 1, [0, 1, 2, 3], [0] * 4, [1, 0, 2, 3])
    part = Subnetwork("network", (Layer(links, bias=True),))
    return AdaptiveNetwork((part,), signals, LINEAR_COMBINER, NETWORK.names)


def straight() -> AdaptiveNetwork:
    part = Subnetwork("network", (Layer(Links.full(4, 1), bias=True),))
    return AdaptiveNetwork((part,), twisted().preprocess, LINEAR_COMBINER, NETWORK.names)


def other_plan(**changed: Any) -> Plan:
    schedule = Schedule((Backpropagation(), PERAL()), changed.pop("hand_over", 0.5), 4)
    arguments: dict[str, Any] = {"order": "sequential", **changed}
    return Plan(schedule, arguments.pop("rates", AdaptedRates(0.05)), **arguments)


OTHERS: dict[str, dict[str, Any]] = {
    "start": {"weights": START * (1 + 1e-15)},
    "starts": {"weights": START[None]},
    "patterns": {"chosen": examples(NETWORK, X * 1.5, T)},
    "targets": {"chosen": examples(NETWORK, X, -T)},
    "mask": {"chosen": examples(NETWORK, X, T, np.arange(12)[:, None] > 0)},
    "stop set": {"stop_set": None},
    "key": {"key": jax.random.key(6)},
    "weights kept": {"keep_weights": False},
    "hand-over": {"plan": other_plan(hand_over=0.6)},
    "target": {"plan": other_plan(target=0.1)},
    "rates": {"plan": other_plan(rates=AdaptedRates(0.06))},
    "gain": {"plan": other_plan(rates=AdaptedRates(0.05, 0.1, 0.09))},
    "order": {"plan": other_plan(order="batch")},
    "cost": {"plan": other_plan(cost=half_square)},
    "measure": {"plan": other_plan(measure=mean_modulus)},
    "patience": {"plan": other_plan(patience=9)},
    "rules": {"plan": Plan(Backpropagation(), AdaptedRates(0.05), order="sequential")},
}


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("saved") / "training.npz"
    run(path, epochs=5)
    return path


@pytest.mark.parametrize("name", list(OTHERS))
def test_of_another_training(saved: Path, name: str) -> None:
    content = saved.read_bytes()
    with pytest.raises(ValueError, match="the checkpoint is of another training") as raised:
        run(saved, **OTHERS[name])
    assert str(saved) in str(raised.value)
    assert "\n" not in str(raised.value)
    assert saved.read_bytes() == content


def test_of_a_network_wired_otherwise(tmp_path: Path) -> None:
    """Links print alike."""
    path = tmp_path / "training.npz"
    training_set = examples(straight(), X, T)
    options: Any = {"chosen": training_set, "stop_set": None, "epochs": 5}
    run(path, network=straight(), **options)
    with pytest.raises(ValueError, match="of another training"):
        run(path, network=twisted(), **options)


def test_epochs_chunks_and_blocks_make_no_other_training(saved: Path) -> None:
    fingerprints = run(saved, epochs=5, chunk=3, block=2)
    assert int(fingerprints.epochs) == 5


# No checkpoint at all.


def truncated(content: bytes) -> bytes:
    return content[: len(content) // 2]


def flipped(content: bytes) -> bytes:
    """One bit of an array: the archive's checksum shows it."""
    at = content.index(b"fingerprint") + 200
    return content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :]


SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "truncated": truncated,
    "a bit flipped": flipped,
    "empty": lambda content: b"",
    "text": lambda content: b"weights,1,2",
    "a pickle": lambda content: b"\x80\x04",
}


@pytest.mark.parametrize("spoil", list(SPOILT.values()), ids=list(SPOILT))
def test_no_checkpoint(saved: Path, tmp_path: Path, spoil: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "spoilt.npz"
    path.write_bytes(spoil(saved.read_bytes()))
    check_unreadable(path)


def check_unreadable(path: Path) -> None:
    content = path.read_bytes()
    with pytest.raises(ValueError, match="expected a checkpoint of a training") as raised:
        run(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)
    assert path.read_bytes() == content


def test_other_files_of_numpy_s(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", weights=START)
    check_unreadable(tmp_path / "other.npz")
    np.save(tmp_path / "other.npy", START)
    check_unreadable(tmp_path / "other.npy")
    objects: Any = {"fingerprint": np.array([None]), "epochs": np.array(1)}
    np.savez(tmp_path / "objects.npz", **objects)
    check_unreadable(tmp_path / "objects.npz")


def test_a_folder_is_none(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a checkpoint of a training"):
        run(tmp_path)


# Another process.

PROGRAM = """
import jax
jax.config.update("jax_enable_x64", True)
import jax.numpy as jnp, numpy as np
from pathlib import Path
from jaxcslc.training import HYPERBOLIC_TANGENT, RadialBasis, decreasing, fully_connected
from jaxcslc.training import *
from jaxcslc.training._train import Checkpoint

def squares(x):
    return x**2

plan = Plan(Schedule((Backpropagation(), PERAL()), 0.5, 4), AdaptedRates(0.05), cost=half_square)
networks = [
    fully_connected([2, 1], "logistic", preprocess=squares),
    fully_connected([2, 3, 1], decreasing(HYPERBOLIC_TANGENT), preprocess=jnp.sin),
    fully_connected([2, 1], "linear combiner", preprocess=RadialBasis(jnp.eye(2), jnp.ones(2))),
]
made_of = (networks, plan, np.arange(3.0), jax.random.key(1), True, None)
print(Checkpoint(Path("x"), made_of).fingerprint)
"""


def test_the_same_fingerprint_in_every_process() -> None:
    """Where functions lie in memory, and in what order sets are, is no part of it."""
    fingerprints: set[str] = set()
    for seed in ("1", "2"):
        command = [sys.executable, "-c", PROGRAM]
        environment = {**os.environ, "PYTHONHASHSEED": seed, "JAX_PLATFORMS": "cpu"}
        result = subprocess.run(
            command, capture_output=True, text=True, check=True, env=environment
        )
        fingerprints.add(result.stdout.strip())
    assert len(fingerprints) == 1
    assert len(fingerprints.pop()) == len(hashlib.sha256().hexdigest())


def test_functions_are_distinguished_by_name() -> None:
    def fingerprint(function: Callable[..., Any]) -> str:
        network = fully_connected([2, 1], "logistic", preprocess=function)
        return Checkpoint(Path("x"), network).fingerprint

    assert fingerprint(jnp.sin) == fingerprint(jnp.sin)
    assert fingerprint(jnp.sin) != fingerprint(jnp.cos)
