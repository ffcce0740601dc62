"""The pages of a big capture in the light and the wetness of a `WetScene`'s present time.

What is found once for the whole scene, from a coarse level of it, is carried over to the splats of
a page from the nearest splat of that level: the light of the captured sun, the colour without
gloss, and whether hardly any camera saw it. All else follows from the page's own splats.
"""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from rainsim.constants import SH_0
from rainsim.daylight.kept_light import under_clouds
from rainsim.lod.paged import Page, PagedRasterizer
from rainsim.lod.room import room_for
from rainsim.raster import prepare
from rainsim.scene.harmonics import padded
from rainsim.shading.diffuse import level_cells, share_of_level, without_gloss
from rainsim.shading.wet_ground_mirror import as_in_level_picture, in_level_picture

STANDING = 1.4  # times the threshold in what wet ground mirrors: with coarser levels lamps fade


class PagedScene:
    """Rasterizers of a big capture: of the whole, of standing things, and of all as captured.

    backdrop : Backdrop. Of the scene, whose `pages` are drawn.
    gain : array (n, 3) or None. See `PresentSplats`, of the splats that
        `backdrop` kept.
    diffuse : array (n, 3) or None. As `gain`.
    badly_placed : bool array (n,). As `gain`.
    reach, lawn : float32 array (ny, nx). See `diffuse.level_cells`.
    render : RenderConfig
    rasterizer_of : callable
    whole, standing, captured : PagedRasterizer
    drawer : Rasterizer. Of all three.
    """

    def __init__(
        self, backdrop, gain, diffuse, badly_placed, terrain, reach, lawn, render, rasterizer_of
    ):
        scene = backdrop.scene
        self._scene, self._backdrop = scene, backdrop
        self._terrain, self._gain, self._diffuse = terrain, gain, diffuse
        self._bad = badly_placed
        self._cells = None if diffuse is None else level_cells(terrain, reach, lawn)
        self._nearest, self._colors = cKDTree(scene.splats.position), (0.0, 0.0)
        self._most = scene.splats.sh.shape[1]
        pages = scene.pages
        pages.limit(render.memory)
        room = room_for(pages)
        self.drawer = drawer = rasterizer_of(room.prepared)  # one working memory for all three
        how = render.detail, self._most, lambda prepared: drawer
        own = {"compensate": scene.antialiased, "room": room}
        self.whole = PagedRasterizer(pages, self._page, *how, **own)
        self.standing = PagedRasterizer(pages, self._standing_page, *how, STANDING, **own)
        self.captured = PagedRasterizer(pages, self._captured_page, *how, **own)

    def take_colors(self, colors):
        """Take over the colours of a state, see `PresentSplats.state`."""
        if colors != self._colors:
            self._colors = colors
            self.whole.take_colors()
            self.standing.take_colors()

    def put_actors(self, actors, frame):
        """Draw the actors as they are now with the pages."""
        front = standing = captured = None
        if actors.splats is not None:
            front = captured = _numbered(prepare(actors.splats), actors)
            standing = as_in_level_picture(prepare(actors.splats), frame)
        self.whole.recolor(front)
        self.captured.recolor(captured)
        self.standing.recolor(standing)

    def read_ahead(self, camera, near):
        """Begin to read the chunks that a camera needs, on another thread."""
        self.whole.read_ahead(camera, near)

    def _page(self, splats):
        splats, bad = self._present(splats)
        if not bad.any():
            return Page(prepare(splats))
        return Page(prepare(splats.take(~bad)), prepare(splats.take(bad)))

    def _standing_page(self, splats):
        splats, bad = self._present(splats)
        prepared = prepare(splats.take(~bad))
        return Page(in_level_picture(prepared, self._terrain, self._scene.ground_frame))

    def _captured_page(self, splats):
        return Page(prepare(self._padded(splats)))

    def _padded(self, splats):
        return replace(splats, sh=padded(splats.sh, self._most))

    def _present(self, splats):
        """Return the splats of a run in the present colours, and which of them are badly placed."""
        frame = self._scene.ground_frame
        splats = self._padded(splats)
        splats = splats.take(~self._backdrop.is_sky(splats.position))
        bad = np.zeros(len(splats), np.bool_)
        if self._gain is None and self._diffuse is None and not self._bad.any():
            return splats, bad
        near = self._nearest.query(splats.position)[1]
        bad = self._bad[near]
        clouds, wet = self._colors
        if wet > 0:
            level = share_of_level(splats, frame, self._terrain, self._cells)
            splats = without_gloss(splats, self._diffuse_of(splats, near), level * np.float32(wet))
        gain = None if self._gain is None else self._gain[near]
        return under_clouds(splats, gain, clouds), bad

    def _diffuse_of(self, splats, near):
        """Return the colours of splats without gloss, as far from their own as the nearest ones."""
        whole = self._scene.splats.sh[near, 0]
        gloss = self._diffuse[near].astype(np.float32) - np.float32(SH_0) * whole - np.float32(0.5)
        return np.float32(0.5) + np.float32(SH_0) * splats.sh[:, 0] + gloss


def _numbered(prepared, actors):
    """Return prepared splats of actors, numbered as `ActorSplats.numbers` counts them."""
    order = np.where(prepared.order >= 0, prepared.order + np.int32(actors.first), prepared.order)
    return replace(prepared, order=order.astype(np.int32))
