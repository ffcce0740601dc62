"""Checkpoints of drivestudio (OmniRe, Chen et al. 2025): static set and nodes.

A checkpoint holds, under models, the weights of each class of Gaussians. Background and Ground
stand still. RigidNodes and DeformableNodes hold all their nodes in one set: points_ids says whose
a Gaussian is, instances_trans and instances_quats where each node is in each frame,
instances_fv whether it is there, instances_size its box. Harmonics take directions of the
capture frame; those of degree 0 are logits of colours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rainsim.actors.actor import Actor
from rainsim.actors.motion import Track
from rainsim.constants import SH_0
from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH, printable_name
from rainsim.scene.activate import activate, dropped_note, keep_good
from rainsim.scene.ply import DISC_THICKNESS
from rainsim.scene.splat_sets import joined
from rainsim.scene.torch_file import read_weights

SUFFIX = ".pth"
STATIC = ("Background", "Ground")
NODES = {"RigidNodes": "vehicle", "DeformableNodes": "deformable"}  # and their class in labels
LEFT_OUT = {
    "SMPLNodes": "people, whose bodies a skeleton bends",
    "Sky": "the sky, in whose place that of the day is drawn",
}
FRAMES_PER_SECOND = 10.0  # of the data sets that these models are trained on
COEFFICIENTS = (0, 3, 8, 15)  # of harmonics above degree 0
REMEDY = "it must be as drivestudio saves it (checkpoint_final.pth); give that file"


def is_checkpoint(path):
    """Whether a path is that of a checkpoint: these are known by their suffix."""
    return Path(path).suffix.lower() == SUFFIX


def read_checkpoint(path, fps=FRAMES_PER_SECOND):
    """Read a checkpoint.

    Parameters
    ----------
    path : path-like
    fps : float [1/s]
        Frames a second of the data that it was trained on.

    Returns
    -------
    static : Splats
    actors : tuple of Actor
    notes : list of str
    """
    data = read_weights(path)
    models = data.get("models") if isinstance(data, dict) else None
    if not isinstance(models, dict) or not models:
        raise InputError(f"{path} has no models; {REMEDY}")
    static, actors, notes = [], [], []
    for name, weights in models.items():
        if not isinstance(weights, dict):
            raise InputError(f"{path}: {printable_name(name)} has no weights; {REMEDY}")
        if name in STATIC:
            splats, _, said = _splats(path, name, weights)
            static.append(splats)
        elif name in NODES:
            more, said = _nodes(path, name, weights, fps)
            actors += more
        else:
            said = [f"left out: {LEFT_OUT.get(name, 'not known')}"] if weights else []
        notes += [f"{printable_name(name)}: {note}" for note in said]
    if not static:
        raise InputError(f"{path} has no Background; {REMEDY}")
    if actors:
        notes.append(f"{len(actors)} nodes with tracks at {fps:g} frames a second")
    return joined(static), tuple(actors), notes


def _array(path, name, weights, key, shape, kinds="f"):
    """Return an array of the weights, its type and shape checked; None stands for any length."""
    found = weights.get(key)
    fits = isinstance(found, np.ndarray) and found.dtype.kind in kinds
    fits = fits and found.ndim == len(shape)
    fits = fits and all(w is None or n == w for n, w in zip(found.shape, shape, strict=True))
    if not fits:
        what = f"{found.dtype} {found.shape}" if isinstance(found, np.ndarray) else "not there"
        rule = " x ".join("n" if n is None else str(n) for n in shape)
        raise InputError(f"{path}: {key} of {name} is {what}; it must be {rule}; {REMEDY}")
    return found


def _splats(path, name, weights):
    """Return the splats of one class, which of the stored ones they are, and notes."""
    means = _array(path, name, weights, "_means", (None, 3))
    n, said = len(means), []
    if n == 0:
        raise InputError(f"{path}: {name} has no Gaussians; {REMEDY}")
    scales = _array(path, name, weights, "_scales", (n, None))
    if scales.shape[1] == 1:
        scales = np.repeat(scales, 3, axis=1)
    elif scales.shape[1] == 2:
        thin = scales.min(axis=1, keepdims=True) + np.float32(np.log(DISC_THICKNESS))
        scales = np.concatenate([scales, thin], axis=1)
        said.append(f"2D splats: the third axis is made {DISC_THICKNESS:g} of the smaller one")
    turns = _array(path, name, weights, "_quats", (n, 4))
    logit = _array(path, name, weights, "_opacities", (n, 1))[:, 0]
    base = _array(path, name, weights, "_features_dc", (n, 3))
    rest = _array(path, name, weights, "_features_rest", (n, None, 3))
    if rest.shape[1] not in COEFFICIENTS or scales.shape[1] != 3:
        raise InputError(
            f"{path}: {name} has {rest.shape[1]} harmonics above degree 0 and {scales.shape[1]} "
            f"scales; they must be 0, 3, 8 or 15, and 1 to 3; {REMEDY}"
        )
    if rest.shape[1] == 0:  # of degree 0 the colour's logit is stored
        with np.errstate(over="ignore"):
            base = (1 / (1 + np.exp(-base)) - 0.5) / SH_0
    stored = (np.asarray(a, np.float32) for a in (means, scales, turns, logit, base))
    splats, good = activate(*stored, np.asarray(rest, np.float32) if rest.shape[1] else None)
    splats, broken = keep_good(path, splats, good)
    return splats, good, [*said, *dropped_note(broken, len(splats))]


def _nodes(path, name, weights, fps):
    """Return the actors of one class of nodes, and notes."""
    splats, good, said = _splats(path, name, weights)
    sizes = _array(path, name, weights, "instances_size", (None, 3)).astype(np.float64)
    n = len(sizes)
    there = _array(path, name, weights, "instances_fv", (None, n), "biu").astype(bool)
    frames = len(there)
    place = _array(path, name, weights, "instances_trans", (frames, n, 3)).astype(np.float64)
    turn = _array(path, name, weights, "instances_quats", (frames, n, 4)).astype(np.float64)
    owner = _array(path, name, weights, "points_ids", (len(good), 1), "iu")[good, 0]
    if len(owner) and not (0 <= owner.min() and owner.max() < n):
        raise InputError(f"{path}: points_ids of {name} name nodes beyond {n}; {REMEDY}")
    actors, lost = [], []
    for k in range(n):
        seen, mine = there[:, k], owner == k
        if not seen.any() or not mine.any():
            lost.append(str(k))
            continue
        keys = place[seen, k], turn[seen, k], sizes[k]
        length = np.linalg.norm(turn[seen, k], axis=1)
        if not all((np.abs(a) < MAX_LENGTH).all() for a in keys) or not (length > 0).all():
            raise InputError(f"{path}: poses of node {k} of {name} are no poses; {REMEDY}")
        track = _track(seen, place[:, k], turn[:, k], fps)
        box = np.stack([np.zeros(3), sizes[k]])
        own = f"{name}-{k}"
        actors.append(Actor(own, NODES[name], splats.take(mine), box, track, turning=False))
    if lost:
        said.append(f"nodes {', '.join(lost)} are in no frame or have no Gaussians: left out")
    if name == "DeformableNodes" and actors:
        said.append("kept in the shape that they are bent from; a network bends them, not read")
    return actors, said


def _track(seen, place, turn, fps):
    """Return the Track of a node that is there in the frames `seen` (frames,)."""
    last = np.flatnonzero(seen)
    # Where a node is not there its pose means nothing: it waits in the last one.
    held = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), last[0]))
    kept = seen | np.concatenate([[True], seen[:-1] != seen[1:]])
    frame = np.flatnonzero(kept)
    return Track(frame / fps, place[held[frame]], turn[held[frame]], seen[frame])
