"""Leaving the capture: the share of a picture that its cameras hardly saw, or saw from behind.

A capture is what its cameras saw. Elsewhere it has holes, haze and undersides that training put
there at will.
"""

import numpy as np

from rainsim.scene.cameras import resize_to
from rainsim.shading.visibility import views_of_splats

WIDTH = 162  # px of the pictures that are looked at
LEAST_SEEN = 2  # cameras: what fewer saw is badly seen
BEHIND = -0.1  # cosine between a surface as it is seen and the mean way to those cameras
MUCH = 0.2  # share of a picture that is said
HARDLY_SEEN = "was seen by hardly any camera of the capture"
MOST_LOOKED_AT = 48  # cameras of a path, evenly spaced


class Leaving:
    """Tells how much of pictures is badly seen.

    capture : DrawnCapture
    views : Views. Of the scene's splats.
    """

    def __init__(self, capture, views):
        self._capture = capture
        self._few, self._toward = views.seen < LEAST_SEEN, views.toward

    def share(self, camera):
        """Return the share of a picture that is badly seen, 0 to 1.

        Those are pixels whose splat, where half of the light is stopped, fewer than LEAST_SEEN of
        the capture's cameras saw, or most of them from the other side of the surface.

        camera : Camera. In the capture frame.
        """
        layers = self._capture.layers(resize_to(camera, WIDTH), hit=True)
        shows = (layers.hit >= 0) & (layers.hit < len(self._few))  # actors lie behind
        which, normal = layers.hit[shows], layers.normal[shows]
        facing = normal @ camera.camera_from_world[:3, :3].astype(np.float32)
        behind = np.einsum("ij,ij->i", facing, self._toward[which].astype(np.float32)) < BEHIND
        return float(np.count_nonzero(behind | self._few[which]) / shows.size)


def leaving_of(wet_scene):
    """Return the `Leaving` of a WetScene; None where nothing is known: it has no captured cameras.

    Splats of the captured sky are neither counted nor drawn: little is known of them.
    """
    scene = wet_scene.scene
    views = None if scene.pages is not None else views_of_splats(scene)
    return None if views is None else Leaving(wet_scene.capture, views)


def leaving_notes(wet_scene, cameras):
    """Return notes on cameras that leave the capture, a tuple of str.

    wet_scene : WetScene
    cameras : sequence of Camera. Of all frames, or one for all, in the capture
        frame.
    """
    own = {camera.position.tobytes() for camera in wet_scene.scene.cameras}
    if all(camera.position.tobytes() in own for camera in cameras):
        return ()
    leaving = leaving_of(wet_scene)
    if leaving is None:
        return ()
    step = -(-len(cameras) // MOST_LOOKED_AT)
    shares = [leaving.share(camera) for camera in cameras[::step]]
    much = [k for k, share in enumerate(shares) if share > MUCH]
    if not much:
        return ()
    worst = int(np.argmax(shares))
    where, begins = "the picture", ""
    if len(cameras) > 1:
        where = f"frame {worst * step}"
        begins = f", and more than {MUCH:.0%} from frame {much[0] * step} on"
    return (
        f"THE CAMERA LEAVES THE CAPTURE: {shares[worst]:.0%} of {where} {HARDLY_SEEN}, or only "
        f"from behind{begins}; stay nearer to where it was taken",
    )
