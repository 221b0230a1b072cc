"""AVI, Matroska and MP4 through PyAV, at the depth of the stream (never through 8-bit RGB).

The file is walked once without decoding: every packet's place, key flag and time make the index, so the number of
frames does not depend on what the header states. Frames are then decoded forwards, and only a step back seeks. A
decoded frame is matched to its packet, not to its time stamp: Matroska rounds times to 1 ms, too coarse for a fast
playback rate.
"""

import contextlib
import math
import re
import zlib
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from av.codec.context import Flags, ThreadType
from av.container import InputContainer
from av.error import FFmpegError
from numpy.typing import NDArray

from pipeline.errors import InputError
from pipeline.ingest.clip import HELD_LUMA, MAX_FRAMES, Clip, Pixels, as_pixels, check_size, count_frames, frame_error

MAX_REORDER = 16
"""Most packets that a decoder holds back before it gives a frame out (ITU-T H.264: the picture buffer)."""

PLANAR_YUV = re.compile(r"yuvj?4\d\dp(9le|1[0246]le)?")
GRAY = re.compile(r"gray(9le|1[0246]le)?")
RGB = {"rgb24", "bgr24", "bgr0", "rgb0", "0rgb", "0bgr", "gbrp"}

MIRRORED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Every byte with its bits in reverse order."""


class ContainerFrames:
    """Frames of the first video stream, decoded when asked for; memory does not grow with the clip."""

    def __init__(self, path: Path):
        self._path = path
        self._open()
        self._index()
        self._rewind(0)

    def __len__(self) -> int:
        return self.count

    def frame(self, index: int) -> Pixels:
        """Frame `index` as stored (`Clip.frames`), rows top-down; `InputError` if it is missing or damaged."""
        if index >= len(self._packet_of):
            raise frame_error(self._path, index, f"missing: the file ends after {len(self._packet_of)} frames")
        packet = int(self._packet_of[index])
        key = int(self._key_of[packet])
        if index not in self._ready:
            if index <= self._newest or (self._empty and key < self._next):
                self._rewind(key)
            elif key > self._next:
                self._skip(key)
        while index not in self._ready and packet not in self._lost:
            if self._next > packet + self._reorder or not self._feed():
                self._drain()
                break
        if index not in self._ready:
            self._lost.add(packet)
            raise frame_error(self._path, index, "damaged, or it needs a damaged frame before it")
        self._ready = {i: frame for i, frame in self._ready.items() if i >= index}
        return _pixels(self._ready[index], f"{self._path}: frame {index}")

    def _open(self) -> None:
        try:
            self._container: InputContainer = av.open(str(self._path))
        except (FFmpegError, ValueError) as error:
            raise InputError(self._path, f"not a readable video ({error})", "copy or export the clip again") from error
        if not self._container.streams.video:
            raise InputError(self._path, "no video stream", "give the file that holds the frames")
        self.stream = self._container.streams.video[0]
        # Typed as always there, but None where FFmpeg does not know the codec.
        if not getattr(self.stream, "codec_context", None):
            raise InputError(self._path, "an unknown codec", "export as FFV1 in gray, gray10le, gray12le or gray16le")
        check_size(self.stream.height, self.stream.width, self._path)
        # Slices, not frames, in parallel: nothing is held back, and an error belongs to the packet just given.
        self.stream.thread_type = ThreadType.SLICE
        self.stream.codec_context.flags |= Flags.copy_opaque

    def _index(self) -> None:
        positions, times, keys = [], [], []
        for packet in _packets(self._container, self.stream.index):
            positions.append(-1 if packet.pos is None else packet.pos)
            times.append(-1 if packet.pts is None else packet.pts)
            keys.append(packet.is_keyframe)
            if len(keys) > MAX_FRAMES:
                raise InputError(self._path, f"more than {MAX_FRAMES} frames", "cut the clip into shorter ones")
        if not keys:
            raise InputError(self._path, "no frame in the video stream", "copy or export the clip again")
        n = len(keys)
        # Only a codec with frames between keys can store them in another order than shown.
        order = np.arange(n) if all(keys) or min(times) < 0 else np.argsort(np.array(times), kind="stable")
        codec = self.stream.codec_context.name
        if codec != "h264" and np.any(np.diff(order) < 0):
            # FFmpeg's other decoders do not carry a packet's number through reordering reliably.
            raise InputError(self._path, f"{codec} frames stored out of order", "export as FFV1 (or H.264)")
        self._positions = np.array(positions)
        self._packet_of: NDArray[np.intp] = order
        self._frame_of = np.empty(n, np.intp)
        self._frame_of[order] = np.arange(n)
        # The first packet counts as a key even if it is not marked as one: decoding can start nowhere earlier.
        self._key_of = np.maximum.accumulate(np.where(keys, np.arange(n), 0))
        self._times = np.array(times)
        self._reorder = 0 if all(keys) else MAX_REORDER
        self.count = count_frames(n, self._promised())
        self._checksums: bool | None = None
        self._lost: set[int] = set()

    def _promised(self) -> int:
        """Frames that the header states at least. Matroska has only a duration, rounded to its clock of 1 ms."""
        if self.stream.frames:
            return self.stream.frames
        if not self._container.duration or not self.stream.average_rate:
            return 0
        return math.ceil((self._container.duration / av.time_base - 0.002) * float(self.stream.average_rate))

    def _rewind(self, key: int) -> None:
        """Make packet `key` the next to be read."""
        time = int(self._times[key])
        if key and time >= 0:
            try:
                self._container.seek(time, stream=self.stream)
                self._demuxed = _packets(self._container, self.stream.index)
                first = next(self._demuxed, None)
            except FFmpegError:
                first = None
            found = np.flatnonzero(self._positions == first.pos) if first is not None else []
            if first is not None and len(found) == 1 and found[0] <= key:
                self._next, self._pushed_back = int(found[0]), first
                self._forget()
                self._skip(key)
                return
        self._container.close()
        self._open()
        self._demuxed = _packets(self._container, self.stream.index)
        self._next, self._pushed_back = 0, None
        self._forget()
        self._skip(key)

    def _skip(self, key: int) -> None:
        """Read up to packet `key` without decoding."""
        while self._next < key and self._read() is not None:
            pass
        self._forget()

    def _forget(self) -> None:
        """Start decoding afresh: the next packet given must be a key."""
        if self.stream.codec_context.is_open:
            self.stream.codec_context.flush_buffers()
        self._ready: dict[int, av.VideoFrame] = {}
        self._newest = -1
        self._empty = True

    def _read(self) -> av.Packet | None:
        packet, self._pushed_back = self._pushed_back, None
        if packet is None:
            packet = next(self._demuxed, None)
        if packet is not None:
            self._next += 1
        return packet

    def _feed(self) -> bool:
        """Decode the next packet; False at the end. What depends on a damaged one is lost, up to the next key."""
        number = self._next
        packet = self._read()
        if packet is None or number >= len(self._key_of):
            return False
        if number in self._lost:
            return True
        try:
            intact = not packet.is_corrupt and self._intact(packet)
            if intact:
                packet.opaque = number
                self._empty = False
                self._take(self.stream.codec_context.decode(packet))
        except FFmpegError:
            intact = False
        if not intact:
            after = np.flatnonzero(self._key_of > number)
            self._lost.update(range(number, int(after[0]) if len(after) else len(self._key_of)))
        return True

    def _drain(self) -> None:
        """Take out the frames that the decoder still holds; it then needs a key to go on."""
        if self._empty:
            return
        with contextlib.suppress(FFmpegError):
            self._take(self.stream.codec_context.decode(None))
        self.stream.codec_context.flush_buffers()
        self._empty = True

    def _take(self, frames: list[av.VideoFrame]) -> None:
        for frame in frames:
            if not isinstance(frame.opaque, int):
                continue  # made up by the decoder from damaged data: it belongs to no packet
            index = int(self._frame_of[frame.opaque])
            self._newest = max(self._newest, index)
            if not frame.is_corrupt:
                self._ready[index] = frame

    def _intact(self, packet: av.Packet) -> bool:
        """Hold an FFV1 packet against its checksums, if the clip has them: FFmpeg only logs a mismatch and guesses."""
        if self.stream.codec_context.name != "ffv1":
            return True
        slices = list(_ffv1_slices(bytes(packet)))
        if self._checksums is None:
            self._checksums = bool(slices)
        if not self._checksums:
            return True
        return bool(slices) and all(zlib.crc32(part.translate(MIRRORED), 0xFFFFFFFF) == 0xFFFFFFFF for part in slices)


def open_container(path: Path) -> Clip:
    """Index an AVI, Matroska or MP4 file.

    Raises
    ------
    InputError
        If the file cannot be opened, has no frames, or has a pixel format that is neither gray nor has a known luma.
    """
    frames = ContainerFrames(path)
    stream = frames.stream
    name = stream.pix_fmt or "unknown"
    if not (GRAY.fullmatch(name) or PLANAR_YUV.fullmatch(name) or name in RGB or name == "pal8"):
        raise InputError(path, f"pixel format {name}", "export as FFV1 in gray, gray10le, gray12le or gray16le")
    aspect = stream.sample_aspect_ratio
    if aspect and aspect != 1:
        raise InputError(
            path, f"pixels with an aspect ratio of {aspect}", "export with square pixels: angles need them"
        )
    depth = stream.format.components[0].bits
    metadata = {"format": f"{stream.codec_context.name}, {name}"}
    if stream.average_rate:
        metadata["playback_rate"] = f"{float(stream.average_rate):g}"
    if name.startswith("yuv"):
        wide = name.startswith("yuvj") or stream.codec_context.color_range == 2
        metadata["colour"] = HELD_LUMA
        metadata["levels"] = "full range" if wide else "limited range: black and white are at 16/255 and 235/255"
    return Clip(frames, metadata, bits=None if depth == 16 else depth, sequential=True)


def _packets(container: InputContainer, stream: int) -> Iterator[av.Packet]:
    """Packets with content, up to the end or to where a cut or damaged file makes FFmpeg stop."""
    demuxed = container.demux(container.streams[stream])
    while True:
        try:
            packet = next(demuxed, None)
        except FFmpegError:
            return
        if packet is None:
            return
        if packet.size:
            yield packet


def _ffv1_slices(data: bytes) -> list[bytes]:
    """The slices of an FFV1 packet; each ends in its size, a status byte and a CRC (RFC 9043, 4.9). [] without CRCs."""
    slices = []
    end = len(data)
    while end >= 8:
        start = end - 8 - int.from_bytes(data[end - 8 : end - 5])
        if start < 0:
            return []
        slices.append(data[start:end])
        end = start
    return slices if end == 0 else []


def _pixels(frame: av.VideoFrame, where: str) -> Pixels:
    name = frame.format.name
    if frame.rotation % 360:
        raise InputError(where, f"turned by {frame.rotation}° for display", "export it upright")
    if GRAY.fullmatch(name):
        return as_pixels(frame.to_ndarray(), where)
    if name == "pal8":
        index, palette = frame.to_ndarray()
        return as_pixels(palette[:, 1:][index], where)
    if name in RGB:
        return as_pixels(frame.to_ndarray(format="rgb24"), where)
    if PLANAR_YUV.fullmatch(name):
        return as_pixels(_luma_plane(frame), where)
    raise InputError(where, f"pixel format {name}", "export as FFV1 in gray, gray10le, gray12le or gray16le")


def _luma_plane(frame: av.VideoFrame) -> NDArray[np.uint8] | NDArray[np.uint16]:
    plane = frame.planes[0]
    deep = frame.format.components[0].bits > 8
    rows = np.frombuffer(memoryview(plane), "<u2" if deep else "u1").reshape(plane.height, -1)
    return rows[:, : plane.width]
