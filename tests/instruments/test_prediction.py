"""Open-loop simulation: closed forms, MuJoCo's path, rest, and errors over a horizon."""

import dataclasses

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxcslc as jc
from jaxcslc.instruments import file_coefficients, prediction_error, simulate
from tests import arms
from tests.yielding_motion import yielding_motion


class TestSimulation:
    def test_sliding_to_rest(self) -> None:
        """Dry friction alone: a parabola until v / (F / M), and rest from then on."""
        network = arms.turntable("dry")
        speed, inertia, dry = 1.3, 2.0, 4.0
        start = np.zeros((1, 1))
        path = simulate(
            *(network, np.array([inertia, dry]), start, start + speed, np.zeros((200, 1, 1)), 0.01)
        )
        t = 0.01 * np.arange(201)
        slides = np.minimum(t, speed * inertia / dry)
        exact = speed * slides - 0.5 * dry / inertia * slides**2
        assert_allclose(path[:, 0, 0], exact, atol=1e-12)

    def test_mujoco_goes_the_same_way(self) -> None:
        """A double pendulum with viscous friction, from several states, for a second."""
        links = [(1.2, 0.25, 0.03), (0.8, 0.2, 0.02)]  # mass, centre along x, inertia about it
        bodies = ""
        for index, (mass, centre, inertia) in enumerate(links):
            offset = "0 0 0" if index == 0 else "0.5 0 0"
            bodies += (
                f'<body pos="{offset}"><joint type="hinge" axis="0 0 1" damping="0.3"/>'
                f'<inertial pos="{centre} 0 0" mass="{mass}"'
                f' diaginertia="1e-3 {inertia} {inertia}"/>'
            )
        model = mujoco.MjModel.from_xml_string(
            '<mujoco><option gravity="0 -9.81 0" timestep="0.0005" integrator="RK4"/><worldbody>'
            f"{bodies}{'</body>' * 2}</worldbody></mujoco>"
        )
        network = arms.planar_arm("viscous")
        parameters = [
            jc.manipulator.LinkParameters(
                mass, np.array([centre, 0.0, 0.0]), np.diag([1e-3, inertia, inertia])
            )
            for mass, centre, inertia in links
        ]
        k = network.coefficients_from(parameters, viscous=[0.3, 0.3])
        rng = np.random.default_rng(0)
        q, qd = rng.uniform(-1.0, 1.0, (2, 3, 2))
        path = simulate(network, k, q, qd, np.zeros((100, 3, 2)), 0.01)
        for start in range(3):
            data = mujoco.MjData(model)
            data.qpos, data.qvel = q[start], qd[start]
            for _ in range(2000):
                mujoco.mj_step(model, data)
            # Steps of 2 ms of the midpoint rule.
            assert_allclose(path[-1, start], data.qpos, atol=2e-4)

    def test_a_joint_at_rest_stays_while_another_moves(self) -> None:
        robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)], gravity=(0, 0, 0))
        network = jc.derive(robot.with_friction("dry"), lengths="numeric")
        link = jc.manipulator.LinkParameters(1.0, np.array([0.2, 0.0, 0.0]), 0.02 * np.eye(3))
        k = network.coefficients_from([link, link], dry=[50.0, 0.01])
        still = np.zeros((1, 2))
        path = simulate(network, k, still, still, np.full((50, 1, 2), 0.2), 0.01)
        assert_allclose(path[:, 0, 0], 0.0, atol=1e-6)
        assert path[-1, 0, 1] > 0.05


