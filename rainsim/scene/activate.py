"""Convert the stored values of splat files to those of `Splats`, and drop unusable splats.

Files store logarithms of scales, logits of opacities and quaternions of any length. All readers
call this module, so that the same rules decide for every format which splats are usable.

Infinite logarithms and logits have a meaning: a logit of +inf is an opacity of 1 (converters write
it for the full byte of SPZ and SOG), of -inf one of 0, and a logarithm of -inf a scale of 0.
"""

import numpy as np

from rainsim.errors import InputError
from rainsim.io.files import MAX_LENGTH
from rainsim.scene.types import Splats

MAX_BROKEN_SHARE = 0.01  # with a larger share of unusable splats the file counts as damaged
ROWS_PER_STEP = 1 << 14  # some 4 MB of splats: fits a core's share of cache
REST_COEFFICIENTS = {0: 1, 9: 4, 24: 9, 45: 16}  # number of f_rest_* -> (degree + 1)^2
FREE_COUNT = 1 << 16  # splats that a file of any size may declare; see `require_believable`


def empty_splats(count, coefficients):
    """Return uninitialised Splats for `count` splats of (degree + 1)^2 `coefficients`."""
    return Splats(
        position=np.empty((count, 3), np.float32),
        rotation=np.empty((count, 4), np.float32),
        scale=np.empty((count, 3), np.float32),
        opacity=np.empty(count, np.float32),
        sh=np.empty((count, coefficients, 3), np.float32),
    )


def activate_rows(splats, part, position, log_scale, turn, logit, base, rest=None, widen=None):
    """Fill the rows `part` of `splats` in place from the stored values of n splats.

    turn : array (n, 4). Quaternions of any length, w first.
    rest : array (n, k - 1, 3), optional. Coefficients of the higher degrees.
    widen : array (n,), optional. Standard deviation [capture units] of the 3D
        smoothing filter that the capture was trained with. It is added to each
        axis and the opacity reduced so that the splat's mass stays (the 3D
        smoothing filter of Mip-Splatting, Yu et al. 2024, and Gaussian Opacity
        Fields).
    Returns bool array (n,). Which splats have usable values.
    """
    with np.errstate(all="ignore"):  # values that overflow are counted as broken
        length = np.linalg.norm(turn, axis=1)
        splats.position[part] = position
        scale = np.exp(log_scale, out=splats.scale[part])
        opacity = np.divide(1, 1 + np.exp(-logit), out=splats.opacity[part])
        np.divide(turn, length[:, None], out=splats.rotation[part])
        splats.sh[part, 0] = base
        good = ~np.isnan(logit) & (length > 0) & np.isfinite(length)
        if widen is not None:
            good &= np.isfinite(widen)
            for axis in range(3):
                wider = np.hypot(scale[:, axis], widen)
                opacity *= np.divide(
                    scale[:, axis], wider, where=wider > 0, out=np.ones_like(wider)
                )
                scale[:, axis] = wider
        good &= (np.abs(position) < MAX_LENGTH).all(axis=1)  # false for NaN
        good &= (scale < MAX_LENGTH).all(axis=1) & np.isfinite(base).all(axis=1)
    if rest is not None:
        splats.sh[part, 1:] = rest
        good &= np.isfinite(rest).all(axis=(1, 2))
    return good


def activate(position, log_scale, turn, logit, base, rest=None):
    """Return the Splats of whole arrays and the mask of the usable ones; see `activate_rows`."""
    n = len(position)
    splats = empty_splats(n, 1 if rest is None else 1 + rest.shape[1])
    good = np.empty(n, bool)
    for start in range(0, n, ROWS_PER_STEP):
        part = slice(start, start + ROWS_PER_STEP)
        good[part] = activate_rows(
            splats, part, position[part], log_scale[part], turn[part], logit[part], base[part],
            None if rest is None else rest[part],
        )  # fmt: skip
    return splats, good


def without_broken(path, splats, good, max_broken):
    """Return the usable splats, a note on the others, if any, in a list, and their number."""
    count = len(good)
    broken = count - int(np.count_nonzero(good))
    if not broken:
        return splats, [], 0
    require_few_broken(path, broken, count, max_broken)
    note = f"dropped {_share(broken, count)} with NaN, infinite or absurd values"
    return splats.take(good), [note], broken


def require_few_broken(path, broken, count, max_broken):
    """Raise InputError if too many of the splats of a file are unusable, or all of them."""
    if broken > max_broken * count or broken == count:
        raise InputError(
            f"{path} has {_share(broken, count)} with NaN, infinite or absurd values; at most "
            f"{100 * MAX_BROKEN_SHARE:g} % are tolerated; export the capture again"
        )


def _share(broken, count):
    return f"{broken} of {count} splats ({100 * broken / count:.3g} %)"


def require_believable(path, count, size):
    """Raise InputError unless `size` bytes of compressed file can hold `count` splats.

    Real files take ten bytes a splat and more. A file of a few kilobytes that unpacks to gigabytes
    is an attack or damage. The check keeps allocated memory in proportion to the file.
    """
    if count < 1:
        raise InputError(f"{path} holds {count} splats; it must hold some; export it again")
    if count > max(FREE_COUNT, size):
        raise InputError(
            f"{path} promises {count} splats in {size} bytes; a splat takes a byte at the very "
            "least; the file is damaged, export it again"
        )
