"""Encoding of a recorded frame as named blobs, and decoding.

| blob              | content                                 | error after a round trip                              |
| ----------------- | --------------------------------------- | ----------------------------------------------------- |
| `frame.json`      | time, pose, boxes                       | none                                                  |
| `rgb<k>.jpg`      | colour of camera k, JPEG quality 95     | lossy: a few grey levels                              |
| `semantic<k>.zst` | class ids of camera k (`pack`)          | none                                                  |
| `range<k>.zst`    | range of camera k, 16 bit (`pack`)      | 1/512 m; inf, nan kept; saturates beyond 255.99 m     |
| `erp_range.zst`   | range around the ego origin (`pack`)    | as range                                              |
| `points.zst`      | surface points, 3 x 16 bit, and class   | 1/256 m per axis; beyond 255.99 m left out, reordered |
| `lidar.zst`       | range (16 bit) and class of each ray    | as range; classes none                                |

Points are kept in steps of 1/128 m, since finer ones would only store noise. They are decoded to odd multiples of
1/256 m, so that none is on the boundary between cells of round sizes. A point changes its cell of 0.2 m with a
probability of 1 % per axis, and only within 4 mm of the boundary. All encoders are deterministic: equal
frames give equal bytes.

The members after the images may be absent: logs of real cars have no classes of pixels and perhaps no LiDAR.
"""

import json
from collections.abc import Mapping
from itertools import pairwise

import cv2
import numpy as np
import zstandard

from omniocc.camera.protocol import finite, numbers
from omniocc.classes import UNKNOWN
from omniocc.data.store.frame import RecordedFrame
from omniocc.errors import repr_of
from omniocc.frame import Box, Frame
from omniocc.io import parse_json

