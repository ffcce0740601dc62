"""Heights of the ground from the captured pictures: heights at which the pictures agree.

The depth of trained splats is off by a centimetre, more than most puddles are deep. Their pictures
are not: seen at its right height, a speck of the ground has the same brightness from every camera
(the plane sweep of Collins 1996, about a first guess). Heights are tried in steps, brightness is
compared over patches, and the means over patches are weighted by how sharply the agreement peaks.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from rainsim.jit import cpu_kernel, prange
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS
from rainsim.raster import Rasterizer, prepare
from rainsim.scene.cameras import resize_to
from rainsim.scene.view import lens_array
from rainsim.surface.views import NEAR, asked_of, has_thin_splats

WIDTH = 648  # px of the pictures, about that of most training
TEXTURE = 4.0  # px, deviation of what is subtracted: light and shade are no texture
DARK = 0.02  # linear light below which noise decides
CELL = 0.04  # m, of the places whose height is found
# Of each pass: steps to either side, their height [m], patches' deviation, the means' deviation and
# the height by which a patch may be off them [m].
PASSES = ((12, 4e-3, 0.08, 0.12, 6e-3), (8, 1.5e-3, 0.03, 0.07, 4e-3))
DETAIL = 0.09  # m, deviation of what the means leave of the ground's forms
LEVEL = 0.8  # cosine to the vertical of the surface that is ground
GUESS_OFF, GUESS_WIDTH = 0.1, 0.08  # m off the splats' height that it may be; m, of its mean
LEAST_COSINE = np.float32(0.15)  # to the normal: who looks along a surface sees too little
UP = np.array([0, 0, 1], np.float32)
USUAL_AWAY = np.float32(2.5)  # m, from which on a camera counts the less the farther it is
RIM = 8  # px of a picture's edge that are not used
ENOUGH = 1.0  # weight of the cameras from which on a place is known
BY_CHANCE = 5.0  # cameras, so many of which agree on any height by chance
LEAST_SIGMA, MOST_SIGMA = 1.5e-3, 0.04  # m of a patch's height
ROUNDS = 2  # in which patches that are off the mean lose their weight


class TexturePicture(NamedTuple):
    """A picture of the capture, in metres of the ground frame; a kernel's bundle."""

    matrix: np.ndarray  # (3, 4) float32: camera frame from ground frame
    eye: np.ndarray  # (3,) float32
    lens: np.ndarray  # (4,) float32: fx, fy, cx, cy [px]
    depth: np.ndarray  # (height, width) float32 [m]
    texture: np.ndarray  # (height, width) float32: log luminance without its mean around


