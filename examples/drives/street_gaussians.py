"""Models of Street Gaussians: a PLY with an element for each node, and tracks beside it."""

import numpy as np
from parts import actor
from street_tracks import PICTURE, read_tracks

from rainsim.actors.actor import ColorSeries
from rainsim.scene.plyheader import read_header


def in_order(cameras):
    """Return cameras sorted as a drive: camera by camera, each in the order of its frames."""
    if not all(PICTURE.match(camera.name) for camera in cameras):
        return cameras
    return sorted(cameras, key=lambda camera: PICTURE.match(camera.name).group(2, 1))


def columns_of(file, element):
    """Return the columns of an element that are finite, and its colours over time (n, m, 3)."""
    element.require_room(file)
    rows = np.fromfile(file, element.row, element.count, offset=element.offset)
    columns = {name: rows[name] for name in element.names if not name.startswith("f_dc_")}
    # A node's f_dc are, channel by channel, the terms of a Fourier series over its frames.
    terms = [rows[f"f_dc_{k}"] for k in range(len(element.names) - len(columns))]
    terms = np.stack(terms, axis=1).reshape(len(rows), 3, -1).transpose(0, 2, 1)
    columns |= {f"f_dc_{k}": terms[:, 0, k] for k in range(3)}
    good = np.isfinite(list(columns.values())).all(axis=0) & np.isfinite(terms).all(axis=(1, 2))
    return {name: values[good] for name, values in columns.items()}, terms[good]


def read(file, data, cameras):
    """Return the sets that stand still, actors, notes, and colours over time by id."""
    with open(file, "rb") as opened:
        elements = read_header(file, opened).elements
    tracks = read_tracks(data, cameras) if data else {}
    static, actors, series, left = [], [], {}, []
    for element in (e for e in elements if e.count):
        _, kind, *number = element.name.split("_")
        if kind in ("background", "sky"):
            static.append(columns_of(file, element)[0])
        elif kind != "obj" or int(number[0]) not in tracks:
            left.append(element.name)
        else:
            track, name = tracks[int(number[0])], str(int(number[0]))
            columns, terms = columns_of(file, element)
            actors.append((actor(name, *track), columns))
            if terms.shape[1] > 1:
                begin, end = track[2][2], track[2][-2]  # its first frame and its last [s]
                series[name] = ColorSeries(terms.astype(np.float32), begin, end)
    notes = [f"left out, without tracks: {', '.join(left)}"] if left else []
    return static, actors, notes, series
