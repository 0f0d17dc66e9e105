"""The compiled model against the published numbers of the Jackal."""

from __future__ import annotations

import subprocess
import sys

import mujoco
import numpy as np
import pytest

from tests.robot.worlds import world
from twin.arena import compile_world
from twin.records import Pose2
from twin.robot import jackal
from twin.robot.handles import RobotHandles

MODEL = compile_world(world("open", start=Pose2(1.0, -2.0, 0.7)))
ROBOT = RobotHandles.resolve(MODEL)


def inertia(body: int) -> np.ndarray:
    """(3, 3) inertia of a body about its centre of mass, in its own frame."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, MODEL.body_iquat[body])
    axes = rotation.reshape(3, 3)
    return axes @ np.diag(MODEL.body_inertia[body]) @ axes.T


def test_chassis_has_the_published_mass_centre_and_full_inertia() -> None:
    chassis = ROBOT.bodies[0]
    xx, yy, zz, xy, xz, yz = 0.3136, 0.3922, 0.4485, -0.0008, 0.0164, -0.0009
    assert MODEL.body_mass[chassis] == pytest.approx(16.523)
    np.testing.assert_allclose(MODEL.body_ipos[chassis], (0.012, 0.002, 0.067))
    np.testing.assert_allclose(inertia(chassis), [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-9)


def test_wheels_have_the_published_place_mass_and_shape() -> None:
    for body, (x, y) in zip(ROBOT.bodies[1:], ((1, 1), (1, -1), (-1, 1), (-1, -1)), strict=True):
        np.testing.assert_allclose(MODEL.body_pos[body], (0.131 * x, 0.187795 * y, 0.0345))
        assert MODEL.body_mass[body] == pytest.approx(0.477)
        np.testing.assert_allclose(inertia(body), np.diag([0.0013, 0.0024, 0.0013]), atol=1e-12)
        geom = collision_geom(body)
        assert MODEL.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
        np.testing.assert_allclose(MODEL.geom_size[geom][:2], (0.098, 0.020))
        assert MODEL.geom_friction[geom, 0] == 0.5
        joint = MODEL.body_jntadr[body]
        np.testing.assert_allclose(MODEL.jnt_axis[joint], (0, 1, 0))
        assert MODEL.dof_armature[MODEL.jnt_dofadr[joint]] == 0.1


def collision_geom(body: int) -> int:
    """The one geom of a body that collides."""
    (geom,) = (g for g in np.flatnonzero(MODEL.geom_bodyid == body) if MODEL.geom_contype[g])
    return int(geom)


def test_chassis_collides_as_the_published_box() -> None:
    geom = collision_geom(ROBOT.bodies[0])
    assert MODEL.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
    np.testing.assert_allclose(2 * MODEL.geom_size[geom], (0.420, 0.310, 0.184))
    np.testing.assert_allclose(MODEL.geom_pos[geom], (0, 0, 0.092))


@pytest.mark.parametrize(("mount", "position"), [("ust10", (0.055, 0.0, 0.2414)), ("lms1xx", (0.12, 0.0, 0.333))])
def test_total_mass_and_lidar(mount: str, position: tuple[float, float, float]) -> None:
    model = compile_world(world("open"), lidar_mount=mount)
    robot = RobotHandles.resolve(model)
    assert model.body_subtreemass[robot.bodies[0]] == pytest.approx(18.432 + 1.1)
    assert robot.mount == pytest.approx(position)
    assert model.body_mass[model.site_bodyid[robot.lidar]] == pytest.approx(1.1)


def test_an_unknown_lidar_mount_is_refused_with_the_choices() -> None:
    with pytest.raises(ValueError, match="ust10, lms1xx"):
        jackal.build_jackal("vlp16")


def test_the_robot_begins_at_the_start_and_stands_at_its_ride_height() -> None:
    data = mujoco.MjData(MODEL)
    mujoco.mj_forward(MODEL, data)
    assert (pose := ROBOT.pose(data)) == Pose2(pytest.approx(1.0), pytest.approx(-2.0), pytest.approx(0.7)), pose
    assert pytest.approx(0.0635) == jackal.RIDE_HEIGHT
    mujoco.mj_step(MODEL, data, 500)
    height = data.xpos[ROBOT.bodies[0], 2]
    assert height == pytest.approx(0.0635, abs=5e-4)
    assert ROBOT.touched(data) is None
    assert ROBOT.pose(data).x == pytest.approx(1.0, abs=1e-4)


def test_only_the_robot_and_the_world_can_touch() -> None:
    contype, conaffinity = MODEL.geom_contype, MODEL.geom_conaffinity
    assert not np.any(contype[~ROBOT.is_robot])
    assert not np.any(conaffinity[ROBOT.is_robot])


def test_the_contact_settings_reach_the_compiled_world() -> None:
    assert MODEL.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert MODEL.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert MODEL.opt.tolerance == 1e-4
    assert MODEL.opt.timestep == 0.002
    assert MODEL.geom_type[ROBOT.floor] == mujoco.mjtGeom.mjGEOM_PLANE


def test_the_yaw_rate_is_what_the_gyro_measures() -> None:
    data = mujoco.MjData(MODEL)
    data.qpos[ROBOT.free_qpos + 3 : ROBOT.free_qpos + 7] = (0.9, 0.1, -0.2, 0.3)
    data.qvel[ROBOT.free_dof + 3 : ROBOT.free_dof + 6] = (0.3, -0.2, 0.7)
    mujoco.mj_forward(MODEL, data)
    assert ROBOT.yaw_rate(data) == pytest.approx(data.sensor("jackal/gyro").data[2])


def test_importing_the_robot_prints_nothing() -> None:
    code = "import os; os.environ.pop('DISPLAY', None); os.environ.pop('MUJOCO_GL', None); import twin.arena"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""
