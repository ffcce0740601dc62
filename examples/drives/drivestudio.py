"""Checkpoints of drivestudio: the weights of each class of Gaussians, by their names."""

import numpy as np
from parts import actor

STATIC = ("Background", "Ground")
NODES = {"RigidNodes": "vehicle", "DeformableNodes": "deformable"}  # and their class in labels
SH_0 = 0.28209479177387814  # of the first spherical harmonic


def weights_of(file):
    """Return the weights of each class as arrays; torch runs no code of the file."""
    import torch

    models = torch.load(file, map_location="cpu", weights_only=True)["models"]
    return {name: {key: value.detach().numpy() for key, value in weights.items()
                   if torch.is_tensor(value)} for name, weights in models.items()}  # fmt: skip


def columns_of(weights):
    """Return the Gaussians of one class as the columns of a PLY."""
    base, rest, scale = (weights[key] for key in ("_features_dc", "_features_rest", "_scales"))
    if rest.shape[1] == 0:  # of degree 0 the colour's logit is stored
        base = (1 / (1 + np.exp(-base.astype(np.float64))) - 0.5) / SH_0
    rest = rest.transpose(0, 2, 1).reshape(len(rest), -1)
    scale = np.repeat(scale, 3, axis=1) if scale.shape[1] == 1 else scale  # two are a disc
    columns = dict(zip("xyz", weights["_means"].T, strict=True))
    columns["opacity"] = weights["_opacities"][:, 0]
    tables = {"f_dc": base, "f_rest": rest, "scale": scale, "rot": weights["_quats"]}
    for name, table in tables.items():
        columns |= {f"{name}_{k}": column for k, column in enumerate(table.T)}
    return columns


def nodes_of(name, weights, fps):
    """Return the nodes of one class that are seen, as (entry of actors.json, columns)."""
    columns, found = columns_of(weights), []
    frames = np.arange(len(weights["instances_fv"]))
    for k, seen in enumerate(weights["instances_fv"].astype(bool).T):
        mine = weights["points_ids"][:, 0] == k
        if seen.any() and mine.any():
            # Where a node is not there its pose means nothing: it waits in the last one.
            held = np.maximum.accumulate(np.where(seen, frames, seen.argmax()))
            place, turn = (weights[f"instances_{key}"][held, k] for key in ("trans", "quats"))
            size = weights["instances_size"][k]
            entry = actor(f"{name}-{k}", NODES[name], size, frames / fps, place, turn, seen)
            found.append((entry, {key: column[mine] for key, column in columns.items()}))
    return found


def read(file, fps):
    """Return the sets that stand still, actors and notes; no colours change."""
    models = {name: weights for name, weights in weights_of(file).items() if weights}
    static = [columns_of(models[name]) for name in STATIC if name in models]
    nodes = [n for name in NODES if name in models for n in nodes_of(name, models[name], fps)]
    notes = [f"{name} is left out" for name in models if name not in (*STATIC, *NODES)]
    count = sum(len(models[name]["instances_size"]) for name in NODES if name in models)
    notes.append(f"{count - len(nodes)} nodes in no frame or without Gaussians are left out")
    return static, nodes, notes, {}
