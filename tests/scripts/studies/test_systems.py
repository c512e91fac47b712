"""The examples of other systems: their truth satisfies their equations, and the studies run."""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxcslc.systems import system_patterns
from scripts.studies.systems import search, study
from scripts.studies.systems.example import Example, recording_of


jax.config.update("jax_enable_x64", True)

EXAMPLES = {**study.EXAMPLES, **search.EXAMPLES}
# Their variants with free constants have the same motion and, at the true values, equations.
SAME = {"motor", "tanks"}
# Of the noiseless equations: what smoothing takes out of the motion, over the deviation of the
# largest term.
RESIDUAL = 0.02


@pytest.mark.parametrize("name", sorted(EXAMPLES.keys() - SAME))
def test_the_simulated_motion_satisfies_the_equations_with_the_true_constants(name: str) -> None:
    """Two formulations that know nothing of each other agree."""
    example = EXAMPLES[name]
    (columns,) = example.simulate([0], True)
    patterns = system_patterns(example.system, recording_of(columns), example.settings.preparation)
    network = example.system.network.with_nonlinear(example.nonlinear)
    motion = tuple(np.asarray(x) for x in (patterns.q, patterns.qd, patterns.qdd))
    terms = np.asarray(network.regressor(*motion)) * example.coefficients
    residual = np.asarray(network.known(*motion)) - terms.sum(axis=-1)
    mask = np.asarray(patterns.mask)
    for output in range(residual.shape[1]):
        rows = mask[:, output]
        size = np.max(np.std(terms[rows, output], axis=0))
        error = np.sqrt(np.mean(residual[rows, output] ** 2))
        assert error < RESIDUAL * size, (example.system.outputs[output], error / size)


def test_recordings_repeat_by_seed_and_differ_between_seeds() -> None:
    example: Example = study.EXAMPLES["lorenz"]
    first, again = (example.recordings([3, 23], motions=20) for _ in range(2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.column("x"), b.column("x"))
    difference = first[0].column("x") - first[1].column("x")
    # The same motion with other noise of the same strength.
    assert np.std(difference) == pytest.approx(np.sqrt(2) * example.noise["x"], rel=0.05)
    (validation,) = example.recordings([3], validation=True)
    assert np.std(validation.column("x")[:1000] - first[0].column("x")[:1000]) > 1.0


def test_the_studies_print_their_tables_and_resume(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--examples", "tanks", "--quick", "-o", str(tmp_path / "study")]
    assert study.main(arguments) == 0
    first = capsys.readouterr().out
    assert "tanks, 4 coefficients" in first and "true constants" in first
    rows = (tmp_path / "study" / "rows.jsonl").read_bytes()
    assert study.main(arguments) == 0
    assert capsys.readouterr().out == first
    assert (tmp_path / "study" / "rows.jsonl").read_bytes() == rows
    folder = str(tmp_path / "search")
    assert search.main(["--examples", "tanks, free exponent", "--quick", "-o", folder]) == 0
    (exponent,) = re.findall(r"n = ([0-9.]+)", capsys.readouterr().out)
    assert float(exponent) == pytest.approx(0.5, abs=0.05)


def test_wrong_options_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--examples", "pendulum"])
    assert "no example is called 'pendulum'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        search.main(["--searches", "0"])
    assert "--searches is 0" in capsys.readouterr().err
