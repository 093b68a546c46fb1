"""Where the camera of a bag stood: transforms, odometry, poses and paths as a chain of links."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vlmm_log.readers.bag.containers import Container, Message, MessageError
from vlmm_log.readers.bag.messages import TRANSFORMS, UNREADABLE, Placed, poses_of, transforms_of
from vlmm_log.readers.bag.ranking import TF
from vlmm_log.readers.bag.topics import Choice
from vlmm_log.readers.bag.transforms import Edge, Tree
from vlmm_log.readers.conventions import PLAIN, Convention
from vlmm_log.readers.poses import ELSEWHERE, Link, Poses, Trajectory, usable_pose
from vlmm_log.types import InputError, Skipped

WORLDS = ("world", "map", "odom", "earth")  # REP 105, and what trackers call theirs


def read_tree(container: Container, start_ns: int, stop_ns: int, left_out: list[Skipped]) -> Tree:
    """The tree of frames: /tf_static of the whole log, /tf of a window of log time. It holds what it refused."""
    tree = Tree()
    names = [t.name for t in container.topics if t.type in TRANSFORMS]
    still = [name for name in names if name.rsplit("/", 1)[-1] == "tf_static"]
    for placed in _placed(container, still, container.start_ns, container.stop_ns, left_out):
        tree.add_still(placed)
    moving = [name for name in names if name not in still]
    for placed in _placed(container, moving, start_ns, stop_ns, left_out):
        tree.add(placed)
    return tree


def refusals(tree: Tree, choice: Choice, start_ns: int) -> list[Skipped]:
    """What a complete tree refused: a loss of poses where a frame carries the camera's or the world's."""
    ends = choice.rgb.frame, _asked_world(choice)
    carrying = {name for frame in ends if frame for name in tree.ancestors(frame)}
    told: list[Skipped] = []
    for (child, reason), count in sorted(tree.refused.items()):
        told += [Skipped(start_ns, "/tf", reason if child in carrying else f"{ELSEWHERE}: {reason}")] * count
    return told


def read_poses(
    container: Container, choice: Choice, tree: Tree, window: tuple[int, int], left_out: list[Skipped], notes: list[str]
) -> Poses | None:
    """The poses of the chosen source over a window of log time; None where there are none."""
    frame = choice.rgb.frame
    if choice.pose.split(":")[0] == TF:
        return _of_tree(container, tree, frame, _asked_world(choice))
    if not choice.pose:
        return None
    return _of_topic(container, choice.pose, tree, frame, window, left_out, notes)


def _of_tree(container: Container, tree: Tree, frame: str, world: str) -> Poses | None:
    root = world or tree.ancestors(frame)[-1]
    links = tree.chain(root, frame)
    if not links and not world:
        return None  # the tree does not know the camera
    if not links:
        raise InputError(f"{container.path}: no transforms join {root!r} and the camera's frame {frame!r}")
    if not any(isinstance(link.motion, Trajectory) for link in links):
        if root not in WORLDS and not world:
            return None  # a robot's own still frames say nothing of where the camera went
        links = tree.chain(root, frame, Edge.trajectory) or ()  # it stood still, for as long as that was said
    path = tree.ancestors(frame)
    named = path[: path.index(root) + 1][::-1] if root in path else [root, "...", frame]
    return _carried(links, f"tf, {' -> '.join(named)}", _up(root))


def _asked_world(choice: Choice) -> str:
    """The frame of ``tf:FRAME``; "" where none was asked for."""
    source, _, world = choice.pose.partition(":")
    return world.lstrip("/") if source == TF else ""


def _of_topic(
    container: Container,
    topic: str,
    tree: Tree,
    frame: str,
    window: tuple[int, int],
    left_out: list[Skipped],
    notes: list[str],
) -> Poses | None:
    edge, last = Edge(), None
    listed = {t.name: t for t in container.topics}[topic]
    if listed.type == "nav_msgs/msg/Path":  # each message holds the whole way so far: the last one is the best
        window = _of_last(container, topic)
    for placed in _placed(container, [topic], *window, left_out):
        reason = usable_pose(placed.values)
        if reason:
            left_out.append(Skipped(placed.stamp_ns, topic, reason))
            continue
        edge.add(placed)
        last = placed
    if last is None:
        return None
    links = [Link(edge.trajectory())]
    if last.child and last.child != frame:
        rest = tree.chain(last.child, frame)
        if rest is None:
            notes.append(f"no transform from {last.child} to {frame}: poses of {topic} are taken as the camera's own")
        links += rest or ()
    elif not last.child:
        notes.append(f"{topic} does not name what it tracks: taken as the camera's own optical frame")
    return _carried(tuple(links), topic, _up(last.parent))


def _carried(links: tuple[Link, ...], source: str, up: str) -> Poses:
    """What is still behind the last link that moves is how the camera is mounted: no pose that is listed."""
    *listed, last = _merged(links)
    if isinstance(last.motion, Trajectory) or not listed:
        return Poses((*listed, last), source, up=up)
    return Poses(tuple(listed), source, Convention(to_camera=last.at(0, 0, PLAIN)), up)


def _of_last(container: Container, topic: str) -> tuple[int, int]:
    """A window of log time that holds a topic's last message."""
    times = container.log_times(topic)
    if times is None:
        for message in container.messages([topic], container.start_ns, container.stop_ns):
            if isinstance(message, Message):
                times = np.array([message.log_ns], np.int64)
    last = int(times[-1]) if times is not None and times.size else container.start_ns
    return last, last + 1


def _placed(
    container: Container, topics: list[str], start_ns: int, stop_ns: int, left_out: list[Skipped]
) -> Iterator[Placed]:
    if not topics:
        return
    known = {(x.what, x.reason) for x in left_out}  # a damaged chunk is met by every topic
    for message in container.messages(topics, start_ns, stop_ns):
        if isinstance(message, Skipped):
            if (message.what, message.reason) not in known:
                left_out.append(message)
                known.add((message.what, message.reason))
            continue
        try:
            content = message.decode()
            yield from transforms_of(content) if message.topic.type in TRANSFORMS else poses_of(content)
        except (MessageError, *UNREADABLE) as e:
            reason = str(e) if isinstance(e, MessageError) else "message lacks a field"
            left_out.append(Skipped(message.log_ns, f"{message.topic.name} {message.ordinal}", reason))


def _merged(links: tuple[Link, ...]) -> tuple[Link, ...]:
    """The same chain with neighbouring still links multiplied."""
    out: list[Link] = []
    for link in links:
        if out and not isinstance(link.motion, Trajectory) and not isinstance(out[-1].motion, Trajectory):
            product = [x.at(0, 0, PLAIN) for x in (out.pop(), link)]
            assert product[0] is not None
            assert product[1] is not None
            link = Link(product[0] @ product[1])
        out.append(link)
    return tuple(out)


def _up(world: str) -> str:
    """REP 103: z points up, but in an optical frame, where y points down."""
    return "-y" if "optical" in world else "+z"
