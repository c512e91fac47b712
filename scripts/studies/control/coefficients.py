"""The machines of the control study, and the sets of coefficients that controllers use."""

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import jaxcslc as jc
import sim
from scripts.studies.rows import made_of
from scripts.studies.truth import published_coefficients, true_coefficients


SETS = ("truth", "CSLC", "Ar+Rg", "Ar+LS", "30 % wrong")


def machine_of(seed: int) -> sim.Machine:
    """The specimen of a seed, with all disturbances."""
    return sim.disturbed(sim.specimen(sim.puma560(), seed))


def coefficient_sets(network: jc.CSLC, seeds: int, samples: int) -> dict[str, np.ndarray]:
    """Every set's coefficients of every seed's machine, (seeds, p) of each set.

    **Arguments**

    - `samples`: of the training recording that each machine is identified from.
    """
    machines = [machine_of(seed) for seed in range(seeds)]
    recorded = sim.record(
        [sim.Job(machine, sim.training(samples=samples, robot=machine.robot), seed)
         for seed, machine in enumerate(machines)],
        progress=True,
    )  # fmt: skip
    published = published_coefficients(network)
    settings = jc.choose_settings(network, recorded[0].recording).settings
    vectors: dict[str, list[Any]] = {name: [] for name in SETS}
    pairs = zip(machines, recorded, strict=True)
    for seed, (machine, performed) in enumerate(
        tqdm(pairs, total=seeds, desc="identification", disable=None)
    ):
        patterns = settings.patterns(performed.recording)
        true = true_coefficients(network, machine)
        coin = np.random.default_rng([seed, 30]).choice([0.7, 1.3], network.size)
        of_machine = (
            true,
            settings.fit(network, patterns).k,
            jc.regress_friction(network, patterns, published),
            published,
            coin * np.asarray(true),
        )
        for name, k in zip(SETS, of_machine, strict=True):
            vectors[name].append(np.asarray(k))
    return {name: np.stack(by_seed) for name, by_seed in vectors.items()}


def stored_coefficient_sets(
    network: jc.CSLC, seeds: int, samples: int, path: Path
) -> dict[str, np.ndarray]:
    """`coefficient_sets`, from a file if it holds them; otherwise computed and stored there."""
    digest = made_of({"samples": samples}, [Path(__file__)])
    if path.exists():
        with np.load(path) as file:
            if str(file.get("made_of")) == digest and len(file[SETS[0]]) >= seeds:
                return {name: file[name] for name in SETS}
    vectors = coefficient_sets(network, seeds, samples)
    np.savez(path, allow_pickle=False, made_of=np.array(digest), **vectors)
    return vectors