class GroundSweep:
    """The pictures of a capture with cameras, in which heights of its ground are tried.

    The heights of `surface` are the first guess. `thin` says whether the capture's splats are flat:
    then they show finer forms than the pictures tell.
    """

    def __init__(self, scene, surface):
        frame, self._pictures = scene.ground_frame, []
        self.thin = has_thin_splats(scene.splats)
        level = (surface.normal[:, 2] > LEVEL) & (surface.flat > 0.3)
        self._guess = surface.position[level].astype(np.float64)
        unit, rasterizer = np.float32(frame.meters_per_unit), Rasterizer(prepare(scene.splats))
        for camera in asked_of(scene.cameras):
            camera = resize_to(camera, min(WIDTH, camera.width))
            layers = rasterizer.draw(camera, NEAR / frame.meters_per_unit)
            placed = frame.camera_in_ground(camera)
            self._pictures.append(TexturePicture(
                np.ascontiguousarray(placed.camera_from_world[:3], np.float32),
                placed.position.astype(np.float32),
                lens_array(camera),
                layers.depth * unit, _texture(layers.color, layers.alpha),
            ))  # fmt: skip

    def heights(self, grid, start, wanted):
        """Return the height of the ground in the cells of a map [m], and how far it is smoothed.

        `start` is a first guess [m], within some centimetres, `wanted` the cells whose height is
        asked for: the others are left as they are. All are maps of shape (ny, nx); the pictures'
        means have smoothed a height by 0 to 1.
        """
        times = max(1, round(CELL / grid.spacing))
        cell = times * grid.spacing
        coarse, share = _coarser(np.where(wanted, start, 0), times), _coarser(wanted * 1.0, times)
        height = np.where(share > 0, coarse / np.maximum(share, 1e-6), 0)
        height = self._guessed(height, grid.origin, cell)
        x = grid.origin[0] + (np.arange(height.shape[1]) + 0.5) * cell
        y = grid.origin[1] + (np.arange(height.shape[0]) + 0.5) * cell
        sure = np.zeros(height.shape)
        for count, step, patch, around, off in PASSES:
            offsets = (step * np.arange(-count, count + 1)).astype(np.float32)
            found, sigma = self._tried(x, y, height, share > 0.5, offsets, patch / cell)
            mean, weight = _mean(found, sigma, around / cell, off)
            sure = weight / (weight + 1 / MOST_SIGMA**2)
            height = height + sure * (mean - height)
        # Where little was seen the guess stays, moved as what was seen around it.
        moved = _spread(_finer(height, times, grid.shape) - start, _finer(sure, times, grid.shape))
        sure = np.where(wanted, _finer(sure, times, grid.shape), 0)
        seen = _finer(height, times, grid.shape)
        if self.thin:  # the forms of a hand's breadth are those of the splats
            width = DETAIL / grid.spacing
            share = np.maximum(ndimage.gaussian_filter(wanted * 1.0, width), 1e-3)
            mean = ndimage.gaussian_filter(np.where(wanted, start, 0), width) / share
            seen += start - mean
        result = sure * seen + (1 - sure) * (start + moved)
        smoothed = np.zeros_like(start) if self.thin else sure.astype(np.float32)
        return np.where(wanted, result, start).astype(np.float32), smoothed

    def _guessed(self, height, origin, cell):
        """Return heights (ny, nx) with those of the surface where it lies about there."""
        row, column = (np.floor((self._guess[:, k] - origin[k]) / cell).astype(int) for k in (1, 0))
        inside = (row >= 0) & (column >= 0) & (row < height.shape[0]) & (column < height.shape[1])
        row, column, z = row[inside], column[inside], self._guess[inside, 2]
        near = np.abs(z - height[row, column]) < GUESS_OFF
        place, z = (row * height.shape[1] + column)[near], z[near]
        count = np.bincount(place, minlength=height.size).reshape(height.shape)
        total = np.bincount(place, z, minlength=height.size).reshape(height.shape)
        width = GUESS_WIDTH / cell
        share = ndimage.gaussian_filter(np.minimum(count, 1.0), width)
        change = np.where(count > 0, total / np.maximum(count, 1) - height, 0)
        return height + ndimage.gaussian_filter(change, width) / np.maximum(share, 1e-2)

    def _tried(self, x, y, height, wanted, offsets, patch):
        """Return the best of some heights in each place, and its standard deviation [m]."""
        place = np.stack([*np.meshgrid(x, y), height], -1).astype(np.float32)
        variance, weight, count = variances(place, UP, wanted, offsets, self._pictures)
        known = (weight > ENOUGH) & (count > BY_CHANCE)
        share = np.maximum(ndimage.gaussian_filter(weight * known, patch), 1e-6)
        for k in range(len(offsets)):
            variance[k] = ndimage.gaussian_filter(variance[k] * weight * known, patch) / share
        best = np.argmin(variance, axis=0)
        inner = np.clip(best, 1, len(offsets) - 2)
        below, at, above = (np.take_along_axis(variance, inner[None] + k, 0)[0] for k in (-1, 0, 1))
        bend, step = np.maximum(below - 2 * at + above, 1e-12), float(offsets[1] - offsets[0])
        found = height + offsets[inner] + step * np.clip(0.5 * (below - above) / bend, -0.5, 0.5)
        weight = np.maximum(weight, 0.3) * np.maximum(1 - BY_CHANCE / np.maximum(count, 1), 1e-3)
        sigma = step * np.sqrt(2 * np.maximum(at, 1e-9) / bend / weight)
        sigma[~known | (best != inner)] = np.inf
        return found, sigma


