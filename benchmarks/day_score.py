"""How far a picture of a rainy day is from the path-traced one: by region, scalars, a ladder.

All measures compare radiance whose mean over land (all but the sky) is LAND, or, where it says "as
is", the picture at the program's own brightness. Pictures are compared as shown: through the
program's tone curve, encoded as sRGB.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import structural_similarity

from benchmarks.suite import decibels
from rainsim.numerics.srgb import LUMINANCE_WEIGHTS, display, linear

LAND = 0.16  # mean luminance of land, as a camera's exposure has it
EDGE = 4  # px: nearer than that to the sky a pixel of leaves may show some of it
FEWEST = 40  # px: smaller regions are not measured
OPEN = 0.5  # openness from which ground counts as open
SPLIT = ("paving", "lawn", "wall", "tabletop")  # regions measured in and out of the sun, too
GROUND = ("paving", "puddle", "rim")
FILMS = ("paving", "puddle", "tabletop")  # regions whose gloss is measured
PATCHED = ("wall", "paving")  # regions whose patches are measured
# px: patches are smaller; and of the border of a region, left out; dim linear light of the capture.
PATCH, BORDER, DIM = 6, 3, 0.004
LADDER = ("as is", "shadows gone", "levels right", "colours right")
SCALARS = {
    "shadow": "cast shadow over open ground", "wall": "wall over paving",
    "under": "under the table over open", "zenith": "zenith over land",
    "film": "film over own zenith", "water": "puddle over own zenith",
    "spread": "level over views, deviation",
}  # fmt: skip


def shown(radiance):
    """Return the display values, 0 to 1, of a picture of radiance relative to display white.

    The program's tone curve has its shoulder above 1/2; then comes sRGB.
    """
    above = np.maximum(radiance, 0.5) - 0.5
    curve = np.where(radiance < 0.5, radiance, 0.5 + 0.5 * (1 - np.exp(-2 * above)))
    return np.clip(display(curve), 0, 1)


def luminance(radiance, mask=...):
    """Return the mean luminance of radiance over a mask."""
    return float((radiance @ LUMINANCE_WEIGHTS)[mask].mean())


def differences(shown_picture, shown_truth):
    """Return squared error, structural similarity and CIEDE2000 of each pixel of two pictures."""
    similar = structural_similarity(
        shown_truth, shown_picture, channel_axis=2, data_range=1, full=True
    )[1].mean(axis=-1)
    color = deltaE_ciede2000(rgb2lab(shown_truth), rgb2lab(shown_picture))
    return ((shown_picture - shown_truth) ** 2).mean(axis=-1), similar, color


def regions_of(labels):
    """Yield name and mask of all regions, those of SPLIT in and out of the sun, too.

    A pixel at the edge of a hedge shows leaves and sky at once, and three hundredths of sky double
    its light: "leaf, inner" keeps EDGE pixels from the sky.
    """
    land = ~labels.shows("sky")
    yield "all", np.ones_like(land)
    yield "land", land
    for name in ("paving", "puddle", "rim", "lawn", "wall", "tabletop", "leaf", "core", "box",
                 "glass", "sky"):  # fmt: skip
        mask = labels.shows(name)
        yield name, mask
        if name in SPLIT:
            yield f"{name}, sun", mask & labels.lit
            yield f"{name}, shade", mask & ~labels.lit
        if name == "leaf":
            yield "leaf, inner", mask & ~ndimage.binary_dilation(~land, iterations=EDGE)


def by_region(picture, truth, labels, brightness):
    """Return the measures of each region.

    Pictures of radiance, (height, width, 3); the truth's mean over land is LAND. `brightness` is
    the program's own, for "as is". The result is {region: {share, truth, ratio, psnr, as_is, ssim,
    color}} with luminances aligned on land.
    """
    aligned = align(picture, labels)
    squares, similar, color = differences(shown(aligned), shown(truth))
    own = ((shown(brightness * picture) - shown(truth)) ** 2).mean(axis=-1)
    found = {}
    for name, mask in regions_of(labels):
        if mask.sum() < FEWEST:
            continue
        level = luminance(truth, mask)
        found[name] = {
            "share": float(mask.mean()), "truth": level,
            "ratio": luminance(aligned, mask) / level, "psnr": decibels(squares[mask].mean()),
            "as_is": decibels(own[mask].mean()), "ssim": float(similar[mask].mean()),
            "color": float(color[mask].mean()),
        }  # fmt: skip
    return found


def align(picture, labels):
    """Return the picture with a mean luminance over land of LAND."""
    return picture * (LAND / luminance(picture, ~labels.shows("sky")))


def ladder(picture, truth, labels):
    """Return the accuracy on land of a picture and of its repairs by an oracle.

    "shadows gone" scales what lay out of the sun in each region, so that it stands to what lay in
    it as in the truth; "levels right" scales each region but the ground besides, so that it stands
    to the paving as in the truth; "colours right" gives each region, in and out of the sun, its
    true mean colour. The result is {rung: {psnr, ssim, color, ground}}, ground being the PSNR [dB]
    of GROUND.
    """
    names = [n for n, m in regions_of(labels) if n not in ("all", "land", "sky") and "," not in n]
    masks = {name: labels.shows(name) for name in names}
    masks |= {name: labels.shows(name) for name in ("table", "post")}
    steps = [picture.copy()]
    repaired = picture.copy()
    for mask in masks.values():
        sun, shade = mask & labels.lit, mask & ~labels.lit
        if min(sun.sum(), shade.sum()) >= FEWEST:
            wanted = luminance(truth, shade) / luminance(truth, sun)
            repaired[shade] *= wanted / (luminance(repaired, shade) / luminance(repaired, sun))
    steps.append(repaired)
    repaired = repaired.copy()
    paving = masks["paving"]
    for name, mask in masks.items():
        if name not in (*GROUND, "glass") and mask.any():
            wanted = luminance(truth, mask) / luminance(truth, paving)
            repaired[mask] *= wanted / (luminance(repaired, mask) / luminance(repaired, paving))
    steps.append(repaired)
    repaired = repaired.copy()
    for mask in masks.values():
        for part in (mask & labels.lit, mask & ~labels.lit):
            if part.any():
                repaired[part] *= truth[part].mean(axis=0) / repaired[part].mean(axis=0)
    steps.append(repaired)
    return {name: _rung(step, truth, labels) for name, step in zip(LADDER, steps, strict=True)}


def _rung(picture, truth, labels):
    land, ground = ~labels.shows("sky"), labels.shows(*GROUND)
    squares, similar, color = differences(shown(align(picture, labels)), shown(truth))
    return {
        "psnr": decibels(squares[land].mean()), "ssim": float(similar[land].mean()),
        "color": float(color[land].mean()), "ground": decibels(squares[ground].mean()),
    }  # fmt: skip


def ratios(picture, labels):
    """Return the scalars of one picture that need it alone: shadow, wall, under."""
    paving = labels.shows("paving") & ~labels.covered
    free = paving & (labels.openness > OPEN)
    pairs = {
        "shadow": (free & ~labels.lit, free & labels.lit),
        "wall": (labels.shows("wall"), paving),
        "under": (labels.shows("paving") & labels.covered, free & labels.lit),
    }
    return {
        name: luminance(picture, one) / luminance(picture, other)
        for name, (one, other) in pairs.items()
        if min(one.sum(), other.sum()) >= FEWEST
    }


def patches(picture, clean, labels):
    """Return how patchy the gain from the dry capture to a picture is in each region of PATCHED.

    The root mean square of the gain's logarithm, less what is smooth over PATCH pixels of the
    region (12 px of a frame); the borders of regions, thus the edges of puddles, are left out.
    `picture` is radiance, drawn or traced, `clean` the display colours of the dry capture, 0 to 1.
    """
    dry = np.maximum(linear(clean) @ LUMINANCE_WEIGHTS, DIM)
    gain = np.log(np.maximum(picture @ LUMINANCE_WEIGHTS, 1e-3) / dry)
    found = {}
    for name in PATCHED:
        inside = ndimage.binary_erosion(labels.shows(name), iterations=BORDER)
        if inside.sum() < FEWEST:
            continue
        weight = ndimage.gaussian_filter(inside.astype(np.float64), PATCH)
        smooth = ndimage.gaussian_filter(np.where(inside, gain, 0.0), PATCH)
        rest = gain[inside] - (smooth[inside] / weight[inside])
        found[name] = float(np.sqrt((rest**2).mean()))
    return found


def gloss(mirrored, labels, zenith):
    """Return the light that water mirrors in each region of FILMS over the zenith's luminance."""
    found = {}
    for name in FILMS:
        mask = labels.shows(name)
        if mask.sum() >= FEWEST:
            found[name] = luminance(mirrored, mask) / zenith
    return found


def spread(factors):
    """Return the deviation over the mean of factors that align the levels of views."""
    return float(np.std(factors) / np.mean(factors))
