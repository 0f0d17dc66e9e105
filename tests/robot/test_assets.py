"""The meshes and the exported model: up to date, small, and only for the eye."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.robot.worlds import world
from twin.arena import compile_world
from twin.assets.make_meshes import HERE, jackal_xml, make_meshes
from twin.robot.handles import RobotHandles


def test_the_exported_model_is_that_of_the_source_and_loads() -> None:
    assert (HERE / "jackal.xml").read_text(encoding="utf-8") == jackal_xml()
    model = mujoco.MjModel.from_xml_path(str(HERE / "jackal.xml"))
    assert model.body_mass.sum() == pytest.approx(18.432 + 1.1)


def test_the_meshes_are_those_of_the_script(tmp_path: Path) -> None:
    made = make_meshes(tmp_path)
    assert {path.name for path in made} == {path.name for path in HERE.glob("*.stl")}
    for path in made:
        assert abs(path.stat().st_size - (HERE / path.name).stat().st_size) <= 0.02 * path.stat().st_size
    assert sum(path.stat().st_size for path in HERE.glob("*.stl")) < 500_000


def test_meshes_neither_collide_nor_show_in_the_scan_and_fill_the_published_size() -> None:
    model = compile_world(world("open"))
    robot, data = RobotHandles.resolve(model), mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    meshes = np.flatnonzero(robot.is_robot & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH))
    assert len(meshes) >= 10
    assert not np.any(model.geom_contype[meshes] | model.geom_conaffinity[meshes])
    assert set(model.geom_group[meshes].tolist()) == {2}
    corners = []
    for geom in meshes:
        if "lidar" in model.geom(geom).name:
            continue
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        turn = data.geom_xmat[geom].reshape(3, 3)
        corners.append(model.mesh_vert[first : first + count] @ turn.T + data.geom_xpos[geom])
    low, high = np.vstack(corners).min(axis=0), np.vstack(corners).max(axis=0)
    np.testing.assert_allclose(high - low, (0.508, 0.430, 0.250), atol=0.02)  # Clearpath's data sheet
    assert low[2] == pytest.approx(0.0, abs=0.002)
