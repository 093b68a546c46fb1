"""A log as ROS messages, on the topics that OpenNI drivers use."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vlmm_log import se3
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.images import ImageError
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.stored import Shot
from vlmm_log.ros.mcap import Publication
from vlmm_log.ros.messages import CAMERA_INFO, END_NS, NUMBER, TRANSFORMS, Placed, Ros
from vlmm_log.types import Float64, Skipped
from vlmm_log.writers.chain import Chain, Pose
from vlmm_log.writers.depth import MILLIMETRES
from vlmm_log.writers.recorders import Recorder
from vlmm_log.writers.ros_images import Built, encoded_depth, encoded_rgb, raw_depth, raw_rgb

Images = Literal["raw", "compressed"]
RGB_FRAME, DEPTH_FRAME = "camera_rgb_optical_frame", "camera_depth_optical_frame"
RGB, REGISTERED, DEPTH = "/camera/rgb", "/camera/depth_registered", "/camera/depth"
TF, TF_STATIC = Publication("/tf", TRANSFORMS), Publication("/tf_static", TRANSFORMS, latched=True)


@dataclass
class RosLog:
    """Writes one event of a log after another. Stamps of headers and of the container are the log's, to the ns."""

    ros: Ros
    recorder: Recorder
    images: Images
    camera: Intrinsics
    depth_camera: tuple[Intrinsics, Float64] | None  # see stored.StoredLog
    units_per_meter: float
    depth_shift: tuple[int, int]  # px
    chain: Chain | None
    counts: Counter[str] = field(default_factory=Counter)  # messages of each topic
    notes: list[str] = field(default_factory=list)

    def write(self, event: Shot | Pose) -> Skipped | None:
        """Write one; or why it cannot be."""
        what = event.what if isinstance(event, Shot) else "pose"
        if not 0 <= event.stamp_ns < END_NS:
            return Skipped(event.stamp_ns, what, "stamp is beyond what ROS can hold, 1970 to 2038")
        if not self.counts:
            self._begin(event.stamp_ns)
        if isinstance(event, Pose):
            self._write_pose(event)
            return None
        try:
            written = self._built(event)
        except ImageError as e:
            return Skipped(event.stamp_ns, what, str(e), event.index if event.kind == "rgb" else None)
        self._write_image(event, written)
        return None

    def _begin(self, stamp_ns: int) -> None:
        """What holds for the whole log, before its first message: transforms that are still."""
        placed = self._still()
        if placed:
            self._send(TF_STATIC, stamp_ns, self.ros.transforms(stamp_ns, 0, placed))

    def _write_pose(self, pose: Pose) -> None:
        parent, child = self._frames[pose.link : pose.link + 2]
        placed = Placed(parent, child, pose.position, pose.quaternion)
        self._send(TF, pose.stamp_ns, self.ros.transforms(pose.stamp_ns, self.counts[TF.topic], [placed]))

    def _still(self) -> list[Placed]:
        placed = []
        for k, link in () if self.chain is None else self.chain.still():
            T = link.at(0, 0, Convention())
            assert T is not None
            parent, child = self._frames[k : k + 2]
            placed.append(_placed(parent, child, T))
        if self.depth_camera is not None:
            placed.append(_placed(RGB_FRAME, DEPTH_FRAME, self.depth_camera[1]))
        return placed

    @property
    def _frames(self) -> list[str]:
        """Names of the frames along the chain. Optical worlds, y down, are called so."""
        assert self.chain is not None
        world = "world_optical" if self.chain.up == "-y" else "world"
        return [world, *(f"link_{k}" for k in range(1, len(self.chain.links))), RGB_FRAME]

    def _built(self, shot: Shot) -> Built:
        image = shot.load()
        if shot.kind == "rgb":
            return raw_rgb(image) if self.images == "raw" else encoded_rgb(image)
        if self.images == "raw":
            return raw_depth(image, self.units_per_meter, self.depth_shift)
        built = encoded_depth(image, self.units_per_meter, self.depth_shift)
        if not built.suffix:
            self._note("depth in float is written raw: compressedDepth would round it")
        return built

    def _write_image(self, shot: Shot, image: Built) -> None:
        stamp_ns = shot.stamp_ns
        camera, frame, place = self._seat(shot)
        to = Publication(f"{place}/image_raw{image.suffix}", image.type)
        info = Publication(f"{place}/camera_info", CAMERA_INFO)
        integers = image.suffix == "/compressedDepth" and image.form.startswith(("16UC1", "mono16"))
        if integers and self.units_per_meter != MILLIMETRES and not self.counts[to.topic]:
            self._write_units(stamp_ns, f"{place}/image_raw/units_per_meter")
        header = self.ros.header(stamp_ns, frame, self.counts[to.topic])
        if isinstance(image.content, np.ndarray):
            data = self.ros.image(header, image.form, image.content)
        else:
            data = self.ros.compressed_image(header, image.form, image.content)
        of_info = self.ros.header(stamp_ns, frame, self.counts[info.topic])
        self._send(info, stamp_ns, self._camera_info(of_info, camera, image.size))
        self._send(to, stamp_ns, data)

    def _camera_info(self, header: Any, camera: Intrinsics, size: tuple[int, int]) -> bytes:
        known = (camera.height, camera.width) if camera.height else size
        return self.ros.camera_info(header, camera.K, known, camera.distortion, camera.model)

    def _seat(self, shot: Shot) -> tuple[Intrinsics, str, str]:
        """Camera, frame and namespace of an image."""
        if shot.kind == "rgb":
            return self.camera, RGB_FRAME, RGB
        if self.depth_camera is None:
            return self.camera, RGB_FRAME, REGISTERED
        return self.depth_camera[0], DEPTH_FRAME, DEPTH

    def _write_units(self, stamp_ns: int, topic: str) -> None:
        self._send(Publication(topic, NUMBER, latched=True), stamp_ns, self.ros.number(self.units_per_meter))
        unit = f"{self.units_per_meter:g} per metre, as {topic} says"
        self._note(f"compressedDepth holds {unit}; other tools will take it for mm")

    def _send(self, to: Publication, stamp_ns: int, data: bytes) -> None:
        self.recorder.write(to, stamp_ns, data)
        self.counts[to.topic] += 1

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _placed(parent: str, child: str, T: Float64) -> Placed:
    return Placed(parent, child, T[:3, 3], se3.quaternion(T))
