"""Models of Street Gaussians and drivestudio, made after those projects' layouts.

Of Street Gaussians the PLY after `make_ply` and `construct_list_of_attributes` of its
GaussianModel: f_dc channel by channel with all terms, f_rest likewise, a column of semantics; one
element for each node. The data after what `load_camera_info` and `get_obj_pose_tracking` of its
waymo_utils read. Of drivestudio the arrays that a state_dict of its Gaussians holds.
"""

import json

import numpy as np

from rainsim.scene.splat_sets import joined

HEADER = (
    "frame_id track_id object_class alpha box_height box_width box_length box_center_x "
    "box_center_y box_center_z box_heading speed"
)


def element_rows(splats, terms=None):
    """Names and float32 rows of one element; `terms` (n, m, 3) in place of the first harmonics."""
    n, k = splats.sh.shape[:2]
    terms = splats.sh[:, :1] if terms is None else terms
    base = terms.transpose(0, 2, 1).reshape(n, -1)
    rest = splats.sh[:, 1:].transpose(0, 2, 1).reshape(n, -1)
    names = ["x", "y", "z", "nx", "ny", "nz"]
    names += [f"f_dc_{i}" for i in range(base.shape[1])]
    names += [f"f_rest_{i}" for i in range(3 * (k - 1))]
    names += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    names += ["semantic_0"]
    logit = np.log(splats.opacity / (1 - splats.opacity))[:, None]
    columns = [splats.position, np.zeros((n, 3)), base, rest, logit, np.log(splats.scale),
               splats.rotation, np.zeros((n, 1))]  # fmt: skip
    return names, np.concatenate(columns, axis=1).astype("<f4")


def street_ply(elements):
    """Bytes of a PLY; `elements` lists (name, Splats, terms or None)."""
    head, body = ["ply", "format binary_little_endian 1.0"], b""
    for name, splats, terms in elements:
        names, rows = element_rows(splats, terms)
        head += [f"element {name} {len(splats)}", *(f"property float {n}" for n in names)]
        body += rows.tobytes()
    return "\n".join([*head, "end_header", ""]).encode() + body


def write_data(folder, tracks, ego, times):
    """Write the data: `tracks` lists (frame, track, class, (l, w, h), (x, y, z), heading).

    Places and headings are in the vehicle's frame; `ego` (frames, 4, 4) takes it to the world.
    """
    (folder / "track").mkdir(parents=True)
    (folder / "ego_pose").mkdir()
    lines = [HEADER]
    for frame, track, kind, (length, width, height), place, heading in tracks:
        numbers = (0.0, height, width, length, *place, heading, 3.0)
        lines.append(" ".join([str(frame), str(track), kind, *(repr(float(v)) for v in numbers)]))
    (folder / "track/track_info.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for frame, pose in enumerate(ego):
        np.savetxt(folder / f"ego_pose/{frame:06d}.txt", pose)
        np.savetxt(folder / f"ego_pose/{frame:06d}_0.txt", pose)  # of a camera: not to be counted
    stamps = {f"{frame:06d}": time for frame, time in enumerate(times)}
    (folder / "timestamps.json").write_text(json.dumps({"FRAME": stamps, "FRONT": stamps}))


def gaussian_weights(splats, degree_0=False):
    """The weights of one class of drivestudio's Gaussians, as its state_dict names them."""
    logit = np.log(splats.opacity / (1 - splats.opacity))[:, None]
    base, rest = splats.sh[:, 0], splats.sh[:, 1:]
    if degree_0:
        color = np.clip(0.5 + 0.28209479177387814 * base, 1e-3, 1 - 1e-3)
        base, rest = np.log(color / (1 - color)), rest[:, :0]
    arrays = {"_means": splats.position, "_scales": np.log(splats.scale), "_quats": splats.rotation,
              "_features_dc": base, "_features_rest": rest, "_opacities": logit}  # fmt: skip
    return {name: np.asarray(values, np.float32) for name, values in arrays.items()}


def node_weights(parts, sizes, places, turns, there, **options):
    """The weights of a class of nodes: `parts` lists the Splats of each node."""
    owner = np.concatenate([np.full((len(p), 1), k) for k, p in enumerate(parts)])
    return gaussian_weights(joined(parts), **options) | {
        "instances_quats": np.asarray(turns, np.float32),
        "instances_trans": np.asarray(places, np.float32), "points_ids": owner,
        "instances_size": np.asarray(sizes, np.float32), "instances_fv": np.asarray(there, bool),
    }  # fmt: skip
