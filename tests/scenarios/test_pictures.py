"""Pictures: points land where the camera sees them, stripes tell the contexts, and what the pages show is there."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from scenarios.pictures.__main__ import PICTURES
from scenarios.pictures.ink import colour_of, stripes_by_context
from scenarios.pictures.views import MARGIN, fitted, whole
from scenarios.worlds import load_world

ROOT = Path(__file__).resolve().parents[2]
SHOWN = ROOT / "docs" / "pictures"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

SEEN = """
import sys
import numpy as np
from scenarios.pictures.stage import Stage, View
from twin.records import Pose2
from twin.world import Cylinder, Rules, World

posts = [(1.5, 0.8), (-0.4, -1.1), (2.2, -0.9)]
thin = tuple(Cylinder(x, y, 0.04, 0.02) for x, y in posts)
world = World("posts", thin, Pose2(0, 0, 0), Pose2(9, 0, 0), Rules("course", 0.3, 10.0))
size = (400, 300)
views = (
    View((0.6, 0.1, 0.2), 70.0, -65.0, height=4.0),
    View((0.6, 0.1, 0.2), 200.0, -40.0, away=5.0, angle=50.0),
)
with Stage(world, size) as stage:
    for view in views:
        dark = np.asarray(stage.floor(view)) < 128
        for x, y in posts:
            across, down = view.pixels(np.array([(x, y, 0.01)]), size)[0]
            assert dark[round(down), round(across)], (view, x, y)
            across, down = view.pixels(np.array([(x + 0.25, y + 0.25, 0.0)]), size)[0]
            assert not dark[round(down), round(across)], (view, x, y)
"""


FILMED = """
from itertools import islice
import numpy as np
from scenarios.pictures import animation
from scenarios.trials import TrialSpec, make_driver, make_simulation
from scenarios.worlds import load_world
from twin.rollout import rollout

spec = TrialSpec("training", driver="theta:B1")
ticks = list(islice(rollout(make_simulation(spec, load_world(spec.world)), make_driver(spec)), animation.TICKS))
frames = [np.asarray(frame) for frame in animation.film(ticks)]
assert len(frames) == 2
assert all(frame.shape == (animation.SIZE[1], animation.SIZE[0], 3) for frame in frames)
assert not np.array_equal(frames[0], frames[-1])
"""


@pytest.fixture(scope="module")
def drawing() -> dict[str, str]:
    """An environment in which MuJoCo draws without a screen."""
    code = "import mujoco; c = mujoco.GLContext(8, 8); c.make_current(); c.free()"
    for backend in ("egl", "osmesa"):
        environment = {**os.environ, "MUJOCO_GL": backend, "PYTHONPATH": str(ROOT)}
        if not subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, check=False
        ).returncode:
            return environment
    pytest.skip("neither EGL nor OSMesa can draw here")


@pytest.mark.parametrize("code", [SEEN, FILMED], ids=["points land where the camera sees them", "the film is shot"])
def test_without_a_screen(code: str, drawing: dict[str, str]) -> None:
    done = subprocess.run([sys.executable, "-c", code], env=drawing, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["training", "unseen", "barn-like/3"])
@pytest.mark.parametrize("azimuth", [90.0, 180.0])
def test_a_whole_world_fits(name: str, azimuth: float) -> None:
    world, size = load_world(name), (600, 300)
    view = whole(world, size, azimuth)
    points = np.array([(o.x, o.y, 0.0) for o in world.obstacles])  # type: ignore[union-attr]
    seen = view.pixels(points, size)
    assert (seen >= 0).all()
    assert (seen <= size).all()


def test_a_fitted_view_leaves_the_margin_and_no_more() -> None:
    points = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    size = (500, 400)
    view = fitted(points, size, azimuth=30.0)
    assert view.height is not None
    seen = view.pixels(points, size) * view.height / size[1]  # [m]
    spare = np.minimum(seen.min(axis=0), np.array(size) * view.height / size[1] - seen.max(axis=0))
    assert spare.min() == pytest.approx(MARGIN)


def test_stripes_join_and_tell_the_contexts() -> None:
    points = np.column_stack([np.arange(0, 6, 0.1), np.zeros(60)])
    contexts = ["default"] * 20 + ["A1"] * 30 + ["default"] * 10
    stripes = stripes_by_context(points, contexts)
    assert [s.colour for s in stripes] == [colour_of(c) for c in ("default", "A1", "default")]
    for one, following in pairwise(stripes):
        assert np.array_equal(one.points[-1], following.points[0])
    assert stripes[-1].points[-1, 0] == pytest.approx(5.9)


def test_what_can_be_remade_is_there_and_small() -> None:
    assert set(PICTURES) <= {path.name for path in SHOWN.iterdir()}
    assert sum(path.stat().st_size for path in SHOWN.iterdir()) < 8_000_000
    assert (SHOWN / "drive.webp").stat().st_size < 5_000_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_picture_and_page_that_is_linked_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    missing = [t for t in targets if not t.startswith("http") and not (page.parent / t).exists()]
    assert not missing