class TestPreSliding:
    """Contacts that yield before they slide, among the states of the integration."""

    @staticmethod
    def arm() -> tuple[jc.CSLC, np.ndarray]:
        network = arms.planar_arm("viscous", "dry")
        link = jc.manipulator.LinkParameters(1.0, np.array([0.2, 0.0, 0.0]), 0.02 * np.eye(3))
        k = network.coefficients_from([link, link], viscous=[0.3, 0.3], dry=[0.8, 0.4])
        return network, np.array(k)

    @pytest.mark.parametrize("length", [0.03, 2e-3, 2e-4])
    def test_an_integrator_with_steps_by_its_error_goes_the_same_way(self, length: float) -> None:
        """Two joints with many reversals, for two seconds, from contacts with strain."""
        network, k = self.arm()
        q, contact, lengths = np.array([-1.2, 0.3]), np.array([0.5, -0.2]), length * np.ones(2)
        t = 0.01 * np.arange(200)[:, None]
        torque = np.array([2.5, 1.0]) * np.sin(np.array([6.0, 9.0]) * t)
        torque = torque + np.asarray(network.gravity_term(k, q))
        exact, _, _ = yielding_motion(network, k, lengths, (q, 0.0 * q, contact), torque, 0.01)
        path = simulate(
            *(network, k, q[None], 0.0 * q[None], torque[:, None], 0.01),
            presliding_distance=lengths,
            contact=contact[None],
        )
        # Steps of 2 ms; the stiffest contact here vibrates at 90 Hz.
        assert_allclose(path[:, 0], exact, atol=5e-4)
        without = simulate(network, k, q[None], 0.0 * q[None], torque[:, None], 0.01)
        assert np.max(np.abs(without[:, 0] - np.asarray(exact))) > 0.01

    def test_a_contact_that_bears_the_torque_is_at_rest(self) -> None:
        """In equilibrium nothing moves, however stiff the contact; another state lets it go."""
        network = arms.turntable("dry")
        start, push = np.zeros((3, 1)), np.full((500, 3, 1), 3.0)
        contact = np.array([[0.75], [0.75 - 1e-6], [-0.75]])
        path = simulate(
            *(network, np.array([0.1, 4.0]), start, start, push, 0.01),
            presliding_distance=np.array([1e-5]),
            contact=contact,
        )
        assert_allclose(path[:, 0], 0.0, atol=1e-15)
        # The second vibrates, and creeps as such contacts do; steps of two radians of that add
        # no energy. By the stiffness of one direction alone it creeps by 0.07 of the length.
        assert np.all(np.abs(path[:, 1]) < 0.02 * 1e-5)
        # The third yields by what takes its state where it bears the push, at least.
        assert path[-1, 2, 0] > 1e-5 * np.log(1.75 / 0.25)

    def test_a_short_length_is_friction_that_follows_the_sign(self) -> None:
        """Sliding to rest, a parabola."""
        network = arms.turntable("dry")
        start, no_torque = np.zeros((1, 1)), np.zeros((200, 1, 1))
        arguments = network, np.array([2.0, 4.0]), start, start + 1.3, no_torque, 0.01
        path = simulate(*arguments, presliding_distance=np.array([1e-6]), contact=np.ones((1, 1)))
        assert_allclose(path, simulate(*arguments), atol=2e-3)

    def test_a_joint_that_sticks_beside_one_that_yields(self) -> None:
        """Each has its law: as two joints that yield, but that one stays where it is."""
        network, k = self.arm()
        k[network.names.index("kd1")] = 50.0
        start, push = np.zeros((1, 2)), np.zeros((100, 1, 2))
        push[..., 1] = np.asarray(network.gravity_term(k, start))[0, 1] + 0.3
        arguments = network, k, start, start, push, 0.01
        path = simulate(*arguments, presliding_distance=np.array([0.0, 0.05]))[:, 0]
        both = simulate(*arguments, presliding_distance=np.array([1e-9, 0.05]))[:, 0]
        assert_allclose(path[:, 0], 0.0, atol=1e-6)
        assert_allclose(path[:, 1], both[:, 1], atol=1e-6)
        assert np.max(path[:, 1]) > 0.01

    def test_windows_start_as_the_recording_before_them_leaves_contacts(self) -> None:
        """Half of the windows start within a few lengths after a reversal: true coefficients and
        lengths predict the motion, true coefficients without them do not."""
        network, k = self.arm()
        q, lengths, interval = np.array([-1.2, 0.3]), np.array([0.05, 0.08]), 0.005
        time = interval * np.arange(1201)
        torque = np.array([1.6, 0.8]) * np.sin(np.array([7.0, 9.0]) * time[:-1, None])
        torque = torque + np.asarray(network.gravity_term(k, q))
        start = q, 0.0 * q, 0.0 * q
        path, _, _ = yielding_motion(network, k, lengths, start, torque, interval)
        held = np.concatenate([torque, torque[-1:]])
        recording = jc.Recording(time, np.asarray(path), held)
        settings = jc.Settings(jc.Preparation(jc.Butterworth(60.0)))
        result = prediction_error(
            *(network, {"with": k, "without": k}, recording, settings),
            presliding_distance={"with": lengths},
            horizons=(0.1, 0.2, 0.5),
        )
        assert np.all(result.error["with"] < 0.1 * result.error["without"])


