"""Fits of maximum likelihood that begin before least squares are done."""

import dataclasses
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.identification import Likelihood, _likelihood
from jaxcslc.identification._exclusions import Request
from jaxcslc.likelihood import MaximumLikelihood
from tests import arms


OPTIONS = MaximumLikelihood(torque_sampling="held", every=1)


@pytest.fixture(scope="module")
def network() -> jc.CSLC:
    return arms.pendulum("viscous", "dry", "static")


@pytest.fixture(scope="module")
def recording(network: jc.CSLC) -> jc.Recording:
    t = 0.01 * np.arange(500)[:, None]
    q, qd, qdd = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    k = np.array([0.5, 0.3, -0.1, 0.2, 0.4, 0.1])
    torque = np.asarray(network.with_static_slopes([5.0]).torque(k, q, qd, qdd))
    noise = 0.01 * np.random.default_rng(0).normal(size=q.shape)
    return jc.Recording(t[:, 0], 1e-3 * np.round(q / 1e-3), torque + noise)


@pytest.fixture
def request_of(network: jc.CSLC, recording: jc.Recording) -> Request:
    return Request(network, {"swing": recording}, likelihood=OPTIONS, possible="never")


def test_they_are_those_of_one_process(
    network: jc.CSLC,
    recording: jc.Recording,
    request_of: Request,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Computed at once, for XLA has threads here; sent as from another process.
    monkeypatch.setattr(_likelihood, "can_fork", lambda: True)
    monkeypatch.setattr(
        _likelihood,
        "_sent",
        lambda *given, made=_likelihood._sent: pickle.loads(pickle.dumps(made(*given))),
    )
    settings = jc.Settings()
    with Likelihood().beside(request_of) as begin:
        assert begin is not None
        whole, before = begin(settings)()
    expected = _likelihood.options_for(OPTIONS, settings).fit(network, recording)
    assert_allclose(whole.k, expected.k)
    assert_allclose(whole.slopes, expected.slopes)
    assert whole.network.static_slopes is not None
    assert whole.fit.result == expected.fit.result
    assert before is not None
    assert len(before.position) == 375


def test_least_squares_are_waited_for_where_a_fit_starts_from_them(
    network: jc.CSLC, request_of: Request, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_likelihood, "can_fork", lambda: True)
    without = network.without_law("static", (1,))
    for change in ({"network": without}, {"possible": "always"}):
        with Likelihood().beside(dataclasses.replace(request_of, **change)) as begin:
            assert begin is None
