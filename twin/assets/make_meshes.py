"""Makes the Jackal's visual meshes and `jackal.xml`: `python -m twin.assets.make_meshes`.

Everything is drawn here, from published dimensions (twin/robot/jackal.py; outer size 508 x 430 x 250 mm from
Clearpath's data sheet) and from the look of the robot; no one else's mesh went in. The meshes are for the eye only:
contact and lidar never meet them. One file per part and colour, binary STL, metres: `chassis_*` in base_link, `wheel_*`
in the wheel's frame (axle along y, outer side +y), `ust10_*` and `lms1xx_*` in the lidar's (its focal point).

Parts are unions of convex pieces that simply overlap: no boolean operations, so the result is the same everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from twin.records import Array
from twin.robot.jackal import (
    LIDAR_MOUNTS,
    RIDE_HEIGHT,
    WHEEL_HEIGHT,
    WHEEL_RADIUS,
    WHEEL_WIDTH,
    WHEELBASE,
    build_jackal,
)

HERE = Path(__file__).parent
Pieces = list[trimesh.Trimesh]

# x, z [m] of the bonnet from the top plate down to the bumper
NOSE = np.array([(0.186, 0.187), (0.216, 0.174), (0.244, 0.140), (0.254, 0.096), (0.251, 0.062)])
SKIN = 0.006  # [m] thickness of fenders and bonnet


# --- shapes ---------------------------------------------------------------------------------------------------------


def hull(points: Iterable[Sequence[float]]) -> trimesh.Trimesh:
    """The convex piece that points span."""
    return trimesh.convex.convex_hull(np.array(list(points), dtype=float))


def block(low: Sequence[float], high: Sequence[float], bevel: float = 0.0) -> trimesh.Trimesh:
    """A box between two corners, its edges cut by `bevel` [m]."""
    points = []
    for axis in range(3):
        inset = np.full(3, bevel)
        inset[axis] = 0.0
        x, y, z = zip(np.array(low) + inset, np.array(high) - inset, strict=True)
        points += [(i, j, k) for i in x for j in y for k in z]
    return hull(points)


def tube(radius: float, low: float, high: float, sides: int = 32, bevel: float = 0.0) -> trimesh.Trimesh:
    """A cylinder round z between two heights, its rims cut by `bevel` [m]."""
    turns = np.linspace(0, 2 * math.pi, sides, endpoint=False)
    rings = ((radius, low + bevel), (radius, high - bevel), (radius - bevel, low), (radius - bevel, high))
    return hull((r * math.cos(t), r * math.sin(t), z) for r, z in rings for t in turns)


def loft(sections: Sequence[Array]) -> Pieces:
    """A convex piece between each section (k, 3) and the next."""
    return [hull(np.vstack(pair)) for pair in pairwise(sections)]


def bent_plate(profile: Array, y0: float, y1: float, lift: float = 0.0, skin: float = SKIN) -> Pieces:
    """A plate along an x, z profile between y0 and y1, raised by `lift` [m] along its normal."""
    step = np.diff(profile, axis=0)
    side = np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1, keepdims=True)
    normal = np.vstack([side[:1], (side[:-1] + side[1:]) / 2, side[-1:]])
    outer, inner = profile + lift * normal, profile + (lift - skin) * normal
    return loft([np.array([(x, y, z) for x, z in (o, i) for y in (y0, y1)]) for o, i in zip(outer, inner, strict=True)])


def moved(piece: trimesh.Trimesh, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    """A shifted copy."""
    copy: trimesh.Trimesh = piece.copy()
    copy.apply_translation((x, y, z))
    return copy


def turned(piece: trimesh.Trimesh, angle: float, axis: Sequence[float]) -> trimesh.Trimesh:
    """A copy turned about an axis through the origin [rad]."""
    copy: trimesh.Trimesh = piece.copy()
    copy.apply_transform(trimesh.transformations.rotation_matrix(angle, axis))
    return copy


def along_x(piece: trimesh.Trimesh) -> trimesh.Trimesh:
    """What stood along z, lying along x."""
    return turned(piece, math.pi / 2, (0, 1, 0))


def along_y(piece: trimesh.Trimesh) -> trimesh.Trimesh:
    """What stood along z, lying along y."""
    return turned(piece, -math.pi / 2, (1, 0, 0))


def mirrored(pieces: Pieces, *axes: int) -> Pieces:
    """The pieces and their mirror images across the planes normal to each axis."""
    for axis in axes:
        flip = np.diag([-1.0 if k == axis else 1.0 for k in range(3)] + [1.0])
        images = [piece.copy() for piece in pieces]
        for image in images:
            image.apply_transform(flip)
        pieces = pieces + images
    return pieces


# --- the parts ------------------------------------------------------------------------------------------------------


def chassis() -> dict[str, Pieces]:
    """Body, plates and lamps; base_link."""
    side = [(0.186, 0.0), (0.212, 0.020), (0.222, 0.090), (0.205, 0.160), (0.180, 0.182)]  # x, z of the front half
    outline = [*side, *((-x, z) for x, z in side)]
    body = hull(
        [(x, y, z) for x, z in outline for y in (-0.146, 0.146)]
        + [(0.975 * x, y, 0.006 + 0.94 * z) for x, z in outline for y in (-0.154, 0.154)]
    )
    axles = [moved(along_y(tube(0.030, -0.170, 0.170, 20, 0.002)), x, 0, WHEEL_HEIGHT) for x in _axles()]
    panel = [block((-0.030, 0.150, 0.048), (0.030, 0.1565, 0.148), 0.002)]
    slats = [block((-0.024, 0.154, z), (0.024, 0.1575, z + 0.006)) for z in np.arange(0.062, 0.135, 0.014)]
    skids = [block((-0.15, 0.05, -0.008), (0.15, 0.07, 0.004), 0.003)]
    plate = [block((-0.196, -0.138, 0.180), (0.196, 0.138, 0.1875), 0.003)]
    rails = [block((-0.180, y - 0.008, 0.186), (0.180, y + 0.008, 0.192), 0.0015) for y in (0.072, 0.112)]
    grooves = [block((-0.181, y - 0.0022, 0.188), (0.181, y + 0.0022, 0.1923)) for y in (0.072, 0.112)]
    holes = [moved(tube(0.0032, 0.1868, 0.1879, 8), x, y) for x in np.arange(-0.17, 0.171, 0.034) for y in (0.02, 0.05)]
    face = bent_plate(NOSE[1:], -0.082, 0.082, lift=0.0035, skin=0.005)
    bumper = [block((0.232, -0.150, 0.034), (0.257, 0.150, 0.064), 0.007)]
    tail = [block((-0.2595, -0.045, 0.086), (-0.252, 0.045, 0.126), 0.002)]  # the panel of sockets at the back
    gps = [moved(tube(0.026, 0.186, 0.203, 28, 0.004), -0.172, 0.0)]
    lamp = turned(tube(0.0115, 0.0, 0.006, 24, 0.0015), math.pi / 2 - 0.22, (0, 1, 0))
    lamps = [moved(lamp, 0.2535, y, 0.115) for y in (-0.055, 0.055)]
    bezel = turned(tube(0.0150, -0.001, 0.0035, 24, 0.001), math.pi / 2 - 0.22, (0, 1, 0))
    bezels = [moved(bezel, 0.2535, y, 0.115) for y in (-0.055, 0.055)]
    grille = [
        moved(block((0, -0.034, -0.0025), (0.005, 0.034, 0.0025), 0.001), 0.2565, 0, z) for z in (0.083, 0.093, 0.103)
    ]
    grille += [
        moved(block((0, -0.034, -0.0025), (0.005, 0.034, 0.0025), 0.001), x, 0, z)
        for x, z in ((0.2545, 0.113), (0.2525, 0.123))
    ]
    tails = [moved(turned(lamp, math.pi, (0, 0, 1)), -0.2535, y, 0.115) for y in (-0.065, 0.065)]
    return {
        "chassis_black": [body, *mirrored(skids, 1), *mirrored([*face, *bumper], 0), *gps],
        "chassis_grey": [*plate, *axles, *mirrored([*rails, *panel], 1), *tail, *bezels, *grille],
        "chassis_dark": mirrored([*grooves, *holes, *slats], 1),
        "chassis_yellow": fenders(),
        "chassis_lamp": lamps,
        "chassis_tail": tails,
    }


def _axles() -> tuple[float, float]:
    """x of the front and rear axle [m]."""
    return WHEELBASE / 2, -WHEELBASE / 2


def fenders() -> Pieces:
    """The yellow shells: a bonnet at each end, and from it a mudguard sweeping over each wheel; base_link."""
    bonnet = bent_plate(NOSE, -0.150, 0.150)
    roots = [*NOSE[:0:-1], (0.186, 0.183), (0.140, 0.179), (0.082, 0.168)]  # x, z at the body; the bonnet's line first
    sections = []
    for root, degrees in zip(roots, (12, 34, 54, 72, 88, 103, 118), strict=True):
        along = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        rim = np.array([WHEELBASE / 2, WHEEL_HEIGHT]) + (WHEEL_RADIUS + 0.018) * along  # close over the tyre
        hem = rim - 0.012 * along  # the guard's outer edge is turned down
        inside = np.array(root) - SKIN * along
        corners = [(*root, 0.149), (*inside, 0.149), (*rim, 0.212), (*(rim - SKIN * along), 0.206), (*hem, 0.215)]
        sections.append(np.array([(x, y, z) for x, z, y in corners]))
    return mirrored([*bonnet, *mirrored(loft(sections), 1)], 0)


def wheel() -> dict[str, Pieces]:
    """A chunky tyre with chevron lugs and a five-spoke rim; wheel frame, outer side +y."""
    half, tread = WHEEL_WIDTH / 2, WHEEL_RADIUS - 0.006
    carcass = [(0.060, -half + 0.003), (0.074, -half), (0.086, -half + 0.002), (tread, -half + 0.008)]
    profile = np.array([*carcass, *((r, -y) for r, y in reversed(carcass)), carcass[0]])
    tyre = along_y(trimesh.creation.revolve(profile, sections=48))
    lugs = []
    count = 22
    for k in range(count):
        for sign in (-1, 1):
            start = 2 * math.pi * (k + (0.25 if sign > 0 else -0.25)) / count
            points = []
            for y, shift, width in ((0.002, 0.085, 0.050), (0.0135, 0.0, 0.060), (half, -0.02, 0.060)):
                deep = tread - (0.010 if y == half else 0.003)
                top = WHEEL_RADIUS - (0.006 if y == half else 0.0)
                for r in (deep, top):
                    for edge in (-width, width):
                        t = start + shift + edge
                        points.append((r * math.cos(t), sign * y, r * math.sin(t)))
            lugs.append(hull(points))
    barrel = along_y(
        trimesh.creation.revolve(
            np.array([(0.052, -0.016), (0.062, -0.018), (0.062, 0.018), (0.054, 0.016), (0.052, -0.016)]), sections=48
        )
    )
    spokes = [turned(hull(_spoke()), 2 * math.pi * k / 5, (0, 1, 0)) for k in range(5)]
    disc = along_y(tube(0.056, -0.010, -0.004, 40))
    hub = along_y(tube(0.019, -0.012, 0.0165, 24, 0.003))
    bolts = [
        turned(moved(along_y(tube(0.0028, 0.010, 0.0185, 6)), 0.012), 2 * math.pi * k / 5, (0, 1, 0)) for k in range(5)
    ]
    return {"wheel_tyre": [tyre, *lugs], "wheel_rim": [barrel, *spokes, hub], "wheel_dark": [disc, *bolts]}


def _spoke() -> list[tuple[float, float, float]]:
    """Corners of one spoke, from hub to barrel along x."""
    return [
        (x, y, sign * w)
        for x, w, low, high in ((0.012, 0.0075, -0.006, 0.014), (0.056, 0.0110, -0.004, 0.0125))
        for y in (low, high)
        for sign in (-1, 1)
    ]


def ust10() -> dict[str, Pieces]:
    """Hokuyo UST-10, 50 x 50 x 70 mm, on a low plate; lidar frame."""
    foot = LIDAR_MOUNTS["ust10"].base - LIDAR_MOUNTS["ust10"].position[2]  # -0.0474
    plate = block((-0.040, -0.045, foot - 0.010), (0.040, 0.045, foot), 0.002)
    body = block((-0.025, -0.025, foot), (0.025, 0.025, -0.012), 0.004)
    collar = tube(0.0245, -0.014, -0.008, 36, 0.001)
    cap = hull([*tube(0.0235, 0.010, 0.017, 36).vertices, *tube(0.019, 0.017, 0.0226, 36).vertices])
    return {
        "ust10_grey": [plate],
        "ust10_black": [body, cap],
        "ust10_window": [tube(0.0222, -0.010, 0.012, 36)],
        "ust10_accent": [collar],
    }


def lms1xx() -> dict[str, Pieces]:
    """SICK LMS1xx, about 105 x 102 x 152 mm, on its bracket; lidar frame."""
    foot = LIDAR_MOUNTS["lms1xx"].base - LIDAR_MOUNTS["lms1xx"].position[2]  # -0.149
    base = block((-0.055, -0.060, foot), (0.055, 0.060, foot + 0.006), 0.002)
    cheeks = mirrored(
        [
            hull(
                [
                    (x, y, z)
                    for y in (0.053, 0.058)
                    for x, z in ((-0.045, foot), (0.045, foot), (0.030, foot + 0.095), (-0.035, foot + 0.095))
                ]
            )
        ],
        1,
    )
    body = block((-0.051, -0.0525, foot + 0.012), (0.051, 0.0525, -0.030), 0.008)
    head = hull(
        [*tube(0.046, -0.034, -0.024, 40).vertices, *block((-0.049, -0.046, -0.034), (-0.01, 0.046, -0.024)).vertices]
    )
    window = tube(0.041, -0.028, 0.022, 40)
    back = block((-0.048, -0.040, -0.030), (-0.018, 0.040, 0.022), 0.004)
    cap = hull(
        [
            *tube(0.046, 0.020, 0.030, 40).vertices,
            *tube(0.040, 0.030, 0.036, 40).vertices,
            *block((-0.049, -0.044, 0.020), (-0.01, 0.044, 0.032)).vertices,
        ]
    )
    return {
        "lms1xx_grey": [base, *cheeks],
        "lms1xx_blue": [body, head, back, cap],
        "lms1xx_window": [window],
    }


def make_meshes(folder: Path = HERE) -> list[Path]:
    """Write every mesh; returns the files."""
    files = []
    for name, pieces in {**chassis(), **wheel(), **ust10(), **lms1xx()}.items():
        mesh = trimesh.util.concatenate(pieces)
        mesh.update_faces(mesh.nondegenerate_faces())
        path = folder / f"{name}.stl"
        path.write_bytes(trimesh.exchange.stl.export_stl(mesh))
        files.append(path)
    return files


def jackal_xml() -> str:
    """The robot with its free joint, standing on z = 0, as MJCF that loads from this folder."""
    root = build_jackal()
    chassis = root.find("body", "chassis")
    chassis.pos = (0, 0, RIDE_HEIGHT)
    chassis.add("freejoint", name="base")
    note = "<!-- Written by `python -m twin.assets.make_meshes` from twin/robot/jackal.py; edit that. -->\n"
    return note + str(root.to_xml_string(precision=9, filename_with_hash=False))


if __name__ == "__main__":
    for file in make_meshes():
        print(f"{file.name:24s} {file.stat().st_size / 1024:6.1f} kB")
    (HERE / "jackal.xml").write_text(jackal_xml(), encoding="utf-8")
