"""Splashes on a CUDA device: twin of `rainsim.particles.splash_pass`.

A thread takes an impact and decides whether it splashes in view; then a group of lanes takes each
that does and lists its droplets and the pieces of its crown, a lane for each. Another group draws
each piece.
"""

import numpy as np

from rainsim.constants import ZERO
from rainsim.cuda import drops
from rainsim.cuda.driver import fetch
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import cuda, cuda_kernel
from rainsim.cuda.particles.streaks import view_of
from rainsim.cuda.warp import GROUP, GROUPS, THREADS, claim_row
from rainsim.particles import splash
from rainsim.particles.crown import FINE_PIXEL, LONGEST_JET, crown_life
from rainsim.particles.splash_pass import (
    WaterDepth,
    list_splash,
    recent_windows,
    seen_at,
    smallest_drop,
)
from rainsim.particles.streaks import draw_lines
from rainsim.rain.heightfield import GROUND

ROOM = 2**18  # lines


@cuda.jit(device=True)
def still_shows(diameter, speed, under, age, pixel):
    """Tell whether an impact on water of a depth [m] splashes and may still show.

    Far splashes show while their crown stands, near ones longer. `pixel` is the width [m] of a
    pixel there.
    """
    if not splash.splashes_on(under, diameter, speed):
        return False
    standing = under > splash.WET_DEPTH and age < crown_life(diameter, speed)
    return standing or (pixel < FINE_PIXEL and age < max(splash.longest_flight(speed), LONGEST_JET))


@cuda_kernel
def list_splashes(impacts, velocity, sent, scene, water, count_out, lines_out):
    """List the droplets, crowns and jets of listed impacts that splash in view.

    impacts : ImpactList
    sent, scene : ShutterView and SceneDepth
    water : WaterDepth. Its film a device array of shape (1,), float64 [m].
    count_out : int32 device array (1,). Raised by the number of lines, also of
        those for which there is no room.
    """
    chosen = cuda.shared.array(THREADS, np.int32)
    pixels = cuda.shared.array(THREADS, np.float32)
    depths = cuda.shared.array(THREADS, np.float64)  # of the water there
    many = cuda.shared.array(1, np.int32)
    time, exposure = sent.time[0], sent.exposure[0]
    values, labels = impacts.values, impacts.labels
    group = cuda.threadIdx.y
    thread = group * GROUP + cuda.threadIdx.x
    listed = min(impacts.found[0], impacts.ids.shape[0])
    for begin in range(cuda.blockIdx.x * THREADS, listed, cuda.gridDim.x * THREADS):
        if thread == 0:
            many[0] = 0
        cuda.syncthreads()
        n, under, wanted, pixel = begin + thread, water.film[0], False, ZERO
        if n < listed:
            x, y, z = values[n, drops.X], values[n, drops.Y], values[n, drops.Z]
            wanted, pixel = seen_at(x, y, z, sent, scene)
        if wanted:
            if labels[n, drops.KIND] == GROUND:
                under += np.float64(water.ground[labels[n, drops.ROW], labels[n, drops.COLUMN]])
            speed, age = abs(velocity[labels[n, drops.CLASS], 2]), time - values[n, drops.TIME]
            wanted = still_shows(values[n, drops.DIAMETER], speed, under, age, pixel)
        at = claim_row(many, 0, wanted)
        if wanted:
            chosen[at], pixels[at], depths[at] = n, pixel, under
        cuda.syncthreads()
        for at in range(group, many[0], THREADS // GROUP):
            n = chosen[at]
            b = labels[n, drops.CLASS]
            impact = splash.Impact(
                impacts.ids[n], values[n, drops.X], values[n, drops.Y], values[n, drops.Z],
                velocity[b, 0], velocity[b, 1], abs(velocity[b, 2]), values[n, drops.DIAMETER],
                depths[at], time - values[n, drops.TIME],
            )  # fmt: skip
            list_splash(impact, pixels[at], exposure, count_out, lines_out)
        cuda.syncthreads()


@cuda_kernel
def draw_list(count, lines, sent, scene, picture):
    """Draw listed lines into `picture`, a group of lanes for each."""
    first = cuda.blockIdx.x * cuda.blockDim.y + cuda.threadIdx.y
    draw_lines(
        lines, first, min(count[0], lines.shape[0]), cuda.gridDim.x * cuda.blockDim.y,
        view_of(sent), scene, picture,
    )  # fmt: skip


class Splashes:
    """The splashes of a rain in a picture, drawn on a CUDA device.

    streaks : cuda.particles.streaks.Streaks. Of the same picture; its camera,
        times and what it has read of the depth are used, so it is drawn before.
    impacts : Impacts. Of the drops whose splashes may show.
    """

    def __init__(self, streaks):
        self._streaks, self.impacts = streaks, drops.Impacts()
        self._now = FrameUniforms({"film": ((1,), np.float64), "count": ((1,), np.int32)})
        self.lines = cuda.device_array((ROOM, 7), np.float64)
        self.alpha = cuda.device_array(streaks.alpha.shape, np.float32)

    def draw(self, field, surfaces, camera, time, exposure, water, film):
        """Queue the picture; waits. Parameters are those of `draw_splashes`.

        water : float32 device array (ny, nx) [m]. On the ground.
        """
        seen, smallest = self._streaks, smallest_drop(film)
        windows = recent_windows(field, surfaces, camera, time, exposure, smallest, smallest)
        self.impacts.list(field, windows, seen)
        self._now.update(film=film)
        while (count := self._list(water)) > len(self.lines):
            self.lines = None  # freed before more is asked for
            self.lines = cuda.device_array((2 * count, 7), np.float64)
        draw_list[drops.BLOCKS, GROUPS](
            self._now["count"], self.lines, seen.view, seen.scene, seen.picture
        )
        seen.resolve(self.alpha)

    def _list(self, water):
        """Queue the listing of the splashes in view; return how many lines they have."""
        self._now.send()  # which blanks the count
        seen, count = self._streaks, self._now["count"]
        there = WaterDepth(water, self._now["film"]), count, self.lines
        shown, listed = (seen.view, seen.scene), self.impacts.listed
        list_splashes[drops.BLOCKS, GROUPS](listed, seen.field.velocity, *shown, *there)
        if seen.drips is not None:
            seen.drips.gather(seen.surfaces, *shown, *there)
        return int(fetch(count)[0])
