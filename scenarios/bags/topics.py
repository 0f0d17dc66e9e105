"""Which topic of a bag plays which part: the one that was asked for, the one usual on a Jackal, or the only one."""

from __future__ import annotations

from dataclasses import dataclass

from scenarios.bags.files import BagError, BagReader


@dataclass(frozen=True, slots=True)
class Part:
    """A part to be played by a topic."""

    option: str  # on the command line
    what: str
    types: tuple[str, ...]
    usual: tuple[str, ...]  # names, the likeliest first; a namespace in front of them does not matter


SCAN = Part(
    "--scan",
    "lidar",
    ("sensor_msgs/msg/LaserScan",),
    ("/scan", "/front/scan", "/sensors/lidar2d_0/scan"),  # the twin, Jackal under ROS 1, under ROS 2
)
ODOMETRY = Part(
    "--odom",
    "odometry",
    ("nav_msgs/msg/Odometry",),
    ("/odometry", "/odometry/filtered", "/platform/odom/filtered", "/odom"),
)
CMD_VEL = Part(
    "--cmd-vel",
    "commands",
    ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    # what reaches the base comes before what one of several sources asks for
    ("/jackal_velocity_controller/cmd_vel", "/platform/cmd_vel", "/cmd_vel"),
)
GOAL = Part(
    "--goal",
    "goal",
    ("geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path"),
    ("/goal", "/move_base/current_goal", "/goal_pose", "/move_base_simple/goal", "/plan", "/move_base/NavfnROS/plan"),
)
MARKER = Part("--marker", "marker", ("std_msgs/msg/String", "std_msgs/msg/Bool"), ())


def find_topic(bag: BagReader, part: Part, wanted: str | None) -> str:
    """The name of the topic. Raises BagError, with what there is, when there is none or more than one."""
    if wanted is not None:
        name = "/" + wanted.strip("/")
        if name not in bag.topics and wanted in bag.topics:
            name = wanted
        if name not in bag.topics:
            raise BagError(f"{bag.path}: no topic {name}; it has {listing(bag)}")
        if bag.topics[name] not in part.types:
            raise BagError(
                f"{bag.path}: {name} holds {_short(bag.topics[name])}; {part.option} takes {_types(part)}; "
                f"it has {listing(bag)}"
            )
        if name in bag.silent:
            raise BagError(f"{bag.path}: {name} never says anything; it has {listing(bag)}")
        return name
    fitting = [n for n, type_name in sorted(bag.topics.items()) if type_name in part.types and n not in bag.silent]
    if not fitting:
        raise BagError(f"{bag.path}: no {part.what} ({_types(part)}); it has {listing(bag)}")
    for usual in part.usual:
        if usual in fitting:
            return usual
        if len(namespaced := [name for name in fitting if name.endswith(usual)]) == 1:
            return namespaced[0]
    if len(fitting) > 1:
        raise BagError(f"{bag.path}: which is the {part.what}? Say {part.option} and one of {', '.join(fitting)}")
    return fitting[0]


def listing(bag: BagReader) -> str:
    """All topics with their types."""
    return ", ".join(
        f"{name} ({_short(type_name)}{', silent' if name in bag.silent else ''})"
        for name, type_name in sorted(bag.topics.items())
    )


def _short(type_name: str) -> str:
    return type_name.replace("/msg/", "/")


def _types(part: Part) -> str:
    return " or ".join(_short(t) for t in part.types)
