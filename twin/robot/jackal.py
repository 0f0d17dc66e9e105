"""The Clearpath Jackal: its published constants and the PyMJCF model built from them.

Frames are ROS's: `base_link` is the body `chassis`; x forward, y left, z up, metres, kilograms, radians. Sources are
named per line: `urdf` = jackal_description/urdf/jackal.urdf.xacro and `ust10` = accessories/hokuyo_ust10.urdf.xacro of
github.com/jackal/jackal (BSD-3); `ours` = chosen and measured here (tests/robot/test_driving.py holds the figures).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from twin.robot.pymjcf import mjcf

MASS: Final = 16.523  # [kg] chassis without wheels; urdf
CENTRE_OF_MASS: Final = (0.012, 0.002, 0.067)  # [m] base_link; urdf
INERTIA: Final = (0.3136, 0.3922, 0.4485, -0.0008, 0.0164, -0.0009)  # [kg m2] xx yy zz xy xz yz at the com; urdf
CHASSIS_SIZE: Final = (0.420, 0.310, 0.184)  # [m] length, width, height; its bottom is base_link's z = 0; urdf

WHEEL_RADIUS: Final = 0.098  # [m]; urdf
WHEEL_WIDTH: Final = 0.040  # [m]; urdf
WHEEL_MASS: Final = 0.477  # [kg]; urdf
WHEEL_INERTIA: Final = (0.0013, 0.0024, 0.0013)  # [kg m2] xx, yy (spin), zz; urdf
WHEELBASE: Final = 0.262  # [m]; urdf
TRACK: Final = 0.37559  # [m]; urdf
WHEEL_HEIGHT: Final = 0.0345  # [m] wheel centre above base_link; urdf
RIDE_HEIGHT: Final = WHEEL_RADIUS - WHEEL_HEIGHT  # [m] base_link above the floor: 0.0635

IMU_MASS: Final = 0.001  # [kg]; urdf

FRICTION: Final = 0.5  # wheel on floor, isotropic: mu1 = mu2; urdf
ARMATURE: Final = 0.1  # [kg m2] geared-motor inertia at the wheel; ours: with 0 the skid turn is 59 % too slow
SERVO_GAIN: Final = (
    30.0  # [N m s/rad] wheel-speed servo; ours: the urdf gives a velocity interface without effort limit
)

WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right")  # the order of every array over wheels
WHEEL_CENTRES: Final = tuple(
    (x * WHEELBASE / 2, y * TRACK / 2, WHEEL_HEIGHT) for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1))
)  # [m] base_link; urdf

OBSTACLE_GROUP: Final = 0  # geom group: floor and obstacles, the only one a scan sees
DECORATION_GROUP: Final = 1  # goal marker and other things that are only drawn
VISUAL_GROUP: Final = 2  # the robot's meshes, drawn
COLLISION_GROUP: Final = 3  # collision shapes, not drawn by default

# Only robot against world collides: a pair meets when one's contype shares a bit with the other's conaffinity. So the
# robot never touches itself (urdf: selfCollide false), and obstacles never cost a pair test among themselves.
ROBOT_CONTACT: Final = {"contype": 1, "conaffinity": 0}
WORLD_CONTACT: Final = {"contype": 0, "conaffinity": 1}
NO_CONTACT: Final = {"contype": 0, "conaffinity": 0}


@dataclass(frozen=True, slots=True)
class LidarMount:
    """Where a lidar sits and what it weighs."""

    position: tuple[float, float, float]  # [m] focal point in base_link
    base: float  # [m] foot of the bracket above base_link
    mass: float  # [kg]
    size: tuple[float, float, float]  # [m] the box of its published inertia


_LIDAR_BOX: Final = (0.105, 0.102, 0.152)  # [m]; ust10 and sick_lms1xx.urdf.xacro use the same 1.1 kg box
LIDAR_MOUNTS: Final = {
    # front mount (0.120, 0, 0.184) + JACKAL_LASER_OFFSET (-0.065, 0, 0.01) of BARN's run.py + 0.0474 to the focal
    # point; ust10
    "ust10": LidarMount((0.055, 0.0, 0.2414), base=0.194, mass=1.1, size=_LIDAR_BOX),
    # front mount + 0.149 to the focal point; accessories/sick_lms1xx_mount.urdf.xacro
    "lms1xx": LidarMount((0.120, 0.0, 0.333), base=0.184, mass=1.1, size=_LIDAR_BOX),
}


ASSETS: Final = Path(__file__).parents[1] / "assets"  # meshes by twin/assets/make_meshes.py, for the eye only
COLOURS: Final[dict[str, dict[str, Any]]] = {  # material by the last word of a mesh's name
    "black": {"rgba": (0.105, 0.105, 0.115, 1), "specular": 0.35, "shininess": 0.45},
    "grey": {"rgba": (0.23, 0.235, 0.25, 1), "specular": 0.5, "shininess": 0.5},
    "dark": {"rgba": (0.03, 0.03, 0.035, 1), "specular": 0.1, "shininess": 0.1},
    "yellow": {"rgba": (0.98, 0.73, 0.05, 1), "specular": 0.4, "shininess": 0.6},
    "tyre": {"rgba": (0.06, 0.06, 0.062, 1), "specular": 0.08, "shininess": 0.1},
    "rim": {"rgba": (0.36, 0.37, 0.39, 1), "specular": 0.6, "shininess": 0.6},
    "lamp": {"rgba": (0.96, 0.97, 1.0, 1), "emission": 0.45},
    "tail": {"rgba": (0.85, 0.08, 0.07, 1), "emission": 0.4},
    "window": {"rgba": (0.02, 0.02, 0.03, 1), "specular": 1.0, "shininess": 0.9},
    "accent": {"rgba": (0.95, 0.45, 0.08, 1), "specular": 0.4, "shininess": 0.5},
    "blue": {"rgba": (0.12, 0.30, 0.60, 1), "specular": 0.4, "shininess": 0.5},
}


def build_jackal(lidar_mount: str = "ust10") -> mjcf.RootElement:
    """The robot as a PyMJCF model named `jackal`; the arena attaches it and gives the frame its free joint."""
    if lidar_mount not in LIDAR_MOUNTS:
        raise ValueError(f"unknown lidar mount {lidar_mount!r}: use one of {', '.join(LIDAR_MOUNTS)}")
    root = mjcf.RootElement(model="jackal")
    root.compiler.angle = "radian"
    root.compiler.autolimits = True
    # Elliptic cones: yaw jitter 0.02 rad/s, against 0.21 with pyramids. implicitfast keeps the stiff servo stable.
    root.option.cone = "elliptic"
    root.option.integrator = "implicitfast"
    root.option.tolerance = 1e-4  # of the contact solver; 1e-8 drives the same and costs a tenth more

    chassis = root.worldbody.add("body", name="chassis")
    chassis.add("inertial", mass=MASS, pos=CENTRE_OF_MASS, fullinertia=INERTIA)
    length, width, height = CHASSIS_SIZE
    chassis.add(
        "geom",
        name="chassis",
        type="box",
        size=(length / 2, width / 2, height / 2),
        pos=(0, 0, height / 2),
        group=COLLISION_GROUP,
        rgba=(0.2, 0.4, 0.9, 0.5),
        **ROBOT_CONTACT,
    )
    imu = chassis.add("body", name="imu")  # at base_link; urdf
    imu.add("inertial", mass=IMU_MASS, pos=(0, 0, 0), diaginertia=(1e-9, 1e-9, 1e-9))
    imu.add("site", name="imu", size=(0.01,))
    root.sensor.add("gyro", name="gyro", site="imu")
    _dress(root, chassis, "chassis")
    # The sun travels with the robot, without turning, so that the shadow map can be small and sharp.
    chassis.add(
        "light",
        name="sun",
        type="directional",
        mode="track",
        pos=(0.9, 1.2, 3),
        dir=(-0.30, -0.40, -1),
        diffuse=(0.72, 0.70, 0.64),
        specular=(0.25, 0.25, 0.25),
    )
    for name, centre in zip(WHEELS, WHEEL_CENTRES, strict=True):
        _add_wheel(root, chassis, name, centre)
    lidar = _add_lidar(chassis, LIDAR_MOUNTS[lidar_mount])
    _dress(root, lidar, lidar_mount)
    return root


def _add_wheel(root: Any, chassis: Any, name: str, centre: tuple[float, float, float]) -> None:
    """A wheel turning about y, and the servo that holds its speed [rad/s]."""
    wheel = chassis.add("body", name=f"{name}_wheel", pos=centre)
    wheel.add("inertial", mass=WHEEL_MASS, pos=(0, 0, 0), diaginertia=WHEEL_INERTIA)
    joint = wheel.add("joint", name=f"{name}_wheel", type="hinge", axis=(0, 1, 0), armature=ARMATURE)
    wheel.add(
        "geom",
        name=f"{name}_wheel",
        type="cylinder",
        size=(WHEEL_RADIUS, WHEEL_WIDTH / 2),
        quat=(math.sqrt(0.5), math.sqrt(0.5), 0, 0),  # the cylinder's z axis along y
        friction=(FRICTION, 0.005, 0.0001),
        priority=1,  # MuJoCo takes the larger friction of a pair; priority makes the wheel's 0.5 hold on any ground
        condim=3,
        group=COLLISION_GROUP,
        rgba=(0.9, 0.4, 0.2, 0.5),
        **ROBOT_CONTACT,
    )
    root.actuator.add("velocity", name=f"{name}_wheel", joint=joint, kv=SERVO_GAIN)
    _dress(root, wheel, "wheel", quat=(1, 0, 0, 0) if centre[1] > 0 else (0, 0, 0, 1))  # the outer side outside


def _add_lidar(chassis: Any, mount: LidarMount) -> Any:
    """The lidar as a weight on the chassis; like the URDF's it collides with nothing."""
    x, y, z = mount.size
    inertia = tuple(mount.mass / 12 * s for s in (y * y + z * z, x * x + z * z, x * x + y * y))
    lidar = chassis.add("body", name="lidar", pos=mount.position)
    lidar.add("inertial", mass=mount.mass, pos=(0, 0, 0), diaginertia=inertia)
    lidar.add("site", name="lidar", size=(0.01,))
    return lidar


def _dress(root: Any, body: Any, part: str, **place: Any) -> None:
    """Hang the meshes `<part>_<colour>.stl` on a body."""
    for colour, look in COLOURS.items():
        path = ASSETS / f"{part}_{colour}.stl"
        if not path.exists():
            continue
        material = root.find("material", colour) or root.asset.add("material", name=colour, **look)
        mesh = root.find("mesh", path.stem) or root.asset.add("mesh", name=path.stem, file=str(path), inertia="shell")
        body.add(
            "geom",
            name=f"{body.name}_{colour}",
            type="mesh",
            mesh=mesh,
            material=material,
            group=VISUAL_GROUP,
            **NO_CONTACT,
            **place,
        )
