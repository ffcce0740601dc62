"""Splashes on a CUDA device: twin of `rainsim.particles.splash_pass`.

A thread takes an impact and decides whether it splashes in view; then a group of lanes takes each
that does and lists its droplets and the pieces of its crown, a lane for each. Another group draws
each piece.
"""

import numpy as np

from rainsim.cuda import drops
from rainsim.cuda.frame_uniforms import FrameUniforms
from rainsim.cuda.jit import SIMULATED, cuda, cuda_kernel
from rainsim.cuda.particles.streaks import view_of
from rainsim.cuda.warp import GROUP, GROUPS, THREADS, claim_row
from rainsim.particles import splash
from rainsim.particles.crown import FINE_PIXEL, LONGEST_JET, crown_life
from rainsim.particles.line_raster import CX, FX, FY
from rainsim.particles.splash_pass import MARGIN, WaterDepth, list_splash
from rainsim.particles.streaks import draw_lines
from rainsim.rain.heightfield import GROUND

ROOM = 2**18  # lines
NEAREST = 0.05  # m, as on the CPU


@cuda.jit(device=True)
def seen_at(x, y, z, sent, scene):
    """Return the depth [m] at which the camera sees a splash there; negative if it does not."""
    rotation, lens = sent.rotation, sent.lens
    x, y, z = x - sent.eye[0], y - sent.eye[1], z - sent.eye[2]
    deep = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z
    if not deep > NEAREST:
        return -1.0
    for axis in range(2):
        across = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
        focal, centre = np.float64(lens[FX + axis]), np.float64(lens[CX + axis])
        count = scene.width if axis == 0 else scene.height
        if focal * across + centre * deep <= -focal * MARGIN:
            return -1.0
        if focal * across + (centre - count) * deep >= focal * MARGIN:
            return -1.0
    return deep


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


@cuda.jit(device=True)
def focal_of(lens):
    """Return the longer focal length of a lens [px]."""
    return max(np.float64(lens[FX]), np.float64(lens[FY]))


@cuda_kernel
def list_splashes(
    lists, per_list, velocity, sent, scene, water, least, count_out, lines_out
):  # fmt: skip
    """List the droplets, crowns and jets of listed impacts that splash in view.

    sent : ShutterView
    water : WaterDepth. Its film a device array of shape (1,), float64 [m].
    least : int32 device array (1,). The smallest class of drops that may splash.
    count_out : int32 device array (1,). Raised by the number of lines, also of
        those for which there is no room.
    """
    chosen = cuda.shared.array(THREADS, np.int32)
    depths = cuda.shared.array((THREADS, 2), np.float64)  # of the scene and of the water there
    many = cuda.shared.array(1, np.int32)
    time, exposure, focal = sent.time[0], sent.exposure[0], focal_of(sent.lens)
    values, labels = lists.values, lists.labels
    group = cuda.threadIdx.y
    thread = group * GROUP + cuda.threadIdx.x
    which, block = cuda.blockIdx.x // per_list, cuda.blockIdx.x % per_list
    listed = min(lists.found[which], lists.ids.shape[1])
    for begin in range(block * THREADS, listed, per_list * THREADS):
        if thread == 0:
            many[0] = 0
        cuda.syncthreads()
        n, deep, under, wanted = begin + thread, -1.0, water.film[0], False
        if n < listed:
            b, age = labels[which, n, drops.CLASS], time - values[which, n, drops.TIME]
            if b >= least[0] and -exposure <= age < splash.LONGEST_LIFE:
                deep = seen_at(
                    values[which, n, drops.X],
                    values[which, n, drops.Y],
                    values[which, n, drops.Z],
                    sent,
                    scene,
                )
            if deep > 0.0:
                if labels[which, n, drops.KIND] == GROUND:
                    row, column = labels[which, n, drops.ROW], labels[which, n, drops.COLUMN]
                    under += np.float64(water.ground[row, column])
                wanted = still_shows(
                    values[which, n, drops.DIAMETER], abs(velocity[b, 2]), under, age, deep / focal
                )
        at = claim_row(many, 0, wanted)
        if wanted:
            chosen[at], depths[at, 0], depths[at, 1] = n, deep, under
        cuda.syncthreads()
        for at in range(group, many[0], THREADS // GROUP):
            n = chosen[at]
            b = labels[which, n, drops.CLASS]
            impact = splash.Impact(
                lists.ids[which, n], values[which, n, drops.X], values[which, n, drops.Y],
                values[which, n, drops.Z], velocity[b, 0], velocity[b, 1], abs(velocity[b, 2]),
                values[which, n, drops.DIAMETER],
                depths[at, 1], time - values[which, n, drops.TIME],
            )  # fmt: skip
            list_splash(impact, depths[at, 0] / focal, exposure, count_out, lines_out)
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
    recent : cuda.rain.impact_history.RecentImpacts. What falls until the
        exposure's end.
    """

    def __init__(self, streaks, recent):
        self._streaks, self._recent = streaks, recent
        self._now = FrameUniforms({
            "film": ((1,), np.float64), "least": ((1,), np.int32), "count": ((1,), np.int32),
        })  # fmt: skip
        self.lines = cuda.device_array((ROOM, 7), np.float64)
        self.alpha = cuda.device_array(streaks.alpha.shape, np.float32)

    def update(self, field, film):
        """Set rain and water of the next picture; arguments as `draw_splashes` has them."""
        smallest = splash.SMALLEST_ON_FILM if film > splash.WET_DEPTH else splash.SMALLEST_SPLASH
        least = np.searchsorted(field.spectrum.edges[1:], smallest, side="right")
        self._now.update(film=film, least=least)

    def draw(self, water):
        """Queue the picture, over water of a depth, float32 device array (ny, nx) [m]; waits."""
        while (count := self._list(water)) > len(self.lines):
            self.lines = None  # freed before more is asked for
            self.lines = cuda.device_array((2 * count, 7), np.float64)
        seen = self._streaks
        draw_list[drops.BLOCKS, GROUPS](
            self._now["count"], self.lines, seen.view, seen.scene, seen.picture
        )
        seen.resolve(self.alpha)

    def _list(self, water):
        """Queue the listing of the splashes in view; return how many lines they have."""
        self._now.send()  # which blanks the count
        recent, view, scene = self._recent, self._streaks.view, self._streaks.scene
        water, count = WaterDepth(water, self._now["film"]), self._now["count"]
        per_list = 2 if SIMULATED else -(-recent.room // THREADS)
        list_splashes[per_list * len(recent.lists.found), GROUPS](
            recent.lists, per_list, self._streaks.now["velocity"], view, scene, water,
            self._now["least"], count, self.lines,
        )  # fmt: skip
        if (drips := self._streaks.drips) is not None:
            drips.gather(recent.surfaces, view, scene, water, count, self.lines)
        return int(count.copy_to_host()[0])
