"""Tracks in the data that Street Gaussians is trained on, as its scripts for Waymo lay them out."""

import json
import re

import numpy as np
from scipy.spatial.transform import Rotation

PICTURE = re.compile(r"(\d{6})_(\d)")  # frame and camera in a picture's name
BEYOND = 0.1  # s before its first frame and after its last that a node is there


def table_of(path):
    """Return the lines of track_info.txt as words: frame, track, class, ..."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head, *rows = [line.split() for line in lines if line.strip()]
    if any(len(row) != len(head) for row in rows):
        raise ValueError(f"lines of {path} have other columns than its head")
    return sorted(rows, key=lambda row: int(row[0]))


def read_tracks(data, cameras):
    """Return, by track, what `parts.actor` takes after the id; the first picture is at time 0."""
    times = json.loads((data / "timestamps.json").read_text(encoding="utf-8"))["FRAME"]
    times = {int(frame): time for frame, time in times.items()}
    poses = {int(path.stem): np.loadtxt(path).reshape(4, 4)
             for path in (data / "ego_pose").glob("*.txt") if path.stem.isdecimal()}  # fmt: skip
    middle = np.mean([pose[:3, 3] for pose in poses.values()], axis=0)  # the model's origin
    rows = table_of(data / "track/track_info.txt")
    pictures = [found for found in (PICTURE.match(c.name) for c in cameras) if found]
    frames = [int(m[1]) for m in pictures] or [0, *(int(row[0]) for row in rows)]
    by_track = {}
    for row in rows:
        if min(frames) <= int(row[0]) <= max(frames):
            by_track.setdefault(int(row[1]), []).append(row)
    return {
        track: way(mine, times, times[min(frames)], poses, middle)
        for track, mine in by_track.items()
    }


def way(rows, times, start, poses, middle):
    """Return class, size [m], times [s], places, turns and visibility of one node."""
    time = [times[int(row[0])] - start for row in rows]
    vehicle = np.array([poses[int(row[0])] for row in rows])  # to the world
    numbers = np.array([row[4:11] for row in rows], np.float64)
    height, width, length = numbers[:, :3].max(axis=0)
    place = np.einsum("nij,nj->ni", vehicle[:, :3, :3], numbers[:, 3:6]) + vehicle[:, :3, 3]
    heading = Rotation.from_rotvec(numbers[:, 6:7] * [0, 0, 1])
    turn = Rotation.from_matrix(vehicle[:, :3, :3]) * heading
    time = [time[0] - 2 * BEYOND, time[0] - BEYOND, *time, time[-1] + BEYOND]
    seen = [False, *[True] * (len(rows) + 1), False]
    keys = [0, 0, *range(len(rows)), -1]
    turn = turn.as_quat(scalar_first=True)[keys]
    return rows[0][2], (length, width, height), time, (place - middle)[keys], turn, seen