def can_tell(scene, grid, floor):
    """Return whether pictures enough may look at a map for `GroundSweep` to find a height there.

    `floor` is the height of its lowest ground [m]. The answer follows from where the cameras stand.
    """
    asked = asked_of(scene.cameras)
    eyes = scene.ground_frame.to_ground(np.array([camera.position for camera in asked]))
    first, last = np.array(grid.origin), np.array(grid.origin) + grid.size
    gap = np.maximum(np.maximum(first - eyes[:, :2], eyes[:, :2] - last), 0)
    far = (eyes[:, 2] - floor + 2 * GUESS_OFF) / LEAST_COSINE
    return np.count_nonzero(np.linalg.norm(gap, axis=1) < far) > BY_CHANCE


def _texture(color, alpha):
    """Return the log luminance of a picture (height, width) without its mean around.

    The mean is of what there is: the edge of the capture is no speck of its ground.
    """
    light = color @ LUMINANCE_WEIGHTS.astype(np.float32) / np.maximum(alpha, np.float32(0.1))
    log = np.log(np.maximum(light, np.float32(DARK)))
    share = np.maximum(ndimage.gaussian_filter(alpha, TEXTURE), np.float32(1e-3))
    return alpha * (log - ndimage.gaussian_filter(alpha * log, TEXTURE) / share)


def _mean(found, sigma, around, off):
    """Return weighted means of heights over their surroundings, and the weights [1/m2]."""
    weight = np.where(sigma < MOST_SIGMA, 1 / (sigma**2 + LEAST_SIGMA**2), 0)
    total = ndimage.gaussian_filter(weight, around)
    mean = ndimage.gaussian_filter(weight * found, around) / np.maximum(total, 1e-9)
    for _ in range(ROUNDS):
        kept = weight / (1 + ((found - mean) / off) ** 2) ** 2
        total = ndimage.gaussian_filter(kept, around)
        mean = ndimage.gaussian_filter(kept * found, around) / np.maximum(total, 1e-9)
    return mean, total


def _spread(change, sure):
    """Return a change (ny, nx) filled from sure cells around each, in ever wider circles."""
    total, weight = np.zeros_like(change), np.zeros_like(change)
    for k, width in enumerate((4, 16, 64)):
        share = 1e-3**k
        total += share * ndimage.gaussian_filter(change * sure, width)
        weight += share * ndimage.gaussian_filter(sure, width)
    return total / np.maximum(weight, 1e-12)


def _coarser(values, times):
    """Return the means over blocks of `times` by `times` cells; the last ones may be cut."""
    padded = np.pad(values, [(0, -n % times) for n in values.shape], mode="edge")
    shape = padded.shape[0] // times, times, padded.shape[1] // times, times
    return padded.reshape(shape).mean(axis=(1, 3))


def _finer(values, times, shape):
    """Return values of blocks interpolated between their middles, (ny, nx)."""
    row, column = ((np.arange(n) + 0.5) / times - 0.5 for n in shape)
    place = np.meshgrid(row, column, indexing="ij")
    return ndimage.map_coordinates(values, place, order=1, mode="nearest")


