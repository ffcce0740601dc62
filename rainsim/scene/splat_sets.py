"""Sets of splats: several joined to one, and how their splats are turned."""

import numpy as np
from scipy.spatial.transform import Rotation

from rainsim.scene.harmonics import padded
from rainsim.scene.types import Splats


def joined(parts):
    """Return one set of splats of several, in their order; harmonics get the highest degree."""
    parts = list(parts)
    most = max(part.sh.shape[1] for part in parts)
    return Splats(
        *(np.concatenate([getattr(p, name) for p in parts])
          for name in ("position", "rotation", "scale", "opacity")),
        np.concatenate([padded(p.sh, most) for p in parts]),
    )  # fmt: skip


def own_turns(splats):
    """Return the rotations from the own axes of splats to their frame, a float64 `Rotation`."""
    return Rotation.from_quat(splats.rotation.astype(np.float64), scalar_first=True)
