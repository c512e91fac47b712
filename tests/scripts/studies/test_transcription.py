"""The transcription of Chapter 7: against the library, and what it must do by itself."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxcslc as jc
import sim
from scripts.studies.transcription import network, study, training


# Agreement to rounding, over a hundred epochs [N m].
ROUNDING = 1e-11
SHORT = ["--samples", "800", "--least", "1e-2", "--epochs", "400"]


@pytest.fixture(scope="module")
def comparison() -> study.Comparison:
    """Both trainings with every mask, where slow pairs are left out of friction only."""
    recording = sim.simulate(sim.puma_a(), sim.training(samples=800), seed=1).recording
    return study.compare(recording, least=1e-2, epochs=400, backlash=True, slow_pairs="friction")


def test_links_of_appendix_b_give_the_torques(
    puma: jc.CSLC, appendix_b: dict[str, Any], rng: np.random.Generator
) -> None:
    assert tuple(puma.names) == network.appendix_names()
    q, qd, qdd = rng.uniform(-2, 2, (3, 20, 6))
    k = rng.normal(size=puma.size)
    parts = network.appendix_network(appendix_b, puma.names)
    y = network.outputs(parts, network.appendix_signals(appendix_b, q, qd, qdd), k)
    assert_allclose(y.T, puma.torque(k, q, qd, qdd), rtol=1e-12, atol=1e-12)


def test_library_and_transcription_train_alike(comparison: study.Comparison) -> None:
    """Masks, rule, rates and ε of every epoch; and the coefficients at the end."""
    assert comparison.agree
    library, transcription = comparison.library, comparison.transcription
    assert library.outcomes() == {"no further reduction": 1}
    epochs = len(transcription.rule)
    assert set(transcription.rule) == {0, 1}
    history = library.history
    assert np.asarray(history.rule)[:epochs].tolist() == transcription.rule
    assert_allclose(history.cost[:epochs], transcription.cost, rtol=0, atol=ROUNDING)
    assert_allclose(history.rates[:epochs], transcription.rates, rtol=1e-9)
    assert_allclose(library.cost, transcription.final, rtol=0, atol=ROUNDING)
    assert_allclose(library.weights, transcription.k, rtol=1e-9, atol=1e-10)


def test_a_difference_is_noticed(comparison: study.Comparison) -> None:
    route = comparison.transcription
    other_rule = [*route.rule[:-1], 1 - route.rule[-1]]
    other_rules = comparison._replace(transcription=route._replace(rule=other_rule))
    other_cost = [*route.cost[:7], route.cost[7] + 2e-9, *route.cost[8:]]
    other_epoch = comparison._replace(transcription=route._replace(cost=other_cost))
    other_end = comparison._replace(transcription=route._replace(final=route.final + 2e-9))
    assert not other_rules.same_rules
    assert other_epoch.first_difference == 7
    assert not other_epoch.agree and not other_end.agree
    assert not comparison._replace(same_masks=False).agree


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without the mask of backlash, slow pairs left out of everything; exit status 0 says that both
    agree."""
    assert study.main([*SHORT, "-o", str(tmp_path / "out")]) == 0
    assert "the same rule in every epoch: True" in capsys.readouterr().out
    assert (tmp_path / "out" / "transcription.csv").is_file()


def test_masks_by_subnetwork(rng: np.random.Generator, appendix_b: dict[str, Any]) -> None:
    parts = network.appendix_network(appendix_b, network.appendix_names())
    backlash, slow_pairs = rng.uniform(size=(2, 30, 6)) < 0.3
    by_part = network.counted(parts, backlash, slow_pairs, friction_only=True)
    everywhere = network.counted(parts, backlash, slow_pairs, friction_only=False)
    assert_array_equal(by_part[:3], np.broadcast_to(~backlash.T, (3, 6, 30)))
    assert_array_equal(by_part[3:], np.broadcast_to(~(backlash | slow_pairs).T, (2, 6, 30)))
    assert_array_equal(everywhere, np.broadcast_to(by_part[4], everywhere.shape))


def test_eqn_2_5_7_and_slow_pairs() -> None:
    torque = np.array([[1.0, 1.0, -1.0, 1.0, 1.0, 0.0]]).T
    qd = np.array([[0.5, -100.0, -1.0, 1.1, 0.0, 2.0]]).T
    qdd = np.array([[2.0, -2.0, -2.0, -2.0, 3.0, -1.0]]).T
    possible = [True, False, True, False, True, False]
    assert network.possible_backlash(qd, qdd, torque).ravel().tolist() == possible
    assert network.slow(qd).ravel().tolist() == [True, False, True, False, True, False]


def test_half_rms_is_of_pairs_that_count() -> None:
    errors = np.array([[3.0, 0.0, 9.0], [4.0, 1.0, 9.0]])
    judged = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])
    assert_allclose(training.cost_of(errors, judged), (np.sqrt(12.5) / 2 + 1 / 2) / 2)


RULE = training.RateRule(0.01)


def test_a_rate_rises_to_a_part_of_the_best() -> None:
    """For a parabola, a tenth more gains 8 % more up to 31 % of the rate that is best."""
    best = np.array([1.0, 3.0])

    def cost_at(rates: np.ndarray) -> float:
        return float(np.sum((1 - rates / best) ** 2))

    rates = np.full(2, RULE.start)
    for _ in range(200):
        rates, moved = training.followed_rates(RULE, rates, 2.0, cost_at)
        assert moved
    limit = 2 * (RULE.step - RULE.gain) / (2 * RULE.step + RULE.step**2 - RULE.gain)
    assert np.all((rates >= limit * best) & (rates < (1 + RULE.step) * limit * best))


def test_rates_that_raise_the_cost_come_down() -> None:
    """Neither at the adapted nor at the present rates: no move, and all rates go down."""
    rates, moved = training.followed_rates(
        RULE, np.array([1.0, 2.0]), 1.0, lambda trial: 5.0 + float(np.sum(trial))
    )
    assert not moved
    # Each went down by itself already: by a tenth of what that left.
    assert_allclose(rates, [0.81, 1.62])


def test_no_rate_falls_below_its_floor() -> None:
    least = RULE.floor * RULE.start
    rates, moved = training.followed_rates(
        RULE, np.array([least, least]), 1.0, lambda trial: 5.0 + float(np.sum(trial))
    )
    assert not moved
    assert_array_equal(rates, [least, least])


def test_peral_leaves_weights_of_zero(appendix_b: dict[str, Any], rng: np.random.Generator) -> None:
    parts = network.appendix_network(appendix_b, network.appendix_names())
    q, qd, qdd = rng.uniform(-2, 2, (3, 10, 6))
    signals = network.appendix_signals(appendix_b, q, qd, qdd)
    t = rng.normal(size=(6, 10))
    problem = training.Problem(parts, signals, t, np.ones((5, 6, 10)))
    change = training.peral(problem, np.zeros(43), t)
    assert_array_equal(change, np.zeros((5, 43)))


def test_too_few_samples_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        study.main(["--samples", "10"])
    assert "--samples is 10; expected 500 or more" in capsys.readouterr().err.splitlines()[-1]
