"""What `identify` decides beyond its parts."""

import numpy as np
import pytest

import jaxcslc as jc


def test_joints_that_lose_static_friction_mask_their_slow_pairs_again() -> None:
    """Dry friction alone: the slope is not determined, and slow pairs have no term any more."""
    arm = jc.examples.pendulum()
    network = jc.derive(arm.with_friction("viscous", "dry"), lengths="numeric")
    t = np.arange(2000)[:, None] * 0.01
    q, qd, qdd = np.sin(t), np.cos(t), -np.sin(t)
    k = np.array([0.5, 0.3, -0.1, 0.2, 0.4])
    noise = np.random.default_rng(3).normal(size=q.shape)
    recording = jc.Recording(t[:, 0], q, np.asarray(network.torque(k, q, qd, qdd)) + 0.01 * noise)

    static = jc.derive(arm.with_friction("viscous", "dry", "static"), lengths="numeric")
    report = jc.identify(static, recording, settings=jc.Settings())
    plain = jc.identify(network, recording, settings=jc.Settings())
    assert report.slopes is not None and report.slopes.dropped == (1,)
    assert any("static friction dropped" in warning for warning in report.warnings)
    assert report.network.names == network.names
    assert report.settings.preparation.threshold_fraction == (0.03,)
    np.testing.assert_array_equal(report.patterns["training"].mask, plain.patterns["training"].mask)
    np.testing.assert_allclose(report.k, plain.k, rtol=1e-9)

    by_hand = jc.Settings(jc.Preparation(threshold_fraction=0.01))
    kept = jc.identify(static, recording, settings=by_hand)
    assert kept.settings.preparation.threshold_fraction == 0.01


def test_what_is_fitted_does_not_judge() -> None:
    network = jc.derive(jc.examples.pendulum(), lengths="numeric")
    recording = jc.examples.swing_recording(network, [0.5, 0.3, -0.1, 0.2, 0.05])
    with pytest.raises(ValueError, match="validation: the same samples as b, which is fitted"):
        jc.identify(network, {"a": recording.rows(slice(300)), "b": recording}, recording)