@cpu_kernel
def try_offsets(position, normal, wanted, offsets, picture: TexturePicture, sums_out, count_out):
    """Add a picture's texture at some offsets along a normal to the sums of each place.

    position : float32 array (ny, nx, 3) [m]
    normal : float32 array (3,). Unit, towards the cameras that count.
    wanted : bool array (ny, nx)
    offsets : float32 array (k,) [m]
    picture : TexturePicture
    sums_out : float32 array (3, k, ny, nx). Sums of the weights, and of the
        texture and of its square with these.
    count_out : uint16 array (ny, nx). One more where the picture shows it.
    """
    rows, columns = picture.texture.shape
    m, lens, eye, texture = picture.matrix, picture.lens, picture.eye, picture.texture
    half = np.float32(0.5)
    step_x = m[0, 0] * normal[0] + m[0, 1] * normal[1] + m[0, 2] * normal[2]
    step_y = m[1, 0] * normal[0] + m[1, 1] * normal[1] + m[1, 2] * normal[2]
    step_z = m[2, 0] * normal[0] + m[2, 1] * normal[1] + m[2, 2] * normal[2]
    for j in prange(position.shape[0]):
        for i in range(position.shape[1]):
            if not wanted[j, i]:
                continue
            x, y, z = position[j, i, 0], position[j, i, 1], position[j, i, 2]
            dx, dy, dz = eye[0] - x, eye[1] - y, eye[2] - z
            away = np.sqrt(dx * dx + dy * dy + dz * dz)
            facing = dx * normal[0] + dy * normal[1] + dz * normal[2]
            if not facing > LEAST_COSINE * away:
                continue
            px = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            py = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            pz = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
            if not pz > np.float32(0.2):
                continue
            u, v = lens[0] * px / pz + lens[2], lens[1] * py / pz + lens[3]
            if not (u >= RIM and v >= RIM and u < columns - RIM and v < rows - RIM):
                continue
            slack = np.float32(0.03) + np.float32(0.03) * pz + offsets[-1]
            if picture.depth[int(v), int(u)] < pz - slack:
                continue
            # At its highest and lowest it must be seen on the ground, not beside it: nothing looks
            # the same from everywhere. What stands before the ground colours the means beside it.
            outer = slack + offsets[-1] * away / facing
            clear = True
            for k in (0, len(offsets) - 1):
                far = pz + step_z * offsets[k]
                a = int(lens[0] * (px + step_x * offsets[k]) / far + lens[2])
                b = int(lens[1] * (py + step_y * offsets[k]) / far + lens[3])
                if a >= 0 and b >= 0 and a < columns and b < rows:
                    clear = clear and picture.depth[b, a] < far + outer
            a, b = int(u), int(v)
            slope = (step_x * px + step_y * py + step_z * pz) / pz
            for da, db in ((-RIM, 0), (RIM, 0), (0, -RIM), (0, RIM)):
                along = (
                    slope + step_x * np.float32(da) / lens[0] + step_y * np.float32(db) / lens[1]
                )
                if along * slope > 0:
                    clear = clear and picture.depth[b + db, a + da] > pz * slope / along - slack
            if not clear:
                continue
            count_out[j, i] += np.uint16(1)
            near = USUAL_AWAY / max(away, USUAL_AWAY)
            weight = facing / away * near * near
            for k in range(len(offsets)):
                far = pz + step_z * offsets[k]
                u = lens[0] * (px + step_x * offsets[k]) / far + lens[2] - half
                v = lens[1] * (py + step_y * offsets[k]) / far + lens[3] - half
                a, b = int(u), int(v)
                if not (u >= 0 and v >= 0 and a < columns - 1 and b < rows - 1):
                    continue
                f, g = u - np.float32(a), v - np.float32(b)
                top = texture[b, a] + f * (texture[b, a + 1] - texture[b, a])
                low = texture[b + 1, a] + f * (texture[b + 1, a + 1] - texture[b + 1, a])
                value = top + g * (low - top)
                sums_out[0, k, j, i] += weight
                sums_out[1, k, j, i] += weight * value
                sums_out[2, k, j, i] += weight * value * value


def variances(position, normal, wanted, offsets, pictures):
    """Return how much pictures differ at offsets along a normal, and their weights.

    Arguments are as for `try_offsets`. The variance is of shape (k, ny, nx), float32; the weight,
    float32, and the number of the pictures that show a place, uint16, are of shape (ny, nx).
    """
    sums = np.zeros((3, len(offsets), *wanted.shape), np.float32)
    count = np.zeros(wanted.shape, np.uint16)
    for picture in pictures:
        try_offsets(position, normal, wanted, offsets, picture, sums, count)
    total = np.maximum(sums[0], 1e-6)
    return np.maximum(sums[2] / total - (sums[1] / total) ** 2, 0), sums[0].min(axis=0), count
