"""Which level of detail of each group of splats a picture draws, see `rainsim.splatting.detail`.

The choice follows from the camera, the size of its picture and the capture, chunk by chunk: a chunk
knows the sizes for which its level is the right one.
"""

from rainsim.constants import ONE
from rainsim.jit import cpu_kernel, device_function, prange
from rainsim.splatting.project import Frustum


@device_function
def resolved(reach, frustum):
    """Return the size [world units] of a pixel at the nearest centre of a group of splats.

    `reach` (6,) holds the lowest and highest x, y, z of the centres.
    """
    view, focal = frustum.camera_from_world, max(frustum.lens[0], frustum.lens[1])
    if frustum.orthographic:
        return ONE / focal
    z = view[2, 3]
    for k in range(3):
        z += min(view[2, k] * reach[k], view[2, k] * reach[3 + k])
    return max(z, frustum.near) / focal


@device_function
def is_drawn(span, reach, frustum, detail):
    """Return whether a chunk is at the level of detail that a picture draws.

    span : float32 array (2,) [world units]. Sizes from which on and below which
        it is.
    reach : float32 array (6,) [world units]. Lowest and highest x, y, z of the
        centres of its group.
    detail : float32 [px]. Size of what the picture does not resolve; 0: the
        finest level is drawn.
    """
    side = detail * resolved(reach, frustum)
    return span[0] <= side and side < span[1]


@cpu_kernel
def choose_levels(span, reach, frustum: Frustum, detail, seen_out):
    """Unmark the chunks of levels that are not drawn, see `prepared.PreparedSplats.span`.

    span, reach : array (chunks, 2) and (chunks, 6), float32
    detail : float32 [px]. What the picture resolves; 0: all splats are drawn.
    seen_out : bool array (chunks,)
    """
    for chunk in prange(len(span)):
        if seen_out[chunk]:
            seen_out[chunk] = is_drawn(span[chunk], reach[chunk], frustum, detail)