STEPS_PER_M = 256
POINT_STEPS_PER_M = 128
UNMEASURED_CODE = 0
SKY_CODE = 65535
JPEG_QUALITY = 95
FACTS, PANORAMA, POINTS, LIDAR = "frame.json", "erp_range.zst", "points.zst", "lidar.zst"
ZSTD_LEVEL = 1
MAX_POINTS = 2**25
"""More than all LiDARs of a car measure in a frame."""
_CODE_BYTES = 6
_HEADER = np.dtype("<u2")
_HEADER_BYTES = 4
MAX_PIXELS = 2**26
"""More than any camera or panorama has; 8192 x 8192."""
# shift and mask of each step: 16 bits are spread to every third place in four halvings; the step of 32, which moves
# bits above the 16, changes nothing
_STEPS = tuple(
    (np.uint64(shift), np.uint64(mask))
    for shift, mask in (
        (32, 0x001F00000000FFFF),
        (16, 0x001F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
)


def encode_frame(frame: Frame | RecordedFrame) -> dict[str, bytes]:
    """Return all blobs of a frame by name, in a fixed order; parts that are None have none."""
    facts = {"time_s": frame.time_s, "world_from_ego": frame.world_from_ego.tolist()}
    facts["boxes"] = [vars(box) for box in frame.boxes]
    blobs = {FACTS: json.dumps(facts, default=lambda value: value.item()).encode()}
    for k, image in enumerate(frame.images):
        blobs[f"rgb{k}.jpg"] = encode_image(image)
    for k, labels in enumerate(() if frame.semantics is None else frame.semantics):
        blobs[f"semantic{k}.zst"] = pack(labels)
    for k, range_m in enumerate(() if frame.range_m is None else frame.range_m):
        blobs[f"range{k}.zst"] = encode_range(range_m)
    if frame.erp_range_m is not None:
        blobs[PANORAMA] = encode_range(frame.erp_range_m)
    if frame.points_m is not None and frame.point_labels is not None:
        blobs[POINTS] = encode_points(frame.points_m, frame.point_labels)
    if frame.lidar_range_m is not None and frame.lidar_labels is not None:
        blobs[LIDAR] = encode_lidar(frame.lidar_range_m, frame.lidar_labels)
    return blobs


def decode_frame(blobs: Mapping[str, bytes]) -> RecordedFrame:
    """Return the frame that all its blobs hold, within the errors of the table above; parts without blobs are None."""
    facts = parse_json(blobs[FACTS])
    cameras = range(sum(name.startswith("rgb") for name in blobs))
    points_m, point_labels = decode_points(blobs[POINTS]) if POINTS in blobs else (None, None)
    lidar_range_m, lidar_labels = decode_lidar(blobs[LIDAR]) if LIDAR in blobs else (None, None)
    return RecordedFrame(
        time_s=facts["time_s"],
        world_from_ego=np.array(facts["world_from_ego"], dtype=np.float64),
        images=np.stack([decode_image(blobs[f"rgb{k}.jpg"]) for k in cameras]),
        semantics=np.stack([decode_labels(blobs[f"semantic{k}.zst"]) for k in cameras])
        if "semantic0.zst" in blobs
        else None,
        range_m=np.stack([decode_range(blobs[f"range{k}.zst"]) for k in cameras]) if "range0.zst" in blobs else None,
        erp_range_m=decode_range(blobs[PANORAMA]) if PANORAMA in blobs else None,
        points_m=points_m,
        point_labels=point_labels,
        lidar_range_m=lidar_range_m,
        lidar_labels=lidar_labels,
        boxes=tuple(_decode_box(box) for box in facts["boxes"]),
    )


def decode_boxes(blob: bytes) -> tuple[Box, ...]:
    """Return the boxes of actors that `frame.json` holds; raise KeyError, TypeError or ValueError for what is none."""
    return tuple(_decode_box(box) for box in parse_json(blob)["boxes"])


def encode_image(image: np.ndarray) -> bytes:
    """Return (H, W, 3) uint8 RGB as JPEG."""
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    done, blob = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    assert done
    return blob.tobytes()


def decode_image(blob: bytes) -> np.ndarray:
    """Return the image, (H, W, 3) uint8 RGB."""
    pixels = cv2.imdecode(np.frombuffer(blob, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)


def encode_range(range_m: np.ndarray) -> bytes:
    """Return ranges (H, W) in metres, inf for sky, nan for no measurement, as bytes of 16 bits each."""
    return pack(quantize_range(range_m))


def decode_range(blob: bytes, limit_px: int = MAX_PIXELS) -> np.ndarray:
    """Return the ranges, (H, W) float32, m; raise ValueError for more than this many or not of 16 bits."""
    return restore_range(_of_bits(16, unpack(blob, limit_px)))


def decode_labels(blob: bytes, limit_px: int = MAX_PIXELS) -> np.ndarray:
    """Return the classes of pixels, (H, W) uint8; raise ValueError for more than this many or not of 8 bits."""
    return _of_bits(8, unpack(blob, limit_px))


def quantize_range(range_m: np.ndarray) -> np.ndarray:
    """Return ranges in metres as uint16 steps of 1/256 m; two codes are those of nan and inf.

    Raises:
        ValueError: for a negative range.
    """
    if np.any(range_m < 0):
        raise ValueError(f"a range cannot be negative, got {np.nanmin(range_m)} m")
    unmeasured = np.isnan(range_m)
    steps = np.rint(np.where(unmeasured, 0.0, range_m) * STEPS_PER_M)  # a power of two: exact in float32
    codes = np.clip(steps, UNMEASURED_CODE + 1, SKY_CODE - 1).astype(np.uint16)
    codes[unmeasured] = UNMEASURED_CODE
    codes[np.isposinf(range_m)] = SKY_CODE
    return codes


def restore_range(codes: np.ndarray) -> np.ndarray:
    """Return the ranges of codes, float32, m, the inverse of `quantize_range`."""
    range_m = codes.astype(np.float32) / STEPS_PER_M
    range_m[codes == UNMEASURED_CODE] = np.nan
    range_m[codes == SKY_CODE] = np.inf
    return range_m


def encode_points(points_m: np.ndarray, labels: np.ndarray) -> bytes:
    """Return points (P, 3), m, and classes (P,) as bytes: steps along a Morton curve in byte planes under zstd."""
    steps = np.floor(points_m * POINT_STEPS_PER_M)
    reach = np.iinfo(np.int16).max
    if np.abs(steps).max(initial=0) > reach:
        kept = np.abs(steps).max(axis=1) <= reach
        steps, labels = steps[kept], labels[kept]
    # the class is in the low bits, so that place and class are sorted as one number
    keys = np.sort((interleave(steps.astype(np.int16)) << np.uint64(8) | labels).astype(np.int64), kind="stable")
    gaps = np.diff(keys >> 8, prepend=0).astype("<u8")
    return _compress([*_byte_planes(gaps)[:_CODE_BYTES], keys.astype(np.uint8)])


def decode_points(blob: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return points (P, 3) float32, m, and classes (P,) uint8, in the order of the Morton curve.

    Raises:
        ValueError: for more than `MAX_POINTS`.
    """
    planes = _decompress(blob, _CODE_BYTES + 1, MAX_POINTS)
    padded = np.zeros((8, planes.shape[1]), dtype=np.uint8)
    padded[:_CODE_BYTES] = planes[:_CODE_BYTES]
    codes = np.cumsum(_join(padded, "<u8"), dtype=np.uint64)
    return (separate(codes) + np.float32(0.5)) / np.float32(POINT_STEPS_PER_M), planes[_CODE_BYTES].copy()


def encode_lidar(range_m: np.ndarray, labels: np.ndarray) -> bytes:
    """Return ranges (R,), m, and classes (R,) as byte planes under zstd."""
    return _compress([quantize_range(range_m).astype("<u2"), labels])


def decode_lidar(blob: bytes, rays: int = MAX_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges (R,) float32, m, and classes (R,) uint8; raise ValueError for more than this many."""
    planes = _decompress(blob, 3, rays)
    return restore_range(_join(planes[:2], "<u2")), planes[2].copy()


def _compress(columns: list[np.ndarray]) -> bytes:
    # bytes of equal significance side by side: high bytes change slowly and compress well
    planes = [plane for column in columns for plane in _byte_planes(np.ascontiguousarray(column))]
    return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(np.ascontiguousarray(planes).tobytes())


def _byte_planes(column: np.ndarray) -> np.ndarray:
    return column.view(np.uint8).reshape(len(column), column.itemsize).T


def _decompress(blob: bytes, planes: int, columns: int) -> np.ndarray:
    return np.frombuffer(decompress(blob, planes * columns), dtype=np.uint8).reshape(planes, -1)


def _join(planes: np.ndarray, dtype: str) -> np.ndarray:
    return np.ascontiguousarray(planes.T).view(dtype).reshape(-1)


def _of_bits(bits: int, pixels: np.ndarray) -> np.ndarray:
    if pixels.itemsize * 8 != bits:
        raise ValueError(f"its pixels have {pixels.itemsize * 8} bits instead of {bits}")
    return pixels


def _decode_box(box: dict) -> Box:
    for key in ("id", "label"):
        if isinstance(box[key], bool) or not isinstance(box[key], int):
            raise ValueError(f"the {key} of a box is {repr_of(box[key])}; it must be a whole number")
    if not 0 <= box["label"] <= UNKNOWN:
        raise ValueError(f"the label of a box is {repr_of(box['label'])}; it must be 0 to {UNKNOWN}")
    lengths = {"center_m": 3, "size_m": 3, "velocity_mps": 2}
    center_m, size_m, velocity_mps = (numbers(f"the {key} of a box", box[key], n, n) for key, n in lengths.items())
    if min(size_m) < 0:
        raise ValueError(f"the size_m of a box is {size_m}; no length is below 0")
    yaw_rad = finite("the yaw_rad of a box", box["yaw_rad"])
    return Box(box["id"], box["label"], center_m, size_m, yaw_rad, velocity_mps)  # type: ignore[arg-type]


def pack(pixels: np.ndarray) -> bytes:
    """Return an image (H, W) uint8 or uint16 as bytes, equal ones for equal pixels.

    A header of height and width (two uint16), then the pixels under zstd. 16-bit pixels are replaced by their
    difference from a plane through the left, upper and upper left neighbours; all low bytes come before all high
    bytes. Ranges of a street become a third smaller than PNG, seven times as fast.
    """
    body = pixels if pixels.dtype == np.uint8 else _differences(pixels)
    header = np.array(pixels.shape, dtype=_HEADER).tobytes()
    return zstandard.ZstdCompressor(level=ZSTD_LEVEL).compress(header + np.ascontiguousarray(body).tobytes())


def unpack(blob: bytes, limit_px: int = MAX_PIXELS) -> np.ndarray:
    """Return the image that bytes hold, the inverse of `pack`; it may have at most this many pixels.

    Raises:
        ValueError: if it has more, or the bytes hold neither 8 nor 16 bits per pixel.
        zstandard.ZstdError: if they are no zstd frame.
    """
    content = np.frombuffer(decompress(blob, 2 * min(limit_px, MAX_PIXELS) + _HEADER_BYTES), dtype=np.uint8)
    height, width = content[:4].view(_HEADER).tolist()
    body = content[4:]
    if len(body) == height * width:
        return body.reshape(height, width).copy()
    low, high = body.reshape(2, height, width).astype(np.uint16)
    residual = low | high << np.uint16(8)
    residual = (residual >> np.uint16(1)) ^ -(residual & np.uint16(1))
    pixels = np.add.accumulate(residual, axis=1, dtype=np.uint16)
    for above, row in pairwise(pixels):  # three times as fast as accumulating along the columns
        row += above
    return pixels


def _differences(pixels: np.ndarray) -> np.ndarray:
    """Return the low, then the high bytes (2, H, W) of second differences modulo 2**16.

    Differences near zero become small numbers: 0, -1, 1, -2 become 0, 1, 2, 3.
    """
    across = pixels.copy()
    across[:, 1:] -= pixels[:, :-1]
    residual = across.copy()
    residual[1:] -= across[:-1]
    signed = residual.view(np.int16)
    folded = ((signed << 1) ^ (signed >> 15)).view(np.uint16)
    return np.stack([folded & 0xFF, folded >> 8]).astype(np.uint8)


def decompress(blob: bytes, limit_bytes: int) -> bytes:
    """Return the content of a zstd frame that states its size.

    Raises:
        ValueError: if it would be larger than the limit; nothing is unpacked.
        zstandard.ZstdError: if the bytes are no such frame.
    """
    size = zstandard.frame_content_size(blob)
    if size > limit_bytes:
        raise ValueError(f"it unpacks to {size:,} bytes, at most {limit_bytes:,} are expected")
    return zstandard.ZstdDecompressor().decompress(blob)


def interleave(steps: np.ndarray) -> np.ndarray:
    """Return the codes (P,) uint64, 48 bits each, of coordinates (P, 3) int16."""
    code = np.zeros(len(steps), dtype=np.uint64)
    for axis in range(3):
        bits = (steps[:, axis].astype(np.int32) + 32768).astype(np.uint64)
        for shift, mask in _STEPS:
            bits = (bits | (bits << shift)) & mask
        code |= bits << np.uint64(axis)
    return code


def separate(codes: np.ndarray) -> np.ndarray:
    """Return the coordinates of codes, the inverse of `interleave`."""
    steps = np.empty((len(codes), 3), dtype=np.int16)
    masks = [np.uint64(0xFFFF), *(mask for _, mask in _STEPS)]
    for axis in range(3):
        bits = (codes >> np.uint64(axis)) & masks[-1]
        for (shift, _), mask in zip(_STEPS[::-1], masks[-2::-1], strict=True):
            bits = (bits | (bits >> shift)) & mask
        steps[:, axis] = bits.astype(np.int32) - 32768
    return steps
