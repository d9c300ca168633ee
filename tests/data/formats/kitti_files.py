"""Write small datasets in the layouts of SemanticKITTI and of SSCBench-KITTI-360, with KITTI-360 itself beside."""

from pathlib import Path

import cv2
import numpy as np

from omniocc.data.formats.kitti360 import SEQUENCE

SHAPE = (256, 256, 32)
SIZE = (248, 75)
"""Width and height of the images of SemanticKITTI, px, a fifth of KITTI's."""
P2 = ((143.8, 0, 121.4, 9.076), (0, 143.8, 37.0, -0.0226), (0, 0, 1, 0.003779761))
P3 = ((143.8, 0, 121.4, -67.0), (0, 143.8, 37.0, 0.0), (0, 0, 1, 0.003))
TR = ((0, -1, 0, -0.012), (0, 0, -1, -0.054), (1, 0, 0, -0.292))
"""Velodyne (x forward, y left, z up) to camera 0, without KITTI's small tilts."""
WALL_M = 8.1
ROAD_ID, WALL_ID, CAR_ID, OTHER_ID = 40, 50, 252, 99


def line(name, matrix):
    return f"{name}: " + " ".join(f"{value:.12e}" for row in matrix for value in row)


def raw_voxels():
    """Return ids and the invalid mask: road in two layers, two walls, a moving car, a thing that does not count."""
    raw, invalid = np.zeros(SHAPE, "<u2"), np.zeros(SHAPE, bool)
    x, y, z = (low + 0.2 * (np.arange(count) + 0.5) for low, count in zip((0, -25.6, -2), SHAPE, strict=True))
    raw[np.ix_(x > 3, abs(y) < WALL_M, z < -1.6)] = ROAD_ID
    raw[np.ix_(x > 3, abs(abs(y) - WALL_M) < 0.11, (z > -1.6) & (z < 1))] = WALL_ID
    raw[50:70, 120:130, 3:9] = CAR_ID
    raw[80:82, 140:142, 3:9] = OTHER_ID
    invalid[:, (y < -WALL_M - 1) | (y > WALL_M + 1)] = True
    return raw, invalid


def points():
    """Return points of road and walls with their ids, velodyne frame, as (P, 4) float32 and (P,) uint32."""
    along, share = np.meshgrid(np.arange(4, 40, 0.2), np.linspace(-1, 1, 24))
    road = np.stack([along, (WALL_M - 0.2) * share, np.full_like(along, -1.7)], -1).reshape(-1, 3)
    walls = [np.stack([along, np.full_like(along, side * WALL_M), share * 0.9], -1).reshape(-1, 3) for side in (-1, 1)]
    found = np.concatenate([road, *walls])
    ids = np.repeat(np.array([ROAD_ID, WALL_ID, WALL_ID], "<u4"), along.size) + (7 << 16)  # instance 7
    return np.c_[found, np.ones(len(found))].astype("<f4"), ids


