import hashlib
import zipfile
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._scratch import unfinished
from ._epoch import Record, State


class Checkpoint:
    """A training's file: where it stands, its history so far, and what it is a training of.

    - `path`: of a NumPy archive; written whole beside it and then moved into place, so that an
      interruption leaves the last one intact.
    - `made_of`: whatever the result depends on.
    """

    def __init__(self, path: Path, made_of: Any) -> None:
        self.path = path
        self.fingerprint = _fingerprint(made_of)

    def load(self, state: State) -> tuple[State, list[Record], int]:
        """The state, records and number of epochs saved last; those given if there is no file.

        **Raises** `ValueError` if the file is no checkpoint, or one of another training.
        """
        if not self.path.exists():
            return state, [], 0
        try:
            with self.path.open("rb") as file, np.load(file) as archive:
                content = dict(archive)
            saved_fingerprint, passed = str(content["fingerprint"]), int(content["epochs"])
        except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile):
            raise ValueError(
                f"{self.path}: expected a checkpoint of a training, and it is none"
            ) from None
        if saved_fingerprint != self.fingerprint:
            raise ValueError(
                f"{self.path}: the checkpoint is of another training (network, patterns, plan or"
                " start differ); give another file, or remove it to start anew"
            )
        leaves, structure = jax.tree.flatten(state)
        restored = [
            _restored(leaf, content[f"state_{number}"]) for number, leaf in enumerate(leaves)
        ]
        record = Record(*(content.get(f"record_{name}") for name in Record.__annotations__))  # pyright: ignore[reportArgumentType]
        return jax.tree.unflatten(structure, restored), [record], passed

    def save(self, state: State, records: list[Record], passed: int) -> None:
        """Replaces the file."""
        content: dict[str, Any] = {"fingerprint": self.fingerprint, "epochs": passed}
        for number, leaf in enumerate(jax.tree.leaves(state)):
            content[f"state_{number}"] = _plain(leaf)
        axis = state.cost.ndim
        whole = jax.tree.map(lambda *parts: np.concatenate(parts, axis=axis), *records)
        for name in Record.__annotations__:
            if (value := getattr(whole, name)) is not None:
                content[f"record_{name}"] = value
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with unfinished(self.path) as path, path.open("wb") as file:
            np.savez(file, **content)


def _plain(leaf: Any) -> np.ndarray:
    if isinstance(leaf, Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return np.asarray(jax.random.key_data(leaf))
    return np.asarray(leaf)


def _restored(leaf: Any, saved: np.ndarray) -> Array:
    if isinstance(leaf, Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        return jax.random.wrap_key_data(jnp.asarray(saved), impl=jax.random.key_impl(leaf))
    return jnp.asarray(saved, leaf.dtype)


def _fingerprint(made_of: Any) -> str:
    """Of the numbers and the structure: equal trainings have the same, in every process."""
    leaves, structure = jax.tree.flatten(made_of)
    digest = hashlib.sha256(_without_addresses(str(structure)).encode())
    for leaf in leaves:
        if callable(leaf):  # such as a preprocessing: as a number it would be an address
            digest.update(_without_addresses(str(leaf)).encode())
            continue
        values = _plain(leaf)
        digest.update(f"{values.dtype} {values.shape}".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


def _without_addresses(text: str) -> str:
    """Functions print where they lie in memory, which differs from process to process."""
    return " ".join(word for word in text.replace(">", " ").split() if not word.startswith("0x"))
