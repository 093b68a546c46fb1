"""A video of pictures. OpenCV's encoder tells no error, so that the file is read again."""

from __future__ import annotations

from pathlib import Path

import cv2

from vlmm_log.types import UInt8

CODEC = "mp4v"  # MPEG-4 part 2: the one that OpenCV's wheels bring along for .mp4


class Video:
    """Takes pictures of one size as they come. ``finish`` makes the file whole."""

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        """A file that is called .mp4, of a width and height px. Raises OSError where it cannot be opened."""
        self._path, self._frames = path, 0
        self._writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*CODEC), fps, size)
        if not self._writer.isOpened():
            raise OSError(f"OpenCV opens no {CODEC} video of {size[0]} x {size[1]} px there")

    def add(self, picture: UInt8) -> None:
        """The next frame, (H, W, 3) BGR."""
        self._writer.write(picture)
        self._frames += 1

    def finish(self) -> None:
        """Close it. Raises OSError where it does not give back as many frames."""
        self.close()
        found = decoded_frames(self._path)
        if found != self._frames:
            raise OSError(f"of {self._frames} frames {found} can be read again, is the disk full?")

    def close(self) -> None:
        """Let go of the file, whole or not."""
        self._writer.release()


def decoded_frames(path: Path) -> int:
    """How many frames can be decoded."""
    video, count = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG), 0
    while video.grab():
        count += 1
    video.release()
    return count