def write_png(path, size, grey):
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((size[1], size[0], 3), 90, np.uint8)
    image[:, : size[0] // 2] = grey
    cv2.imwrite(str(path), image)


def write_bits(path, mask):
    path.write_bytes(np.packbits(mask).tobytes())


def write_semantic_kitti(root: Path, sequences=("00", "04", "08"), frames=2, first_release=False) -> Path:
    """Write sequences whose every fifth frame has voxels, one cell too high in the first release; 1 m a frame."""
    raw, invalid = (np.roll(cells, int(first_release), axis=2) for cells in raw_voxels())
    cloud, ids = points()
    for sequence in sequences:
        folder = root / "sequences" / sequence
        for name in ("voxels", "velodyne", "labels"):
            (folder / name).mkdir(parents=True)
        lines = [line("P0", P2), line("P1", P2), line("P2", P2), line("P3", P3), line("Tr", TR), ""]
        (folder / "calib.txt").write_text("\n".join(lines))
        count = 5 * frames + 1
        poses = [np.c_[np.eye(3), [0.0, 0.0, float(k)]].ravel() for k in range(count)]
        (folder / "poses.txt").write_text("\n".join(" ".join(map(str, pose)) for pose in poses) + "\n")
        for number in range(0, 5 * frames, 5):
            for camera in ("image_2", "image_3"):
                write_png(folder / camera / f"{number:06d}.png", SIZE, 10 * number)
            (folder / "velodyne" / f"{number:06d}.bin").write_bytes(cloud.tobytes())
            (folder / "labels" / f"{number:06d}.label").write_bytes(ids.tobytes())
            stem = folder / "voxels" / f"{number:06d}"
            stem.with_suffix(".label").write_bytes(raw.tobytes())
            write_bits(stem.with_suffix(".bin"), raw > 0)
            write_bits(stem.with_suffix(".invalid"), invalid)
            write_bits(stem.with_suffix(".occluded"), invalid | (raw > 0))
    return root


def write_sscbench(root: Path, sequences=("00", "06", "09"), frames=2, poses=True) -> Path:
    """Write sequences of SSCBench-KITTI-360 with voxels; masks have one byte a voxel."""
    raw, invalid = raw_voxels()
    for sequence in sequences:
        folder = root / "data_2d_raw" / SEQUENCE.format(sequence)
        (folder / "voxels").mkdir(parents=True)
        for number in range(0, 5 * frames, 5):
            write_png(folder / "image_00" / "data_rect" / f"{number:06d}.png", (1408, 376), 10 + 4 * number)
            stem = folder / "voxels" / f"{number:06d}"
            stem.with_suffix(".label").write_bytes(raw.tobytes())
            stem.with_suffix(".invalid").write_bytes((invalid | (raw == OTHER_ID)).astype(np.uint8).tobytes())
        if poses:
            lines = [f"{k} " + " ".join(map(str, np.c_[np.eye(3), [k, 0.0, 0.0]].ravel())) for k in range(5 * frames)]
            (folder / "pose.txt").write_text("\n".join(lines))
    return root


CAM_TO_POSE = {
    "image_00": "0.0371783278 -0.0986182135 0.9944306009 1.5752681039 0.9992675562 -0.0053553387 -0.0378902567 "
    "0.0043914093 0.0090621821 0.9951109327 0.0983468786 -0.65",
    "image_01": "0.0194000864 -0.1051529641 0.9942668106 1.5977241400 0.9997374956 -0.0100836652 -0.0205732716 "
    "0.5981494900 0.0121891942 0.9944049345 0.1049297370 -0.6488433108",
    "image_02": "0.9995185086 0.0041276589 -0.0307524527 0.7264036936 -0.0307926666 0.0100608424 -0.9994751579 "
    "-0.1499658517 -0.0038160970 0.9999408692 0.0101830998 -1.0686400091",
    "image_03": "-0.9996821702 0.0005703407 -0.0252038325 0.7016842127 -0.0252033830 0.0007820814 0.9996820384 "
    "0.7463650950 0.0005898709 0.9999995315 -0.0007674583 -1.0751978255",
}
CALIBRATION = {
    "calib_cam_to_pose.txt": "".join(f"{name}: {numbers}\n" for name, numbers in CAM_TO_POSE.items()),
    "calib_cam_to_velo.txt": "0.04307104361 -0.08829286498 0.995162929 0.8043914418 -0.999004371 0.007784614041 "
    "0.04392796942 0.2993489574 -0.01162548558 -0.9960641394 -0.08786966659 -0.1770225824\n",
    "perspective.txt": "calib_time: 2013\n"
    "P_rect_00: 552.554261 0 682.049453 0 0 552.554261 238.769549 0 0 0 1 0\n"
    "R_rect_00: 0.999974 -0.007141 -0.000089 0.007141 0.999969 -0.003247 0.000112 0.003247 0.999995\n"
    "S_rect_00: 1408 376\n"
    "P_rect_01: 552.554261 0 682.049453 -328.318735 0 552.554261 238.769549 0 0 0 1 0\n"
    "R_rect_01: 0.999778 -0.012115 0.017222 0.012059 0.999922 0.003351 -0.017261 -0.003143 0.999846\n",
}
"""Numbers of KITTI-360's calibration, which many public repositories quote."""
LENSES = {
    "image_02": (
        2.2134047507854890,
        1.6798235660113681e-02,
        1.6548773243373522,
        4.2223943394772046e-04,
        4.2462134260997584e-04,
        1336.3220825849971,
        1335.7883350012958,
        716.94323510126321,
        705.76498308221585,
    ),
    "image_03": (
        2.5535139132482758,
        4.9370396274089505e-02,
        4.5068455478645308,
        1.3477698472982495e-03,
        -7.0340482615055284e-04,
        1485.4388981875156,
        1484.9477411748708,
        698.88316784030962,
        698.14541887723055,
    ),
}


def write_calibration(folder: Path) -> None:
    """Write the folder `calibration` of KITTI-360."""
    folder.mkdir(parents=True)
    for name, text in CALIBRATION.items():
        (folder / name).write_text(text)
    for name, (xi, k1, k2, p1, p2, gamma1, gamma2, u0, v0) in LENSES.items():
        (folder / f"{name}.yaml").write_text(
            "%YAML:1.0\n---\nmodel_type: MEI\ncamera_name: " + name + "\nimage_width: 1400\nimage_height: 1400\n"
            f"mirror_parameters:\n   xi: {xi!r}\n"
            f"distortion_parameters:\n   k1: {k1!r}\n   k2: {k2!r}\n   p1: {p1!r}\n   p2: {p2!r}\n"
            f"projection_parameters:\n   gamma1: {gamma1!r}\n   gamma2: {gamma2!r}\n   u0: {u0!r}\n   v0: {v0!r}\n"
        )


def write_kitti360(root: Path, sequences=("00", "06", "09"), frames=12, offset=100) -> Path:
    """Write KITTI-360 itself: images of three cameras, poses, and scans; its numbers are `offset` more than SSCBench's.

    The image of frame `offset + k` is that of SSCBench's frame k. The second frame has no pose.
    """
    write_calibration(root / "calibration")
    cloud = points()[0]
    for sequence in sequences:
        name = SEQUENCE.format(sequence)
        raw, scans = root / "data_2d_raw" / name, root / "data_3d_raw" / name / "velodyne_points" / "data"
        scans.mkdir(parents=True)
        lines = []
        for frame in range(frames):
            number = offset + frame
            write_png(raw / "image_00" / "data_rect" / f"{number:010d}.png", (1408, 376), 10 + 4 * frame)
            for camera in ("image_02", "image_03"):
                write_png(raw / camera / "data_rgb" / f"{number:010d}.png", (1400, 1400), 10 + 4 * frame)
            (scans / f"{number:010d}.bin").write_bytes(cloud.tobytes())
            if frame != 1:
                pose = np.c_[np.diag([1.0, -1.0, -1.0]), [float(frame), 0.0, 0.0]]
                lines.append(f"{number} " + " ".join(map(str, pose.ravel())))
        folder = root / "data_poses" / name
        folder.mkdir(parents=True)
        (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    return root