@pytest.fixture(scope="module")
def recording() -> tuple[jc.CSLC, np.ndarray, jc.Recording]:
    network = arms.pendulum("viscous", "dry")
    k = np.array([0.5, 0.3, -0.1, 0.2, 0.3])
    t = 0.01 * np.arange(800)[:, None]
    motion = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    return network, k, jc.Recording(t[:, 0], motion[0], np.asarray(network.torque(k, *motion)))


class TestHorizon:
    def test_better_coefficients_have_the_smaller_error(
        self, recording: tuple[jc.CSLC, np.ndarray, jc.Recording]
    ) -> None:
        network, k, motion = recording
        result = prediction_error(network, {"true": k, "other": 1.1 * k}, motion)
        assert result.horizons.tolist() == [0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
        assert np.all(result.error["true"][1:] < 0.2 * result.error["other"][1:])
        assert result.starts[0] == 24 and result.starts[-1] < 24
        assert "joint 1 [rad]" in str(result)

    def test_the_report_has_it(self, recording: tuple[jc.CSLC, np.ndarray, jc.Recording]) -> None:
        network, _, motion = recording
        report = jc.identify(
            *(network, motion),
            settings=jc.Settings(),
            simulate=True,
            checks=False,
            systematic=False,
            possible="never",
        )
        assert report.horizon is not None and tuple(report.horizon.error) == ("fit",)
        assert "simulated without feedback" in str(report)
        document = report.horizon.document()
        assert document["horizons"][0] == 0.1 and len(document["error"]["fit"][0]) == 1

    def test_the_robot_of_the_file(self) -> None:
        network = jc.derive(jc.puma560())
        robot = network.robot
        (k,) = file_coefficients(network).values()
        assert robot.links is not None
        expected = network.coefficients_from(robot.links, viscous=robot.viscous, dry=robot.dry)
        assert_allclose(k, expected)
        assert file_coefficients(arms.pendulum("dry")) == {}

    def test_the_distance_of_the_last_frame(self) -> None:
        """Joint 2, half a metre from joint 1's axis, is off by the chord of joint 1's error."""
        robot = jc.Manipulator.from_modified_dh([(0, 0, 0, 0), (0, 0.5, 0, 0)])
        network = jc.derive(robot, lengths="numeric")
        link = jc.manipulator.LinkParameters(1.0, np.array([0.2, 0.0, 0.0]), 0.02 * np.eye(3))
        k = np.array(network.coefficients_from([link, link], viscous=[1.0, 1.0], dry=[0.0, 0.0]))
        t = 0.01 * np.arange(300)[:, None]
        motion = [np.tile(x, 2) for x in (np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t))]
        torque = np.asarray(network.torque(k, *motion))
        recording = jc.Recording(t[:, 0], motion[0], torque)
        result = prediction_error(network, {"other": 1.1 * k}, recording)
        off = result.error["other"][:, 0]
        np.testing.assert_allclose(result.distance["other"], np.sin(off / 2), rtol=1e-6)
        assert "last frame [mm]" in str(result)

    def test_a_body_that_is_none_diverges(
        self, recording: tuple[jc.CSLC, np.ndarray, jc.Recording]
    ) -> None:
        network, k, motion = recording
        result = prediction_error(network, {"none": k * [0.0, 1, 1, 1, 1]}, motion)
        assert np.all(np.isinf(result.error["none"]))
        assert result.document()["error"]["none"][0] == [None]

    def test_too_short(self, recording: tuple[jc.CSLC, np.ndarray, jc.Recording]) -> None:
        network, k, motion = recording
        with pytest.raises(ValueError, match=r"lasts 0\.9 s; expected more than 3 s"):
            prediction_error(network, {"true": k}, motion.between(0.0, 1.08), horizons=(3.0,))

    def test_other_joints(self, recording: tuple[jc.CSLC, np.ndarray, jc.Recording]) -> None:
        network, k, motion = recording
        two = dataclasses.replace(
            motion,
            position=np.tile(motion.position, 2),
            torque=np.tile(motion.torque, 2),
        )
        with pytest.raises(ValueError, match="has 2 joints; expected 1"):
            prediction_error(network, {"true": k}, two)
