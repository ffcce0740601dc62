"""Motion of actors over the ground: poses, velocities, steps and speeds, against their formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rainsim.actors.actor import Actor
from rainsim.actors.motion import BEFORE, Motion, Track
from rainsim.scene.types import GroundFrame

BOX = np.array([[1.0, 0.0, 0.5], [4.0, 2.0, 1.0]])
WHEELS = np.array([[-1.0, 0.5, 0, 0.2, 0.3], [2.0, 0.5, 0, 0.2, 0.3], [2.0, -0.5, 0, 0.2, 0.3]])


@pytest.fixture
def frame(rng):
    """A ground frame with a turn, a scale and a shift."""
    turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    return GroundFrame(turn, 0.4, rng.normal(size=3))


@pytest.fixture
def motion(rng, frame):
    """An actor that moves and turns from 1 s to 3 s, and is gone after 3 s."""
    turns = Rotation.from_rotvec([[0, 0, 0.2], [0, 0, 0.9], [0, 0.1, 1.2]]).as_quat()
    place = np.array([[0.0, 0, 0], [3.0, 4.0, 0], [9.0, 4.0, 1.0]])
    times, visible = np.array([1.0, 2.0, 3.0]), np.array([True, True, False])
    track = Track(times, place, np.roll(turns, 1, axis=1), visible)
    return Motion(Actor("a", "cart", None, BOX, track, wheels=WHEELS), frame)


@pytest.mark.parametrize("time", [0.5, 1.0, 1.7, 2.2])
def test_poses_over_the_ground_are_those_of_the_capture_taken_there(motion, frame, rng, time):
    points = rng.normal(size=(5, 3))  # capture units
    wanted = frame.to_ground(motion.actor.track.pose(time).places(points))
    for pose in (motion.at(time), motion.pose(time)):
        np.testing.assert_allclose(pose.places(points * frame.meters_per_unit), wanted, atol=1e-12)


def test_an_actor_that_is_away_has_a_pose_and_is_not_there(motion):
    assert motion.at(3.5) is None and not motion.came([3.5])[2].any()
    np.testing.assert_array_equal(motion.pose(3.5).position, motion.pose(3.0).position)


def test_before_its_track_an_actor_comes_as_it_goes_on(motion):
    times = np.array([1 - BEFORE - 0.1, 0.0, 0.5, 1.0, 1.5])
    rotation, (_, a, b, c, d), there = motion.came(times)
    np.testing.assert_allclose(c - b, b - a, atol=1e-12)
    first = motion.pose(1.1).position - motion.pose(1.0).position
    np.testing.assert_allclose(c - b, 5 * first, atol=1e-12)
    np.testing.assert_allclose(d, motion.at(1.5).position, atol=1e-12)
    np.testing.assert_allclose(rotation[-1], motion.at(1.5).rotation, atol=1e-12)
    assert there.tolist() == [False, True, True, True, True]
    np.testing.assert_array_equal(motion.at(0.0).position, motion.at(1.0).position)


def test_velocities_steps_and_speeds_agree(motion, frame):
    time, interval = 1.2, 1e-5
    step = motion.step(time, interval)
    now, then = (motion.pose(t).places(motion.box[:1])[0] for t in (time, time + interval))
    np.testing.assert_allclose(step[:3, :3] @ now + step[:3, 3], then, atol=1e-12)
    np.testing.assert_allclose(motion.velocity(time, interval) * interval, then - now, atol=1e-12)
    origin = [motion.pose(t).position for t in (time, time + interval)]
    speed = np.linalg.norm(origin[1] - origin[0]) / interval
    assert motion.speeds()[0] == pytest.approx(speed, rel=1e-6) == 5.0 * frame.meters_per_unit
    assert len(motion.speeds()) == 2 and motion.speeds()[1] > 0


def test_an_actor_has_no_speed_while_it_is_away(motion):
    track = motion.actor.track
    hidden = Track(track.time, track.position, track.rotation, np.array([True, False, True]))
    gone = Motion(Actor("a", "cart", None, BOX, hidden), motion.frame)
    assert gone.speeds()[0] > 0 and gone.speeds()[1] == 0


def test_wheels_are_in_metres_and_those_in_front_come_first(motion, frame):
    np.testing.assert_allclose(motion.wheels, WHEELS[[1, 2, 0]] * frame.meters_per_unit)
    np.testing.assert_allclose(motion.box, BOX * frame.meters_per_unit)
